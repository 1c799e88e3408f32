"""The panel: what it shows, what it costs the loop, and that its death ends nothing."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import pytest

from commissioning.panel.course import Course
from commissioning.panel.feed import Panel
from commissioning.panel.lines import Lines
from commissioning.panel.picture import picture
from commissioning.panel.process import Ear
from commissioning.processes import start
from commissioning.watching import Setting, Stage
from drivers.sample import Sample, Status
from profiles.procedures import Mode
from tests.command import ROOT

ENABLED = Status(enabled=True, fault=False, stopping=False, limit=False, word=0)
SETTING = Setting("x", "modbus-tcp://h", 1.0, 3.0, 0.5, 20.0, "rad", "N.m", 0.01, in_real_time=True)
STAGES = [Stage("first", 4.0), Stage("second", 6.0), Stage("third", 10.0)]


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def sample(time: float, position: float, **other: Any) -> Sample:
    row = {"torque": 0.1, "command": -0.25, "lateness": 0.0, "missed": 0} | other
    return Sample(time=time, position=position, sent=time, status=ENABLED, **row)


# -- how far it is --------------------------------------------------------------------------------


def test_the_time_left_is_that_of_the_steps_that_are_left() -> None:
    course = Course()
    course.add(STAGES)
    assert course.left(0.0) == 20.0
    course.step("first", 0.0)
    assert course.left(1.0) == pytest.approx(19.0)
    course.step("second", 4.5)
    assert (course.number, course.count, course.name) == (2, 3, "second")
    assert course.left(5.5) == pytest.approx(15.0)
    course.lasts(2.0, 5.5)
    assert course.left(5.5) == pytest.approx(12.0)
    course.add([Stage("third", 3.0)])
    assert course.left(5.5) == pytest.approx(5.0)


def test_a_step_that_takes_longer_is_not_over_and_an_unknown_one_counts() -> None:
    course = Course()
    course.add(STAGES)
    course.step("first", 0.0)
    assert course.left(60.0) == pytest.approx(16.4), "a tenth of it, and what comes after"
    course.step("again", 60.0)
    assert (course.number, course.count) == (2, 4)


def test_simulated_time_has_a_pace_of_its_own() -> None:
    course = Course()
    course.in_real_time = False
    course.add(STAGES)
    course.step("first", 0.0)
    assert course.left(0.1) is None, "nothing is known of it yet"
    course.step("second", 0.4)
    assert course.left(0.4) == pytest.approx(1.6), "a tenth of the 16 s that are left"


# -- what is told ---------------------------------------------------------------------------------


class Pipe:
    """A process that is a pipe."""

    def __init__(self) -> None:
        self.reader, writer = os.pipe()
        self.stdin = os.fdopen(writer, "wb", buffering=0)
        self.stopped = False

    def wait(self, timeout: float | None = None) -> int:
        return 0

    def close(self) -> None:
        for end in (self.stdin.close, partial(os.close, self.reader)):
            with contextlib.suppress(OSError):
                end()

    def states(self) -> list[dict[str, Any]]:
        found = b""
        while select.select([self.reader], [], [], 0)[0]:
            part = os.read(self.reader, 1 << 20)
            if not part:
                break
            found += part
        return [json.loads(line) for line in found.splitlines() if line]


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    found = Pipe()
    yield found
    found.close()


def panel_on(pipe: Pipe, clock: Clock) -> Panel:
    def started(*_: Any, **__: Any) -> Any:
        return pipe

    return Panel("identify", to_stderr=False, clock=clock, started=started)


def test_the_loop_tells_ten_times_a_second_what_happened_since(pipe: Pipe) -> None:
    clock = Clock()
    panel = panel_on(pipe, clock)
    panel.begins(SETTING, STAGES)
    panel.step("first")
    samples: list[Sample] = []
    pipe.states()
    for n in range(100):
        clock.now = 0.01 * n
        late = {"lateness": 0.006} if n % 10 == 3 else {}
        samples.append(sample(0.01 * n, 1.0 + 0.02 * n, missed=int(n == 50), **late))
        panel.cycle(samples, Mode.TORQUE)
    states = pipe.states()
    assert 9 <= len(states) <= 11
    last = states[-1]
    told = int(last["cycles"])
    assert last["late"] == sum(s.lateness > 0.005 for s in samples[:told])
    assert last["lost"] == 1
    assert last["speed"] == pytest.approx(2.0)
    assert last["torque"] == -0.25, "what is commanded"
    assert sum(len(state["trace"]) for state in states) >= 40, "and the motion between the pictures"
    panel.cycle([sample(0.0, 1.0, command=1.2)], Mode.POSITION)
    clock.now = 9.0
    panel.cycle([sample(0.0, 1.0, command=1.2)], Mode.POSITION)
    assert pipe.states()[-1]["torque"] == 0.1, "in position mode the drive's own"


def test_a_full_pipe_loses_pictures_and_makes_nobody_wait(pipe: Pipe) -> None:
    clock = Clock()
    panel = panel_on(pipe, clock)
    panel.begins(SETTING, STAGES)
    samples = [sample(0.0, 1.0)]
    for n in range(3000):
        clock.now = float(n)
        panel.cycle(samples, Mode.TORQUE)
    assert not panel.has_died
    states = pipe.states()
    assert 10 < len(states) < 3000
    assert all(state["doing"] == "identify" for state in states), "each is whole"
    panel.close()


def test_a_panel_that_died_ends_nothing(pipe: Pipe) -> None:
    clock = Clock()
    panel = panel_on(pipe, clock)
    panel.begins(SETTING, STAGES)
    os.close(pipe.reader)
    clock.now = 1.0
    panel.cycle([sample(0.0, 1.0)], Mode.TORQUE)
    panel.phase("goes on")
    panel.close()
    assert panel.has_died


def test_a_panel_that_cannot_be_started_ends_nothing() -> None:
    def fails(*_: Any, **__: Any) -> Any:
        raise OSError("no more processes")

    panel = Panel("identify", to_stderr=False, started=fails)
    panel.begins(SETTING, STAGES)
    panel.cycle([sample(0.0, 1.0)], Mode.TORQUE)
    panel.close()
    assert panel.has_died
    assert not panel.is_drawn


def test_what_is_no_picture_is_passed_over() -> None:
    ear = Ear()
    for line in (b"", b"{", b"[1]", b'{"trace":[[1.0,2.0],[1.1,2.1]]}', b"\xff"):
        ear.hear(line)
    assert list(ear.trace) == [(1.0, 2.0), (1.1, 2.1)]
    ear.hear(b'{"trace":[[0.0,0.0]]}')
    assert list(ear.trace) == [(0.0, 0.0)], "of another experiment"


def test_pipes_and_files_get_a_line_a_step() -> None:
    said: list[str] = []
    clock = Clock()
    lines = Lines(said.append, detailed=False, clock=clock)
    lines.begins(SETTING, STAGES)
    lines.step("first")
    lines.phase("something within it")
    clock.now = 4.0
    lines.step("second")
    assert said == [
        "step 1 of 3: first, about 20 s left", "step 2 of 3: second, about 16 s left",
    ]  # fmt: skip


# -- the picture ----------------------------------------------------------------------------------


def state(**other: Any) -> dict[str, Any]:
    found = {
        "doing": "commission", "axis": "press-7-x", "link": "canopen://socketcand/host/can0?node=5",
        "start": 1.0, "travel": 3.0, "position_unit": "rad", "effort_unit": "N.m",
        "torque_limit": 0.5, "speed_limit": 20.0, "in_real_time": True, "step": "oscillations",
        "number": 4, "count": 10, "left": 47.6, "position": 2.5, "torque": -0.25, "speed": 5.0,
        "friction": [[0.11, None, None], [0.1, 0.09, 0.11], [0.1001, 0.0995, 0.1007]],
        "late": 2, "lost": 1, "cycles": 300, "said": ["relay", "oscillator"],
    }  # fmt: skip
    return found | other


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 40), (40, 12), (20, 5), (200, 60)])
@pytest.mark.parametrize("plain", [False, True])
def test_the_picture_fits_every_terminal(width: int, height: int, *, plain: bool) -> None:
    trace = [(0.01 * n, 1.0 + 0.5 * (-1) ** n) for n in range(200)]
    lines = picture(state(), trace, width, height, plain=plain).plain.split("\n")
    assert len(lines) <= max(height, 12)
    assert max(map(len, lines)) <= max(width, 40)
    if plain:
        assert all(ord(letter) < 256 or letter in "…" for line in lines for letter in line)


def test_the_picture_says_what_one_wants_to_know() -> None:
    text = picture(state(), [], 80, 24).plain
    for words in (
        "commission  press-7-x", "step 4 of 10: oscillations", "about 48 s left",
        "+1.5 of ±3 rad", "-0.25 of ±0.5 N·m", "+5 of ±20 rad/s", "0.1001 N·m",
        "0.0995 … 0.1007", "first look > ±10 % > ±0.6 %", "2 late, 1 lost (1 %)", "oscillator",
        "Ctrl-C stops the axis",
    ):  # fmt: skip
        assert words in text
    bar = next(line for line in text.split("\n") if line.startswith("position"))
    cells = bar[bar.index("[") + 1 : bar.index("]")]
    assert cells.index("█") == round(0.75 * (len(cells) - 1)), "1.5 of ±3 rad"


def test_nothing_is_known_before_the_first_sample() -> None:
    first = state(position=None, torque=None, speed=None, friction=[], left=None, number=0, said=[])
    text = picture(first, [], 80, 24).plain
    assert "getting ready" in text
    assert "not known yet" in text


# -- the process ----------------------------------------------------------------------------------


class Terminal:
    """A terminal of 80 by 24, and what was written on it."""

    def __init__(
        self, *arguments: str, rows: int = 24, columns: int = 80, **variables: str
    ) -> None:
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        environment = {
            k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "CI", "COLUMNS")
        }
        environment |= {"TERM": "xterm-256color", "PYTHONPATH": str(ROOT)} | variables
        self.process = subprocess.Popen(
            [sys.executable, "-m", "commissioning", *arguments],
            stdin=slave, stdout=slave, stderr=slave, env=environment, start_new_session=True,
        )  # fmt: skip
        os.close(slave)
        self.text = ""

    def read(self, until: Callable[[str], bool] = lambda text: False, patience: float = 60) -> str:
        end = time.monotonic() + patience
        while time.monotonic() < end and not until(self.text):
            if not select.select([self.master], [], [], 0.5)[0]:
                continue
            try:
                part = os.read(self.master, 65536)
            except OSError:
                break
            if not part:
                break
            self.text += part.decode("utf-8", "replace")
        return self.text

    def end(self) -> int:
        self.read()
        os.close(self.master)
        return self.process.wait(30)


COLOUR = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def test_a_terminal_gets_the_panel_and_then_one_screen_of_result(tmp_path: Path) -> None:
    terminal = Terminal(
        "identify", "virtual://epos-screw", "--yes", TWORELAY_HOME=str(tmp_path / "home")
    )
    assert terminal.end() == 0
    text = terminal.text
    assert "\x1b[?1049h" in text, "a screen of its own"
    after = COLOUR.sub("", text[text.rindex("\x1b[?1049l") :])
    assert "of 4: oscillations" in COLOUR.sub("", text)
    lines = [line for line in after.replace("\r", "").split("\n") if line.strip()]
    assert any("Coulomb friction" in line for line in lines)
    assert lines[-1].startswith("run ")
    assert len(lines) <= 24
    assert all(len(line) <= 80 for line in lines), "folded between words"


@pytest.mark.parametrize("variables", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_terminals_that_draw_nothing_get_a_line_a_step(
    tmp_path: Path, variables: dict[str, str]
) -> None:
    home = {"TWORELAY_HOME": str(tmp_path / "home")}
    terminal = Terminal("identify", "virtual://bench", "--yes", **(home | variables))
    assert terminal.end() == 0
    assert "\x1b[" not in terminal.text
    assert "step 4 of 4: oscillations" in terminal.text


def test_killing_the_panel_ends_no_job(tmp_path: Path) -> None:
    terminal = Terminal(
        "identify", "virtual://bench", "--method", "all", "--yes",
        TWORELAY_HOME=str(tmp_path / "home"),
    )  # fmt: skip
    terminal.read(lambda text: "step" in text and "1049h" in text)
    drawing = [
        child
        for child in psutil.Process(terminal.process.pid).children()
        if "commissioning.panel.process" in " ".join(child.cmdline())
    ]
    assert len(drawing) == 1
    drawing[0].send_signal(signal.SIGINT)  # which is for the job
    time.sleep(0.2)
    assert drawing[0].is_running()
    drawing[0].kill()
    assert terminal.end() == 0
    text = COLOUR.sub("", terminal.text)
    assert "the panel has ended by itself; the job went on without it" in text
    assert "Coulomb friction" in text
    assert terminal.text.count("\x1b[?1049l") >= 1, "the usual screen is back"


def test_the_process_that_draws_ends_with_its_pipe(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    started = partial(start, stdout=slave, stderr=slave)
    panel = Panel("identify", to_stderr=False, started=started)
    panel.begins(SETTING, STAGES)
    process = panel._process
    assert process is not None
    panel.close()
    assert process.returncode == 0
    assert not panel.has_died
    os.close(slave)
    os.close(master)
