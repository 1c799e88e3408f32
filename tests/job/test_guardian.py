"""The loop is killed; the drive has no watchdog of its own: its guardian stops it."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from commissioning.journal import Journal
from commissioning.runs import RunFolder
from drivers.errors import LinkError
from drivers.home import home
from drivers.link import open_drive
from profiles.axis import Axis
from tests.command import running
from tests.conftest import Serve, Tworelay
from tests.punctual import real_time
from tests.serving import WIRES

pytestmark = [real_time, pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")]

WITHOUT = """extends = "{base}"
name = "unwatched"
[watchdog]
kind = "none"
"""
LONG = (
    "--travel", "20", "--yes", "--cycle", "0.004", "--without-watchdog", "--method", "two-relay",
    "-v",
)  # fmt: skip


def unwatched(serve: Serve, tmp_path: Path, wire: str) -> Axis:
    """An axis whose drive would go on for ever."""
    (link,) = serve(
        "bench",
        *WIRES[wire],
        "-v",
    )
    base = "virtual-canopen" if link.startswith("canopen") else "virtual-modbus"
    profile = tmp_path / "unwatched.toml"
    profile.write_text(WITHOUT.format(base=base))
    drive = open_drive(Axis(link=link, profile=base))
    drive.write("watchdog_time", 0)
    drive.close()
    return Axis(link=link, profile=str(profile))


def wait_for(process: subprocess.Popen[str], words: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if words in line:
            return
    assert process.stderr is not None
    pytest.fail(f"'{words}' never came: {process.stderr.read()}")


def in_motion(axis: Axis) -> list[str]:
    assert axis.link is not None
    assert axis.profile is not None
    return ["identify", axis.link, "--profile", axis.profile, *LONG]


def left_energised(axis: Axis) -> bool:
    """Whether the drive is still enabled, some time after."""
    for _ in range(50):
        try:
            drive = open_drive(axis, to_stop=True)
        except LinkError:  # an exclusive port is the guardian's until it has ended
            time.sleep(0.1)
            continue
        try:
            if not drive.state().is_energised:
                return False
        finally:
            drive._energised = False  # looked at, not stopped
            drive.close()
        time.sleep(0.1)
    return True


def guardian_s_word() -> str:
    """What it wrote into the journal when it had done."""
    for _ in range(100):
        with Journal(home()) as journal:
            events = journal.history("last").events
        said = [event.text for event in events if event.text.startswith("guardian")]
        if said:
            return said[0]
        time.sleep(0.1)
    return ""


@pytest.mark.parametrize("wire", ["modbus-tcp", "slcan"])
def test_the_loop_is_killed_and_the_axis_is_stopped(
    serve: Serve, tworelay: Tworelay, tmp_path: Path, wire: str
) -> None:
    """By a second connection, and by the inherited descriptor of an exclusive port."""
    axis = unwatched(serve, tmp_path, wire)
    with running(*in_motion(axis)) as process:
        wait_for(process, "short pushes")
        process.kill()
        process.wait(10)
    assert "guardian: the loop has died" in guardian_s_word()
    assert not left_energised(axis)
    assert tworelay("restore", "--yes").returncode == 0


def test_the_loop_is_frozen_and_the_axis_is_stopped(serve: Serve, tmp_path: Path) -> None:
    axis = unwatched(serve, tmp_path, "modbus-tcp")
    with running(*in_motion(axis)) as process:
        wait_for(process, "staging")
        process.send_signal(signal.SIGSTOP)
        assert not left_energised(axis)
        process.send_signal(signal.SIGCONT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 5, errors
    last = errors.strip().splitlines()[-1]
    assert last.startswith(
        "tworelay: the guardian process stopped the axis: the loop was silent for"
    )
    with Journal(home()) as journal:
        notes = RunFolder.of(journal, journal.run("last").id).result().notes
    assert notes[0] == last.removeprefix("tworelay: ").partition("; ")[0]
    assert notes[1].startswith("guardian: ")
