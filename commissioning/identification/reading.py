"""A point of the plant read from an oscillation with friction, without a describing function.

    P(jω) = Y/(U − F)                                                               (method.md 6)

U, Y, F are the Fourier coefficients of torque, position and friction over whole periods. F is that
of the friction law which the record asks for, on the motion as the model has it between samples; or
f̄·S where no law explains the record and the exact balance gives f̄. U is taken a dead time earlier
and the point turned by it, so that what happens at the edges of a period is right, too:

    (2/T)·∫ÿ·e^(−jωt) = −ω²·Y + (2/T)·(Δẏ + jω·Δy),     (2/T)·∫ẏ·e^(−jωt) = jω·Y + (2/T)·Δy

A period that does not close, Δy, Δẏ ≠ 0, is thus corrected by the model's inertia and viscous
friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.critical_point import CriticalPoint, of_plant
from commissioning.identification.errors import NotShown
from commissioning.identification.estimate import Estimate
from commissioning.identification.fitting import friction_in
from commissioning.identification.friction_laws import Law
from commissioning.identification.lock_in import LockIn, Phasors
from commissioning.identification.modulating import EXPLAINS, ModulatingEstimate
from commissioning.identification.motion import Model, Motion
from commissioning.identification.output_error import OutputErrorEstimate
from commissioning.identification.record import Record, reversals

__all__ = ["Explained", "Reader", "by_balance"]

Complex = NDArray[np.complex128]

_FINE = 5  # points of integration a sample
_PASSES, _SETTLED = 8, 1e-3  # of a motion under a known law; of a sample
_LEAST_ERROR = 2e-3  # of the gain, and in rad: edges of the periods, instants of switchings
_FIRST = np.array([1])


@dataclass(frozen=True, slots=True)
class Explained:
    """A friction law that explains an axis, whichever method found it.

    Attributes
    ----------
    law, coefficients : of friction, the Coulomb one first, N.m or N
    model : of the rest
    instants : of reversals that are known, s
    coulomb, dead_time : with their intervals
    left : share of the torque that is not explained
    middle : where a drift is none, s; None: in the middle of any record
    """

    law: Law
    coefficients: NDArray[np.float64]
    model: Model
    instants: NDArray[np.float64]
    coulomb: Estimate
    dead_time: Estimate
    left: float
    middle: float | None = None

    @classmethod
    def of(cls, found: ModulatingEstimate | OutputErrorEstimate | None) -> Self | None:
        """By what a method found; None where that explains nothing, or no inertia."""
        if found is None or not found.inertia.low > 0:
            return None
        if isinstance(found, ModulatingEstimate):
            fit = found.fit
            if not found.held_out < EXPLAINS:
                return None
            return cls(
                fit.law, fit.coefficients, fit.model, fit.instants, found.coulomb, found.dead_time,
                found.held_out,
            )  # fmt: skip
        if not found.is_explained:
            return None
        law = Law(**{term: True for term in ("load", "drag", "drift") if term in found.terms})
        sizes = [found.coulomb.value, *(found.size(rung) for rung in _in_their_order(law))]
        if law.drift:  # of a level that is relative here, absolute there
            sizes[law.place("drift")] *= found.coulomb.value
        model = Model(
            found.inertia.value, found.viscous.value, found.offset.value, found.dead_time.value
        )
        return cls(
            law, np.array(sizes), model, np.array([]), found.coulomb, found.dead_time, 0.0,
            found.middle,
        )  # fmt: skip

    def during(self, record: Record) -> NDArray[np.float64]:
        """Coefficients at the time of a record: friction that drifts is another one there."""
        if not self.law.drift or self.middle is None:
            return self.coefficients
        found = self.coefficients.copy()
        later = 0.5 * float(record.time[0] + record.time[-1]) - self.middle
        found[0] += found[self.law.place("drift")] * later
        return found


def _in_their_order(law: Law) -> list[Any]:
    return sorted(law.rungs, key=law.place)


class Reader:
    """One record under a friction law, which may come from another record.

    Raises ValueError for a record without enough reversals.
    """

    def __init__(self, record: Record, found: Explained, period: float) -> None:
        instants, begins = reversals(record)
        if len(instants) < 2:
            raise NotShown(f"the oscillation has {len(instants)} velocity reversals")
        self._found = found
        self._model = found.model
        self._friction = friction_in(found.law, found.during(record))
        self._step = float(np.median(np.diff(record.time)))
        fitted = found.instants  # of the record that the law was found in they are known better
        if len(fitted) == len(instants) and np.all(np.abs(fitted - instants) < 2 * self._step):
            instants = fitted
        self._motion = Motion(record, instants, begins, period)
        for _ in range(_PASSES):
            if self._motion.update(self._model, self._friction) < _SETTLED * self._step:
                break

    def point(self, begin: float, period: float, count: int) -> CriticalPoint:
        """The plant over `count` periods of `period` s from `begin` s on."""
        motion, model, found = self._motion, self._model, self._found
        w = 2 * pi / period
        starts = np.asarray(begin + period * np.arange(count), np.float64)
        points = max(round(period / self._step), 8) * _FINE
        fine = (np.arange(points) + 0.5) / points
        y = motion.position(starts[:, None] + period * fine)
        position = 2 / points * (y - y.mean(axis=1, keepdims=True)) @ np.exp(-2j * pi * fine)
        ends = np.stack((starts, starts + period))
        moved = np.diff(motion.position(ends), axis=0)[0]
        faster = np.diff(motion.speed(ends), axis=0)[0]
        torque, braking = (
            motion.cells.signal(values).fourier(starts, period, _FIRST)[:, 0]
            for values in (motion.cells.torque, self._friction(motion.cells))
        )
        edges = 2 / period * (model.inertia * (faster + 1j * w * moved) + model.viscous * moved)
        turn = np.exp(-1j * w * model.dead_time)
        driving = torque - braking - edges
        share = float(np.mean(np.abs(braking)) / np.mean(np.abs(driving)))
        systematic = _LEAST_ERROR + share * _half(found.coulomb) + 0.5 * found.left
        delay = w * (found.dead_time.high - found.dead_time.low) / 2
        turned = float(np.hypot(systematic, delay))
        return _point(turn * position, driving, period, systematic, turned)


def by_balance(phasors: Phasors, found: LockIn) -> CriticalPoint:
    """The point by the exact balance's own friction, where no law explains the record.

    Nothing is assumed of the plant; friction is taken for Coulomb's, on the motor. f̄ is turned
    from the balance's frequency to that of the oscillation by the dead time.
    """
    w, before = 2 * pi / phasors.period, 2 * pi / found.period
    friction = found.complex_coulomb * np.exp(1j * (w - before) * found.dead_time.value)
    braking = friction * phasors.sign[:, 0]
    driving = phasors.torque[:, 0] - braking
    share = float(np.mean(np.abs(braking)) / np.mean(np.abs(driving)))
    delay = abs(w - before) * (found.dead_time.high - found.dead_time.low) / 2
    # friction that acts elsewhere than on the motor gives each harmonic another one
    apart = max(abs(f / found.harmonics[0] - 1) for f in found.harmonics)
    systematic = _LEAST_ERROR + share * (_half(found.coulomb) + delay + 0.5 * min(apart, 1.0))
    return _point(phasors.position[:, 0], driving, phasors.period, systematic, systematic)


def _half(estimate: Estimate) -> float:
    return min(estimate.half_width, 1.0)


def _point(
    position: Complex, driving: Complex, period: float, systematic: float, turned: float
) -> CriticalPoint:
    """Least squares over the periods; `systematic` as a share of the gain, `turned` in rad."""
    value = complex(np.vdot(driving, position) / np.vdot(driving, driving))
    each: Any = position / driving / value
    count = len(each)
    gain = phase = 0.0
    if count > 1:
        # few periods: Student's factor, as everywhere
        wide = 2 * (1 + 1.5 / count) / np.sqrt(count)
        gain, phase = (wide * float(np.std(x, ddof=1)) for x in (each.real, each.imag))
    point = of_plant(value, period)
    return CriticalPoint(
        point.gain,
        point.phase_deg,
        period,
        gain + systematic,
        float(np.degrees(phase + turned)),
        measured=True,
    )
