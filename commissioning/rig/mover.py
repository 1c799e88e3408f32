"""The drive as experiments move it: its settings, the proof of its watchdog, and the one loop."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from math import inf, nan
from typing import TypeVar

import numpy as np

from commissioning.desk import Desk
from commissioning.envelope import Envelope
from commissioning.experiments.plan import Plan
from commissioning.guardian import Guardian
from commissioning.rig.preflight import SILENCE, Limits, prove_watchdog, set_limits, widen_speed
from commissioning.runner import Recorder, run
from commissioning.settings import Settings
from drivers.drive import Drive
from drivers.errors import WriteFailed
from profiles.errors import TwoRelayError
from profiles.procedures import Mode

__all__ = ["Mover"]

T = TypeVar("T")

_BETWEEN_EXPERIMENTS = 1.0  # s between two samples: two experiments, with the drive off in between


class Mover:
    """What moves the axis of one run; it knows what the drive is prepared for, and how warm it is.

    Attributes
    ----------
    recorder : every sample of the torque experiments
    """

    def __init__(
        self,
        drive: Drive,
        desk: Desk,
        settings: Settings,
        guardian: Guardian,
        limits: Limits,
        recorder: Recorder,
        *,
        without_watchdog: bool,
    ) -> None:
        self.recorder = recorder
        self._drive = drive
        self._desk = desk
        self._settings = settings
        self._guardian = guardian
        self._limits = limits
        self._without_watchdog = without_watchdog
        self._prepared_for = Mode.TORQUE  # by its `before`, which `set_limits` has written
        self._watchdog_fault: str | None = None  # which its proof left behind; None: no proof yet
        self._heat, self._heated = 0.0, 0  # i²t that is left over, and up to which sample

    # -- settings --------------------------------------------------------------------------------

    def within_settings(self, work: Callable[[], T]) -> T:
        """The drive's limits and watchdog around `work`; put back on every way out."""
        failure: BaseException | None = None
        try:
            with self._desk.interruption.deferred():
                set_limits(self._drive, self._settings, self._limits, self._desk.tell)
            return work()
        except BaseException as error:
            failure = error
            raise
        finally:
            self._put_back(failure)

    def _put_back(self, error: BaseException | None) -> None:
        with self._desk.interruption.deferred():
            with contextlib.suppress(TwoRelayError):
                self.clear_own_fault()
            outcome = self._settings.restore()
            if outcome.complete:
                return
            text = (
                f"settings of the experiment are not all back: {outcome}; 'tworelay restore "
                f"{self._settings.run}' tries again"
            )
            if error is None:
                raise WriteFailed(text, code="restore.incomplete")
            if isinstance(error, TwoRelayError):
                error.also(text)

    def clear_own_fault(self) -> None:
        """Acknowledge what the drive's watchdog said of the silence in which it was stopped."""
        if self._watchdog_fault and self._drive.state().fault == self._watchdog_fault:
            self._drive.reset_fault()

    def widen(self, speed: float) -> None:
        """The drive may let the axis go as fast as `speed` (rad/s or m/s) says."""
        with self._desk.interruption.deferred():
            widen_speed(self._drive, self._settings, speed)

    def _prepare(self, mode: Mode) -> None:
        """Write what the drive needs in a mode, where it was prepared for another one."""
        if mode is self._prepared_for:
            return
        with self._desk.interruption.deferred():
            for name, raw in self._drive.preparation.settings(mode).items():
                self._settings.write("experiment", name, raw)
        self._prepared_for = mode

    # -- motion ----------------------------------------------------------------------------------

    def prove_watchdog(self, rest: float) -> None:
        """See the drive stop by itself under the torque `rest` (N.m or N) that holds the axis."""
        self._prepare(Mode.TORQUE)
        is_first = self._watchdog_fault is None
        if is_first and not self._without_watchdog:
            silence = SILENCE * self._drive.watchdog.timeout
            self.recorder.phase(f"proof of the watchdog: silence for {silence * 1000:.0f} ms")
        self._watchdog_fault = prove_watchdog(
            self._drive, rest, self._limits.travel, self._desk.interruption,
            self._desk.tell if is_first else lambda text: None,
            without=self._without_watchdog, before=self._watchdog_fault,
        )  # fmt: skip

    def move(
        self, plan: Plan[T], envelope: Envelope, rest: float, *, leave_moving: bool = False
    ) -> T:
        """Drive a plan that moves the axis: the drive's watchdog is proved first."""
        self.prove_watchdog(rest)
        return self.hold(plan, envelope, rest, leave_moving=leave_moving)

    def hold(
        self, plan: Plan[T], envelope: Envelope, rest: float, *, leave_moving: bool = False
    ) -> T:
        """Drive a plan in torque mode, from and to the torque `rest` (N.m or N)."""
        envelope = replace(envelope, spent=self.spent, heat=self.heat_left())
        self._prepare(Mode.TORQUE)
        return run(
            plan, self._drive, envelope, self.recorder, self._desk.interruption,
            rest=rest, leave_moving=leave_moving, guardian=self._guardian,
        )  # fmt: skip

    def follow(self, plan: Callable[[float], Plan[T]], envelope: Envelope, recorder: Recorder) -> T:
        """Drive a plan in position mode from where the axis is, rad or m."""
        envelope = replace(envelope, rated=inf, thermal=inf, bias=nan)
        self._prepare(Mode.POSITION)
        here = self._drive.read("position_actual").si
        return run(
            plan(here), self._drive, envelope, recorder, self._desk.interruption,
            mode=Mode.POSITION, guardian=self._guardian,
        )  # fmt: skip

    @property
    def is_energised(self) -> bool:
        """Whether the drive says that it controls the axis."""
        return self._drive.state().is_energised

    # -- what was spent --------------------------------------------------------------------------

    @property
    def spent(self) -> float:
        """Time since the first sample, s."""
        samples = self.recorder.samples
        return samples[-1].time - samples[0].time if samples else 0.0

    def heat_left(self) -> float:
        """Heat of the i²t budget that the experiments have not given back, (N.m)²·s or N²·s."""
        samples = self.recorder.samples
        fresh = samples[max(self._heated - 1, 0) :]
        self._heated = len(samples)
        if len(fresh) > 1:
            time, command = (np.array([getattr(s, k) for s in fresh]) for k in ("time", "command"))
            steps = np.diff(time)
            power = (
                np.where(steps < _BETWEEN_EXPERIMENTS, command[1:] ** 2, 0.0)
                - self._limits.rated**2
            )
            total = self._heat + np.cumsum(power * steps)
            self._heat = float(total[-1] - min(total.min(), 0.0))
        return self._heat
