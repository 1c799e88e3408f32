"""The guardian's own process: it waits until the loop is done, or must be stopped for."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import sys
import threading
import time
from pathlib import Path
from typing import Any

from commissioning.guardian import ARM, DISMISS, REST
from commissioning.journal import Journal
from drivers.drive import Drive, StopReport
from profiles.axis import Axis
from profiles.errors import TwoRelayError

__all__ = ["main"]

_LOOK = 0.02  # s


def main() -> int:
    """Wait until the loop is done, or must be stopped for."""
    order = json.loads(sys.stdin.buffer.readline())
    try:
        stop = _by_frames(order) if order["descriptor"] is not None else _by_connection(order)
    except TwoRelayError as error:
        _say(str(error))
        return error.exit_code
    _say("ready")
    why = _watch(order["limit"], stop)
    if why:
        report = stop.now()
        with contextlib.suppress(Exception), Journal(Path(order["home"])) as journal:
            journal.note(order["run"], f"guardian: {why}; {report}")
    return 0


def _say(text: str) -> None:
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
            self._drive.other_master()

    def now(self) -> str:
        """Stop; once more on a fresh connection, should the first one have died."""
        report: StopReport = self._drive.stop()
        if report.deenergised is None:
            with contextlib.suppress(TwoRelayError):
                report = self._connected().stop()
        return str(report)


class _ByFrames:
    """An inherited descriptor, and what to write to it."""

    def __init__(self, descriptor: int, frames: list[tuple[str, float]]) -> None:
        self._descriptor = descriptor
        self._frames = [(bytes.fromhex(text), pause) for text, pause in frames]

    def idle(self) -> None:
        """The port is the loop's."""

    def now(self) -> str:
        """Write the frames; nobody reads the answers."""
        os.set_blocking(self._descriptor, True)
        for frame, pause in self._frames:
            with contextlib.suppress(OSError):
                os.write(self._descriptor, frame)
            time.sleep(pause)
        return "stop frames sent; not verified"


def _by_connection(order: dict[str, Any]) -> _ByConnection:
    return _ByConnection(Axis.model_validate_json(json.dumps(order["axis"])))


def _by_frames(order: dict[str, Any]) -> _ByFrames:
    return _ByFrames(order["descriptor"], order["frames"])


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


def _listen(words: queue.Queue[bytes]) -> None:
    while True:
        word = os.read(0, 4096)
        words.put(word)
        if not word:
            return


if __name__ == "__main__":
    sys.exit(main())
