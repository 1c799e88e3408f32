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

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.critical_point import CriticalPoint, of_plant
from commissioning.identification.errors import NotShown
from commissioning.identification.estimate import Estimate
from commissioning.identification.fitting import friction_in
from commissioning.identification.lock_in import LockIn, Phasors
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.motion import Motion
from commissioning.identification.record import Record, reversals

__all__ = ["Reader", "by_balance"]

Complex = NDArray[np.complex128]

_FINE = 5  # points of integration a sample
_PASSES, _SETTLED = 8, 1e-3  # of a motion under a known law; of a sample
_LEAST_ERROR = 2e-3  # of the gain, and in rad: edges of the periods, instants of switchings
_FIRST = np.array([1])


class Reader:
    """One record under the friction law of `found`, which may come from another record.

    Raises ValueError for a record without enough reversals.
    """

    def __init__(self, record: Record, found: ModulatingEstimate, period: float) -> None:
        instants, begins = reversals(record)
        if len(instants) < 2:
            raise NotShown(f"the oscillation has {len(instants)} velocity reversals")
        self._found = found
        self._model = found.fit.model
        self._friction = friction_in(found.fit.law, found.fit.coefficients)
        self._step = float(np.median(np.diff(record.time)))
        fitted = found.fit.instants  # of the record that the law was found in they are known better
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
        systematic = _LEAST_ERROR + share * _half(found.coulomb) + 0.5 * found.held_out
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
