"""The loop's end of the line to the guardian, with processes that are none."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import commissioning.guardian
from commissioning.guardian import NOBODY, Guardian, guarded
from commissioning.pipes import _Background
from commissioning.rig.armed import noted
from drivers.bus import StopFrames
from drivers.errors import DriveFault, PreflightRefused
from drivers.link import axis_of, open_drive
from profiles.axis import Axis
from tests.raising import raises

pytestmark = pytest.mark.skipif(os.name == "nt", reason="descriptors are inherited on POSIX")
_PATIENCE = 20.0  # s for what takes a fraction of one


def test_words_that_a_pipe_would_make_wait_for_go_by_a_thread() -> None:
    """As on Windows before Python 3.12."""
    reader, writer = os.pipe()
    line = _Background(writer, b"q")
    line.write(b"a")
    assert os.read(reader, 1) == b"a"
    other = _Background(writer, b"q")
    other.write(b"q")
    other.end()
    assert os.read(reader, 1) == b"q", "it had left when that returned"
    os.close(reader)
    with pytest.raises(BrokenPipeError):
        put_for_long(line)
    os.close(writer)


def test_the_last_word_has_left_when_the_line_ends() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writer, b"." * 4096)
    os.set_blocking(writer, True)
    line = _Background(writer, b"q")
    line.write(b"q")
    drain = threading.Timer(0.1, os.read, (reader, 1 << 20))
    drain.start()
    line.end()
    assert not line._thread.is_alive()
    drain.join()
    os.close(reader)
    os.close(writer)


def test_a_guardian_is_told_what_it_needs_and_how_long_silence_may_be(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    orders: list[dict[str, Any]] = []

    def noted_order(order: dict[str, Any], descriptors: tuple[int, ...] = ()) -> tuple[None, str]:
        orders.append(order | {"descriptors": descriptors})
        return None, ""

    monkeypatch.setattr(commissioning.guardian, "_process", noted_order)
    frames = StopFrames(7, ((b"\x01\x02", 0.03),), None)
    for cycle, limit in ((0.001, 0.25), (0.025, 0.25), (0.05, 0.5)):
        drive = SimpleNamespace(
            in_real_time=True,
            cycle=cycle,
            link="modbus-rtu:///dev/x",
            line=SimpleNamespace(stop_frames=lambda: frames),
        )
        axis = Axis(name="a", profile="other", link="virtual://bench")
        with guarded(drive, axis, tmp_path / "p.toml", "run", tmp_path):  # type: ignore[arg-type]
            order = orders[-1]
        assert order["limit"] == pytest.approx(limit)
        assert (order["run"], order["home"]) == ("run", str(tmp_path))
        assert (order["descriptor"], order["descriptors"]) == (7, (7,))
        assert order["frames"] == [("0102", 0.03)]
        assert order["axis"]["link"] == "modbus-rtu:///dev/x"
        assert order["axis"]["profile"] == str(tmp_path / "p.toml")


def put_for_long(line: _Background) -> None:
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        line.write(b".")


def pretending(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """Instead of the guardian, a process that does this after it has heard its order."""

    def start(module: str, **streams: Any) -> subprocess.Popen[bytes]:
        assert module == "commissioning.guardian_process"
        return subprocess.Popen([sys.executable, "-c", f"input(); {code}"], **streams)

    monkeypatch.setattr(commissioning.guardian, "start", start)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("print('no such profile')", "^no such profile$"),
        ("print('readyish')", "^readyish$"),
        ("pass", "^it does not answer$"),
        ("import time; time.sleep(60)", "^it does not answer$"),
    ],
)
def test_a_guardian_that_does_not_say_it_is_ready_is_none(
    monkeypatch: pytest.MonkeyPatch, code: str, words: str
) -> None:
    pretending(monkeypatch, code)
    monkeypatch.setattr(commissioning.guardian, "_READY", 0.5)
    with pytest.raises(RuntimeError, match=words):
        commissioning.guardian._process({"an": "order"})


def test_what_a_guardian_says_beside_that_it_is_ready_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pretending(monkeypatch, "print('ready 4711', flush=True); input()")
    process, place = commissioning.guardian._process({})
    assert place == "4711"
    Guardian(process).dismiss()
    assert process.poll() is not None


def test_a_guardian_that_reads_nothing_does_not_make_the_loop_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pretending(monkeypatch, "print('ready', flush=True); import time; time.sleep(60)")
    process, _ = commissioning.guardian._process({})
    guardian = Guardian(process)
    for _ in range(200_000):  # a pipe holds 65 536
        guardian.feed()
    monkeypatch.setattr(process, "wait", impatient(process.wait))
    guardian.dismiss()
    assert process.returncode is not None, "it was killed"
    guardian.dismiss()
    guardian.feed()


def impatient(wait: Callable[..., int]) -> Callable[..., int]:
    def waits(seconds: float | None = None) -> int:
        if seconds is not None:
            raise subprocess.TimeoutExpired("guardian", seconds)
        return wait()

    return waits


class Broken:
    """A line on which nobody listens."""

    def write(self, word: bytes) -> None:
        raise BrokenPipeError

    def end(self) -> None:
        return


def test_a_dead_guardian_is_told_once_with_what_became_of_its_port() -> None:
    def gone() -> None:
        raise OSError("no such device")

    for reclaim, words in (
        (None, "the axis was stopped$"),
        (lambda: None, "stopped through its port, which was opened here$"),
        (gone, r"the guardian's port cannot be opened here \(no such device\)$"),
    ):
        guardian = Guardian()
        guardian.reclaim = reclaim
        guardian._line = Broken()
        with pytest.raises(DriveFault, match=words):
            guardian.feed()
        guardian.feed()


def test_a_guardian_that_died_while_nothing_moved_lets_nothing_move_any_more() -> None:
    guardian = Guardian()
    guardian._line = Broken()
    guardian.rest()  # says nothing: a stop may be under way
    with raises(DriveFault, "guardian.ended"):
        guardian.arm()


def test_a_guardian_that_stopped_the_axis_is_not_one_that_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where its last words come after its death has been seen."""
    pretending(
        monkeypatch,
        "print('ready', flush=True); import sys, time; sys.stdin.close(); time.sleep(0.2); "
        "print('silent'); print('at rest')",
    )
    monkeypatch.setattr(commissioning.guardian, "_ENDING", _PATIENCE)
    guardian = Guardian(commissioning.guardian._process({})[0])
    assert guardian.acted() == ""
    guardian._line = Broken()
    with raises(DriveFault, "guardian.ended"):
        guardian.feed()  # nothing is waited for before the axis is stopped
    assert noted(guardian) == [
        "the guardian process stopped the axis: silent", "guardian: at rest",
    ]  # fmt: skip
    guardian.dismiss()


@pytest.mark.parametrize("word", ["arm", "feed"])
def test_no_command_goes_out_beside_the_stop_of_a_guardian(word: str) -> None:
    """It said why before it stopped the drive; a loop that comes back would enable it again."""
    guardian = Guardian()
    getattr(guardian, word)()
    guardian.said.append("silent")
    with raises(DriveFault, "guardian.acted"):
        getattr(guardian, word)()
    guardian.rest()


def test_a_guardian_that_does_nothing_leaves_no_note() -> None:
    assert noted(NOBODY) == noted(Guardian()) == []


@pytest.mark.parametrize("watchdog", ["none", "cycle"])
def test_without_a_guardian_nothing_moves_in_real_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, watchdog: str
) -> None:
    """The drive's own watchdog is no substitute."""
    pretending(monkeypatch, "print('cannot be reached')")
    kind = SimpleNamespace(watchdog=SimpleNamespace(kind=watchdog))
    drive = SimpleNamespace(
        in_real_time=True, cycle=0.004, link="virtual://bench", profile=kind,
        line=SimpleNamespace(stop_frames=lambda: None),
    )  # fmt: skip
    axis = Axis(name="a", profile="other", link="virtual://bench")
    with (
        raises(PreflightRefused, "preflight.guardian"),
        guarded(drive, axis, tmp_path / "p.toml", "run", tmp_path),  # type: ignore[arg-type]
    ):
        pass


def test_nobody_is_told_nothing() -> None:
    for word in (NOBODY.arm, NOBODY.feed, NOBODY.rest, NOBODY.dismiss):
        word()


def test_stepped_drives_have_no_guardian(tmp_path: Path) -> None:
    drive = open_drive(axis_of("virtual://bench"))
    with guarded(drive, axis_of("virtual://bench"), tmp_path, "x", tmp_path) as guardian:
        assert guardian is NOBODY
    drive.close()
