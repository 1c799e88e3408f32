"""A process beside the loop that stops the drive, by a way of its own, when the loop is silent.

Where the bus allows a second connection, the guardian has one. On a port that has one owner it
holds the inherited descriptor, writes nothing while it is fed, and sends the drive's stop frames
when it is not. Where a process cannot inherit a port (Windows), it owns it, and the loop speaks
through it.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING

from commissioning.pipes import Pipe, never_waiting
from commissioning.processes import start
from drivers.drive import Drive
from drivers.errors import DriveFault, PreflightRefused
from profiles.axis import Axis
from profiles.errors import TwoRelayError

if TYPE_CHECKING:
    from drivers.serial_port import SerialPort

__all__ = ["NOBODY", "Guardian", "guarded"]

_CYCLES, _SILENCE = 10, 0.25  # silence of the loop that is too long: cycles, and s at least
_READY, _ENDING = 15.0, 2.0  # s to start and to end in
INHERITS = sys.platform != "win32"  # a child process can be given an open port
ARM, FEED, REST, DISMISS = b"a", b".", b"r", b"q"


class Guardian:
    """The loop's end of the line; without a process it does nothing.

    Attributes
    ----------
    reclaim : takes the port back that the guardian owns, once it has ended
    said : lines that it has said since it was ready: why it stops the drive, and what it reached
    """

    def __init__(self, process: subprocess.Popen[bytes] | None = None) -> None:
        self.reclaim: Callable[[], None] | None = None
        self._process = process
        self._is_dead = False
        self.said: list[str] = []
        self._ear: threading.Thread | None = None
        self._line: Pipe | None = None
        if process is not None and process.stdin is not None:
            self._line = never_waiting(process.stdin.fileno(), DISMISS)
            self._ear = threading.Thread(target=self._hear, args=(process,), daemon=True)
            self._ear.start()

    def _hear(self, process: subprocess.Popen[bytes]) -> None:
        """All that the guardian says, until it has ended."""
        assert process.stdout is not None
        with contextlib.suppress(OSError, ValueError):
            for line in process.stdout:
                self.said.append(line.decode("utf-8", "replace").strip())

    def acted(self) -> str:
        """Pipe that the guardian stopped the drive, and why; '' when it did not."""
        if self._is_dead and self._ear is not None:
            self._ear.join(_ENDING)  # what it said last is on its way
        if not self.said:
            return ""
        return f"the guardian process stopped the axis: {self.said[0]}"

    def arm(self) -> None:
        """From now on silence is a failure.

        Raises DriveFault when the guardian has ended meanwhile.
        """
        self._heed()
        if self._is_dead:
            raise DriveFault(
                "the guardian process has ended, so nothing would stop the axis if this computer "
                "failed; it is not moved",
                code="guardian.ended",
            )
        self._say(ARM)

    def feed(self) -> None:
        """The loop is alive.

        Raises DriveFault when the guardian is not, or has stopped the axis.
        """
        self._heed()
        self._say(FEED)

    def _heed(self) -> None:
        """No command goes out beside the stop of a guardian that took the loop for dead."""
        if self.said:
            raise DriveFault(self.acted(), code="guardian.acted")

    def rest(self) -> None:
        """The loop is silent on purpose; only its death is a failure."""
        with contextlib.suppress(DriveFault):
            self._say(REST)

    def _say(self, word: bytes) -> None:
        if self._line is None:
            return
        try:
            self._line.write(word)
        except BlockingIOError:
            pass  # it has enough to read
        except OSError:
            self._line, self._is_dead = None, True
            raise DriveFault(
                "the guardian process has ended, so nothing would stop the axis if this computer "
                f"failed; the axis was stopped{self._taken_back()}",
                code="guardian.ended",
            ) from None

    def _taken_back(self) -> str:
        """What became of the port that the guardian owned."""
        if self.reclaim is None:
            return ""
        try:
            self.reclaim()
        except OSError as error:
            return (
                f", by no way that is verified: the guardian's port cannot be opened here ({error})"
            )
        return " through its port, which was opened here"

    def dismiss(self) -> None:
        """End the process: it is no longer needed."""
        process, self._process = self._process, None
        if process is None:
            return
        line = self._line
        with contextlib.suppress(DriveFault):
            self._say(DISMISS)
        self._line = None
        if line is not None:
            line.end()
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if self._ear is not None:
            self._ear.join(_ENDING)
        if process.stdout is not None:
            process.stdout.close()


NOBODY = Guardian()


@contextlib.contextmanager
def guarded(drive: Drive, axis: Axis, profile: Path, run: str, home: Path) -> Generator[Guardian]:
    """A guardian for as long as the axis may move; none in simulated time.

    Raises PreflightRefused where there can be none.
    """
    if not drive.in_real_time:
        yield NOBODY
        return
    with contextlib.ExitStack() as stack:
        try:
            guardian = _started(drive, axis, profile, run, home, stack)
        except (OSError, RuntimeError) as error:
            raise PreflightRefused(
                "no guardian process can be started, and without one nothing would stop the axis "
                f"if this program failed: {error}",
                code="preflight.guardian",
            ) from None
        yield guardian


def _started(
    drive: Drive, axis: Axis, profile: Path, run: str, home: Path, stack: contextlib.ExitStack
) -> Guardian:
    """The guardian, dismissed with `stack`; raises OSError, RuntimeError."""
    frames = drive.line.stop_frames()
    there = axis.model_copy(update={"link": drive.link, "profile": str(profile)})
    order = {
        "axis": there.model_dump(mode="json"),
        "limit": max(_CYCLES * drive.cycle, _SILENCE),
        "frames": [] if frames is None else [(f.hex(), pause) for f, pause in frames.frames],
        "run": run,
        "home": str(home),
    }
    if frames is None:
        guardian = Guardian(_process(order)[0])
        stack.callback(guardian.dismiss)
    elif INHERITS and frames.descriptor is not None:
        order["descriptor"] = frames.descriptor
        guardian = Guardian(_process(order, (frames.descriptor,))[0])
        stack.callback(guardian.dismiss)
    elif frames.port is None:
        raise RuntimeError("this system lends no connection to a second process")
    else:
        patience = sum(pause for _, pause in frames.frames) + _ENDING
        guardian = stack.enter_context(_lending(drive, frames.port, order, patience))
    return guardian


@contextlib.contextmanager
def _lending(
    drive: Drive, port: SerialPort, order: dict[str, object], patience: float
) -> Generator[Guardian]:
    """A guardian that owns the drive's port, through which the loop speaks meanwhile.

    `patience` : s for the guardian to stop the drive and end
    """
    from drivers.serial_port import LentPort

    token = secrets.token_hex()
    order |= {
        "port": [port.device, port.baudrate, port.parity, port.stopbits], "token": token,
    }  # fmt: skip
    drive.line.speak_through(None)
    guardian = Guardian()
    try:
        process, place = _process(order)
        guardian = Guardian(process)
        lent = LentPort(_link(int(place), token), port, patience)
        guardian.reclaim = lent.reclaim
        drive.line.speak_through(lent)
        yield guardian
    except BaseException:
        _take_back(drive, port, guardian, patience)
        with contextlib.suppress(TwoRelayError):
            if drive.state().is_energised:  # the guardian hung, and with it the way to stop
                drive.stop()
        raise
    else:
        _take_back(drive, port, guardian, patience)


def _take_back(drive: Drive, port: SerialPort, guardian: Guardian, patience: float) -> None:
    """The guardian's port is the loop's again."""
    guardian.dismiss()
    drive.line.speak_through(None)
    with contextlib.suppress(OSError):  # a port that is gone shows at the next word
        drive.line.speak_through(port.open_when_free(patience))


def _link(place: int, token: str) -> socket.socket:
    """To the guardian that listens on `place` of this computer alone."""
    link = socket.create_connection(("127.0.0.1", place))
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
    link.sendall(token.encode())
    return link


def _process(
    order: dict[str, object], descriptors: tuple[int, ...] = ()
) -> tuple[subprocess.Popen[bytes], str]:
    """The guardian's process, ready, and what it said beside; raises RuntimeError."""
    process = start(
        "commissioning.guardian_process",
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=descriptors,
    )  # fmt: skip
    assert process.stdin is not None
    process.stdin.write(json.dumps(order).encode() + b"\n")
    process.stdin.flush()
    answer = _line_within(process, _READY).decode("utf-8", "replace").strip()
    if answer.split(" ")[0] != "ready":
        Guardian(process).dismiss()
        raise RuntimeError(answer or "it does not answer")
    return process, answer.removeprefix("ready").strip()


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
