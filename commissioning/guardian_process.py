"""The guardian's own process: it waits until the loop is done, or must be stopped for."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from commissioning.guardian import ARM, DISMISS, REST
from commissioning.journal import Journal
from drivers.drive import Drive, StopReport
from drivers.serial_port import Lending, SerialPort
from profiles.axis import Axis
from profiles.errors import TwoRelayError

__all__ = ["main"]

_LOOK = 0.02  # s
_GREETING = 2.0  # s


def main() -> int:
    """Wait until the loop is done, or must be stopped for."""
    order = json.loads(sys.stdin.buffer.readline())
    frames = [(bytes.fromhex(text), pause) for text, pause in order["frames"]]
    stop: _ByConnection | _ByFrames
    try:
        if "port" in order:
            owner = _AsOwner(order["port"], order["token"])
            stop, place = _ByFrames(owner.write, frames, owner.close), f" {owner.place}"
        elif "descriptor" in order:
            stop, place = _ByFrames(_to_descriptor(order["descriptor"]), frames), ""
        else:
            stop, place = _ByConnection(Axis.model_validate_json(json.dumps(order["axis"]))), ""
    except (TwoRelayError, OSError) as error:
        _say(str(error))
        return getattr(error, "exit_code", 4)
    _say(f"ready{place}")
    why = _watch(order["limit"], stop)
    if why:
        _say(why)  # the loop, should it come back, is to know who stopped the axis
        report = stop.now()
        _say(report)
        with contextlib.suppress(Exception), Journal(Path(order["home"])) as journal:
            journal.note(order["run"], f"guardian: {why}; {report}")
    return 0


def _say(text: str) -> None:
    with contextlib.suppress(OSError):  # nobody may be there to hear it
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()


class _ByConnection:
    """A connection of its own, on which nothing is said until it must be."""

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._drive = self._connected()

    def _connected(self) -> Drive:
        from drivers.link import open_to_stop

        return open_to_stop(self._axis)

    def idle(self) -> None:
        """Let what others say on the bus not pile up."""
        with contextlib.suppress(TwoRelayError):
            self._drive.line.other_master()

    def now(self) -> str:
        """Stop; once more on a fresh connection, should the first one have died."""
        report: StopReport = self._drive.stop()
        if report.deenergised is None:
            with contextlib.suppress(TwoRelayError):
                report = self._connected().stop()
        return str(report)


class _ByFrames:
    """Frames made beforehand, and how to write them."""

    def __init__(
        self,
        write: Callable[[bytes], object],
        frames: list[tuple[bytes, float]],
        close: Callable[[], None] = lambda: None,
    ) -> None:
        self._write = write
        self._frames = frames
        self._close = close

    def idle(self) -> None:
        """The port is the loop's."""

    def now(self) -> str:
        """Write the frames; nobody reads the answers."""
        for frame, pause in self._frames:
            with contextlib.suppress(OSError):
                self._write(frame)
            time.sleep(pause)
        self._close()  # whoever waits for the port has it before the journal is written
        return "stop frames sent; not verified"


def _to_descriptor(descriptor: int) -> Callable[[bytes], object]:
    """Write to an inherited one."""

    def write(frame: bytes) -> object:
        if sys.platform != "win32":
            os.set_blocking(descriptor, True)
        return os.write(descriptor, frame)

    return write


class _AsOwner:
    """The owner of the port; the loop speaks through it, until the first frame of ours."""

    def __init__(self, port: list[Any], token: str) -> None:
        device, baudrate, parity, stopbits = port
        self._lending = Lending(SerialPort(device, baudrate, parity, stopbits).open_when_free())
        self.write, self.close = self._lending.write, self._lending.close
        self._token = token.encode()
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=1)
        self.place: int = self._listener.getsockname()[1]
        threading.Thread(target=self._lend, daemon=True).start()

    def _lend(self) -> None:
        """To whom knows the token, and to nobody after."""
        while True:
            link, _ = self._listener.accept()
            link.settimeout(_GREETING)
            with contextlib.suppress(OSError):
                if self._greeting(link) == self._token:
                    break
            link.close()
        self._listener.close()
        link.settimeout(None)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
        self._lending.pass_on(link)

    def _greeting(self, link: socket.socket) -> bytes:
        """As many bytes as the token has, or as there are."""
        found = b""
        while len(found) < len(self._token) and (more := link.recv(len(self._token) - len(found))):
            found += more
        return found


def _watch(limit: float, stop: _ByConnection | _ByFrames) -> str:
    """Why the drive must be stopped; '' when the loop is done."""
    words: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_listen, args=(words,), daemon=True).start()
    armed, heard = False, time.monotonic()
    while True:
        try:
            word = words.get(timeout=_LOOK)
        except queue.Empty:
            stop.idle()
            if armed and time.monotonic() - heard > limit:
                return f"the loop was silent for more than {limit * 1000:.0f} ms"
            continue
        if not word:
            return "the loop has died"
        if DISMISS in word:
            return ""
        heard = time.monotonic()
        if ARM in word or REST in word:
            armed = word.rfind(ARM) > word.rfind(REST)


def _listen(words: queue.Queue[bytes], line: int = 0) -> None:
    """Everything that is said on standard input, and that it has ended."""
    while True:
        word = os.read(line, 4096)
        words.put(word)
        if not word:
            return


if __name__ == "__main__":
    sys.exit(main())
