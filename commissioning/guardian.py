"""A process beside the loop, with a way of its own to the drive, that stops it when the loop falls silent.

Where the bus allows a second connection, the guardian has one. On a port that has one owner it holds the
inherited descriptor, writes nothing while it is fed, and sends the drive's stop frames when it is not.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Generator
from pathlib import Path

from drivers.drive import Drive
from profiles.axis import Axis
from profiles.errors import DriveFault, PreflightRefused

__all__ = ["NOBODY", "Guardian", "guarded"]

_CYCLES, _SILENCE = 10, 0.25  # silence of the loop that is too long: cycles, and s at least
_READY = 15.0  # s to start in
ARM, FEED, REST, DISMISS = b"a", b".", b"r", b"q"


class Guardian:
    """The loop's end of the line; without a process it does nothing."""

    def __init__(self, process: subprocess.Popen[bytes] | None = None) -> None:
        self._process = process
        self._line = -1 if process is None or process.stdin is None else process.stdin.fileno()

    def arm(self) -> None:
        """From now on silence is a failure."""
        self._say(ARM)

    def feed(self) -> None:
        """The loop is alive; raises DriveFault when the guardian is not."""
        self._say(FEED)

    def rest(self) -> None:
        """The loop is silent on purpose; only its death is a failure."""
        with contextlib.suppress(DriveFault):
            self._say(REST)

    def _say(self, word: bytes) -> None:
        if self._line < 0:
            return
        try:
            os.write(self._line, word)
        except BlockingIOError:
            pass  # it has enough to read
        except OSError:
            self._line = -1
            raise DriveFault(
                "the guardian process has ended, so nothing would stop the axis if this computer failed; "
                "the axis was stopped"
            ) from None

    def dismiss(self) -> None:
        """It is no longer needed."""
        process, self._process = self._process, None
        if process is None:
            return
        with contextlib.suppress(DriveFault):
            self._say(DISMISS)
        self._line = -1
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


NOBODY = Guardian()


@contextlib.contextmanager
def guarded(drive: Drive, axis: Axis, profile: Path, run: str, home: Path) -> Generator[Guardian]:
    """A guardian for as long as the axis may move; none in simulated time.

    Raises PreflightRefused where there can be none, and the drive has no watchdog either.
    """
    if not drive.in_real_time:
        yield NOBODY
        return
    try:
        guardian = Guardian(_start(drive, axis, profile, run, home))
    except (OSError, RuntimeError) as error:
        if drive.profile.watchdog.kind == "none":
            raise PreflightRefused(
                f"no guardian process can be started ({error}), and the drive has no watchdog: nothing "
                "would stop the axis if this computer failed"
            ) from None
        guardian = Guardian()
    try:
        yield guardian
    finally:
        guardian.dismiss()


def _start(
    drive: Drive, axis: Axis, profile: Path, run: str, home: Path
) -> subprocess.Popen[bytes]:
    frames = drive.stop_frames()
    descriptor = None if frames is None else frames.descriptor
    if descriptor is not None and os.name == "nt":
        raise RuntimeError("Windows lends no serial port to a second process")
    order = {
        "axis": axis.model_copy(update={"link": drive.link, "profile": str(profile)}).model_dump(
            mode="json"
        ),
        "limit": max(_CYCLES * drive.cycle, _SILENCE),
        "descriptor": descriptor,
        "frames": [] if frames is None else [(f.hex(), pause) for f, pause in frames.frames],
        "run": run,
        "home": str(home),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "commissioning.guardian_process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=() if descriptor is None else (descriptor,),
        start_new_session=True,  # a Ctrl-C is not for it
    )
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(order).encode() + b"\n")
    process.stdin.flush()
    os.set_blocking(process.stdin.fileno(), False)
    answer = _line_within(process, _READY)
    if answer != b"ready\n":
        Guardian(process).dismiss()
        raise RuntimeError(answer.decode("utf-8", "replace").strip() or "it does not answer")
    return process


def _line_within(process: subprocess.Popen[bytes], seconds: float) -> bytes:
    """First line that the process says; empty when it ends, or is too slow and is killed."""
    assert process.stdout is not None
    timer = threading.Timer(seconds, process.kill)
    timer.start()
    try:
        return process.stdout.readline()
    finally:
        timer.cancel()
        timer.join()
