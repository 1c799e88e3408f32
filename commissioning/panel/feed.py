"""What the loop tells the panel: how far it is, a few times a second, lost where nobody reads.

The panel is drawn by another process, which this one starts and ends. Its death ends nothing.
"""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from commissioning.panel.course import Course
from commissioning.pipes import Pipe, never_waiting
from commissioning.processes import start
from commissioning.watching import Setting, Stage, Watcher
from drivers.sample import Sample
from profiles.plain import plain
from profiles.procedures import Mode

__all__ = ["Panel"]

_EVERY = 0.1  # s between two pictures
_POINTS = 8  # of the trace, a picture
_LATE = 0.5  # of a cycle
_SLOPE = 6  # samples that a speed is taken over
_LINES, _LONGEST = 4, 160  # that were said last, and characters of one
_LARGEST = 4000  # bytes of a picture: what a pipe takes whole or not at all
_WAITING = 8  # pictures that may wait for a reader
_END = b"\n"
_ENDING = 3.0  # s
RESTORED = "\x1b[?1049l\x1b[?25h"  # the usual screen, and its cursor


class Panel(Watcher):
    """The loop's end of a panel on the terminal.

    Parameters
    ----------
    doing : what the job is called
    to_stderr : the panel is drawn where standard error goes
    """

    def __init__(
        self,
        doing: str,
        *,
        to_stderr: bool,
        clock: Callable[[], float] = time.monotonic,
        started: Callable[..., subprocess.Popen[bytes]] = start,
    ) -> None:
        self._doing = doing
        self._to_stderr = to_stderr
        self._clock = clock
        self._started = started
        self._process: subprocess.Popen[bytes] | None = None
        self._line: Pipe | None = None
        self._course = Course()
        self._setting: dict[str, Any] = {}
        self._friction: list[tuple[float, float | None, float | None]] = []
        self._said: list[str] = []
        self._samples: Sequence[Sample] = ()
        self._told = 0  # samples of them that were told
        self._mode = Mode.TORQUE
        self._late, self._lost, self._cycles = 0, 0, 0
        self._due = -math.inf
        self.has_died = False

    # -- what the job tells ------------------------------------------------------------------------

    def begins(self, setting: Setting, steps: Sequence[Stage]) -> None:
        """Start to draw, if that was not done before."""
        self._setting = asdict(setting) | {
            "doing": self._doing, "torque_limit": setting.torque, "speed_limit": setting.speed,
            "torque": None, "speed": None,
        }  # fmt: skip
        self._course.in_real_time = setting.in_real_time
        self._course.add(steps)
        if self._process is None and not self.has_died:
            self._open()
        self._picture()

    def step(self, name: str) -> None:
        """A step begins."""
        self._course.step(name, self._clock())
        self._said.clear()
        self._picture()

    def lasts(self, seconds: float) -> None:
        """The present step still takes as long."""
        self._course.lasts(seconds, self._clock())

    def phase(self, text: str) -> None:
        """One line more."""
        self._said = [*self._said, plain(text)[:_LONGEST]][-_LINES:]
        self._picture()

    def friction(self, value: float, low: float | None, high: float | None) -> None:
        """What is known by now."""
        self._friction = [*self._friction, (value, low, high)][-_LINES:]
        self._picture()

    def cycle(self, samples: Sequence[Sample], mode: Mode) -> None:
        """A picture every tenth of a second."""
        now = self._clock()
        if now < self._due:
            return
        self._samples, self._mode = samples, mode
        self._picture()
        self._due = now + _EVERY

    @property
    def is_drawn(self) -> bool:
        """Whether the terminal is the panel's."""
        return self._process is not None

    # -- the pipe ----------------------------------------------------------------------------------

    def close(self) -> None:
        """The panel goes, and the screen is as it was."""
        process, self._process = self._process, None
        line, self._line = self._line, None
        if process is None:
            return
        if line is not None:
            with contextlib.suppress(OSError):
                line.write(_END)
            line.end()
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            code = process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        if code != 0:
            self.has_died = True
            stream = sys.stderr if self._to_stderr else sys.stdout
            with contextlib.suppress(OSError, ValueError):
                stream.write(RESTORED)
                stream.flush()

    def _open(self) -> None:
        arguments = ["stderr"] if self._to_stderr else []
        try:
            process = self._started(
                "commissioning.panel.process", *arguments, stdin=subprocess.PIPE
            )
        except OSError:
            self.has_died = True
            return
        assert process.stdin is not None
        self._process = process
        self._line = never_waiting(process.stdin.fileno(), _END, _WAITING)

    def _picture(self) -> None:
        """What is known now, as one line; it is lost where the pipe is full."""
        if self._line is None:
            return
        text = json.dumps(self._state(), separators=(",", ":")).encode()
        if len(text) >= _LARGEST:
            return
        try:
            self._line.write(text + b"\n")
        except BlockingIOError:
            pass
        except OSError:
            self._line, self.has_died = None, True

    def _state(self) -> dict[str, Any]:
        course, now = self._course, self._clock()
        return {
            **self._setting,
            "step": course.name, "number": course.number, "count": course.count,
            "left": course.left(now), "took": course.took(now), "friction": self._friction,
            "said": self._said, **self._motion(),
        }  # fmt: skip

    def _motion(self) -> dict[str, Any]:
        """Where the axis is, and what has happened since the last picture."""
        samples = self._samples
        if len(samples) < self._told:
            self._told = 0  # of another experiment
        new = samples[self._told :]
        self._told = len(samples)
        limit = _LATE * float(self._setting.get("cycle", 0.0))
        self._late += sum(sample.lateness > limit for sample in new)
        self._lost += sum(sample.missed for sample in new)
        self._cycles += len(new)
        counts = {"late": self._late, "lost": self._lost, "cycles": self._cycles}
        if not samples:
            return counts
        last, before = samples[-1], samples[max(len(samples) - 1 - _SLOPE, 0)]
        time_between = last.time - before.time
        torque = last.command if self._mode is Mode.TORQUE else last.torque
        every = max(1, -(-len(new) // _POINTS))
        return counts | {
            "position": last.position,
            "torque": torque if math.isfinite(torque) else None,
            "speed": (last.position - before.position) / time_between if time_between else None,
            "trace": [(round(s.time, 4), s.position) for s in new[::every]],
        }
