"""tworelay demo --fleet: eight axes of four kinds, interrupted in the middle, and resumed."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

from commissioning.cli.fleet.rehearse import served
from commissioning.cli.terminal import Screen
from commissioning.fleet.ledger import Ledger
from commissioning.interruption import Interruption
from commissioning.processes import start
from commissioning.result.fleet import JobState
from drivers.home import home
from profiles.errors import UsageError

__all__ = ["called", "demo_file", "run_demo", "started"]

_UNTIL = 3  # axes done, and then it is interrupted
_HEAD = """\
name = "press-line-7"
job = "commission"
confirm = "group"

[defaults]
travel = 3.0     # rad, about where each axis stands
cycle = 0.004    # s
fraction = 0.85

[zones.cell-1]   # one emergency stop
at_once = 2

[groups.gantry]  # axes that can meet
zone = "cell-1"
"""
_AXES = (  # name, link, what else
    ("press-7-x", "modbus-tcp://10.0.7.20?unit=1", 'zone = "cell-1"'),
    ("press-7-y", "modbus-tcp://10.0.7.20?unit=2", 'after = ["press-7-x"]'),
    ("feed-left", "canopen://socketcan/can0?node=5", ""),
    ("feed-right", "canopen://socketcan/can0?node=6", 'twin = "bench?coulomb=0.2"'),
    ("gantry-1", "modbus-rtu:///dev/ttyUSB0?unit=1", 'group = "gantry"\ntwin = "bench?coulomb=5"'),
    ("gantry-2", "modbus-rtu:///dev/ttyUSB0?unit=2", 'group = "gantry"'),
    ("table", "modbus-tcp://10.0.7.31", 'twin = "hsm150?seed=7"'),
    ("ejector", "modbus-tcp://10.0.7.32", ""),
)  # fmt: skip


def demo_file(links: dict[str, str]) -> str:
    """Its fleet file; `links`: of the axes that are served."""
    parts = [_HEAD]
    for name, link, more in _AXES:
        lines = ["[[axes]]", f'name = "{name}"', f'link = "{links.get(name, link)}"', more]
        parts.append("\n".join(filter(None, lines)) + "\n")
    return "\n".join(parts)


def run_demo(screen: Screen) -> int:
    """Serve the twins, check, run, interrupt, resume; returns the exit code of the last."""
    folder = home() / "demo-fleet"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "press-line-7.toml"
    path.write_text(demo_file({}), "utf-8")
    with Interruption(), served(path, len(_AXES)) as links:
        path.write_text(demo_file(dict(zip(_names(), links, strict=True))), "utf-8")
        screen.say(f"eight virtual drives on five buses, and a fleet file: {path}")
        screen.say("'gantry-1' is jammed on purpose, and 'gantry-2' is of its group")
        called(screen, "fleet", "check", str(path))
        _interrupted(screen, "fleet", "run", str(path), "--yes")
        junit = folder / "junit.xml"
        code = called(screen, "fleet", "run", str(path), "--resume", "--yes", "--junit", str(junit))
        screen.say(f"JUnit: {junit}")
        screen.say(
            f"exit code {code}: some axes are not done, as it has to be with one that is jammed"
        )
    return code


def _names() -> list[str]:
    """In the order in which the twins are served: bus by bus, as they come in the file."""
    return [name for name, _, _ in _AXES]


def started(screen: Screen, *arguments: str) -> subprocess.Popen[str]:
    """A command under way, which is shown as it would be typed."""
    screen.say()
    screen.say("$ tworelay " + " ".join(arguments))
    sys.stdout.flush()
    process: subprocess.Popen[str] = start("commissioning", *arguments)
    return process


def called(screen: Screen, *arguments: str) -> int:
    """A command to its end; returns its exit code."""
    with started(screen, *arguments) as process:
        try:
            return process.wait()
        finally:
            process.terminate()


def _interrupted(screen: Screen, *arguments: str) -> None:
    """A run that gets a Ctrl-C when some of its axes are done."""
    begun = time.time()
    with started(screen, *arguments) as process:
        try:
            while process.poll() is None and _done_since(begun) < _UNTIL:
                time.sleep(0.1)
            screen.say("^C")
            if sys.platform == "win32":
                process.send_signal(signal.CTRL_BREAK_EVENT)
            else:
                process.send_signal(signal.SIGINT)
            process.wait()
        finally:
            process.terminate()


def _done_since(begun: float) -> int:
    with Ledger(home(), reading=True) as ledger:
        try:
            record = ledger.record("last")
        except UsageError:
            return 0
        if record.created < begun:
            return 0
        return sum(row.state is JobState.DONE for row in ledger.rows(record.id).values())
