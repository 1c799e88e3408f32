"""Friction from two oscillations of one period by the exact harmonic balance (method.md 3).

In a periodic steady state the linear part obeys, at every harmonic and without approximation,

    Y = G(jω)·(U − f̄·S)          f̄ = f/G_in(jω)

with U, Y, S the Fourier coefficients of the torque command as it was sent, of the position, and of
the sign of the velocity. Two oscillations of different size share G, so both G and f̄ follow: no
model.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.errors import NotShown
from commissioning.identification.estimate import Estimate
from commissioning.identification.record import Kinematics, Record
from commissioning.identification.signals import Steps

__all__ = ["HARMONICS", "Balance", "LockIn", "Phasors", "balance", "lock_in", "phasors"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

HARMONICS = (1, 3, 5)
_FINE = 5  # points of integration a sample
_OUTLIER = 5.0  # times the median distance from the mean: a period that is rejected
_ALWAYS_SOUND = 5e-3  # of the position: a period that obeys the balance so well is never rejected
_FEWEST = 3  # periods of each oscillation
_NOISE, _HIDDEN = 4.5, 0.05  # of f, for each h² counts of half-swing; more hides a harmonic
_RIGID = 0.05  # of the inertia, by which harmonic 3 may differ where there is no resonance
_MOST_REJECTED = 0.4  # of the periods


@dataclass(frozen=True, slots=True)
class Phasors:
    """Fourier coefficients of every period of one oscillation, (periods, harmonics) each.

    Amplitudes are half-swings: a cosine of half-swing a has the coefficient a.

    Attributes
    ----------
    torque, position, sign : U in N.m or N, Y in rad or m, S
    mean_torque, mean_sign : (periods,) DC of U and of S
    period : s
    half_swing : rad or m, largest distance from the middle, half of peak to peak
    """

    torque: Complex
    position: Complex
    sign: Complex
    mean_torque: Array
    mean_sign: Array
    period: float
    half_swing: float

    def chosen(self, keep: NDArray[np.bool_]) -> Phasors:
        """The periods that are kept."""
        return Phasors(
            self.torque[keep], self.position[keep], self.sign[keep], self.mean_torque[keep],
            self.mean_sign[keep], self.period, self.half_swing,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Balance:
    """Solution at one harmonic.

    Attributes
    ----------
    plant : G(jω), rad/(N.m) or m/N, input dynamics and dead time included
    friction : f̄, complex, N.m or N
    """

    plant: complex
    friction: complex


@dataclass(frozen=True, slots=True)
class LockIn:
    """What two oscillations of one period tell.

    Attributes
    ----------
    coulomb, offset, viscous, inertia, dead_time : with intervals
    complex_coulomb : f̄ at the fundamental, N.m or N
    plant : G(jω) at the fundamental
    harmonics : f by the balance at harmonics 1, 3, 5 each, N.m or N
    elastic : whether harmonic 3 shows another inertia than the fundamental
    apart : how far those that the resolution does not hide are from the fundamental's, as a share
        of it; infinite where it hides all
    period : s
    half_swing, fundamental : of both oscillations, rad or m
    periods, rejected : of both oscillations, used and left out
    """

    coulomb: Estimate
    offset: Estimate
    viscous: Estimate
    inertia: Estimate
    dead_time: Estimate
    complex_coulomb: complex
    plant: complex
    harmonics: tuple[float, ...]
    apart: float
    elastic: bool
    period: float
    half_swing: tuple[float, float]
    fundamental: tuple[float, float]
    periods: tuple[int, int]
    rejected: tuple[int, int]


def phasors(
    record: Record, kinematics: Kinematics, begin: float, period: float, count: int
) -> Phasors:
    """Coefficients of `count` periods from `begin` (s), each about its own begin.

    `begin` should lie away from the switchings of the torque and from the reversals.
    """
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(record.time, record.position)
    torque = Steps(record.sent, record.command)
    sign = Steps.sign(float(record.time[0]), kinematics.begins, kinematics.instants)
    samples = max(int(np.sum((record.time >= begin) & (record.time < begin + period))), 8)
    fine = (np.arange(_FINE * samples) + 0.5) / (_FINE * samples)
    starts = np.asarray(begin + period * np.arange(count), np.float64)
    y = spline(starts[:, None] + period * fine)
    middle = 0.5 * (y.max(axis=1) + y.min(axis=1))
    harmonics = np.array(HARMONICS)
    turn = np.exp(-2j * pi * np.outer(fine, harmonics))
    position = 2 / len(fine) * ((y - middle[:, None]) @ turn)
    # a period that does not close moves the inertia, too: Y is −1/ω² of the acceleration's
    # coefficient
    ends = np.stack((starts, starts + period))
    drift = np.diff(spline(ends), axis=0).T
    faster = np.diff(kinematics.speed(ends), axis=0).T
    w = 2 * pi / period * harmonics
    position = position - 2 / (period * w**2) * (faster + 1j * w * drift)
    return Phasors(
        torque.fourier(starts, period, harmonics),
        position,
        sign.fourier(starts, period, harmonics),
        (torque.integral(starts + period) - torque.integral(starts)) / period,
        (sign.integral(starts + period) - sign.integral(starts)) / period,
        period,
        float(np.mean(np.ptp(y, axis=1)) / 2),
    )


def balance(first: Phasors, second: Phasors, harmonic: int = 0) -> Balance:
    """Solve Y = G·U − (G·f̄)·S at one harmonic (index into HARMONICS) over all periods of both.

    One period of each is the closed form  f̄ = (Y1·U2 − Y2·U1)/(Y1·S2 − Y2·S1).
    """
    rows, right = [], []
    for phasor in (first, second):
        size = float(np.mean(np.abs(phasor.position[:, harmonic])))
        if not size > 0:
            raise NotShown("an oscillation has no amplitude")
        rows.append(np.column_stack((phasor.torque[:, harmonic], -phasor.sign[:, harmonic])) / size)
        right.append(phasor.position[:, harmonic] / size)
    solution, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)
    plant, product = complex(solution[0]), complex(solution[1])
    return Balance(plant, product / plant)


def lock_in(first: Phasors, second: Phasors, resolution: float, cycle: float) -> LockIn:
    """All that the balance tells, with intervals; raises ValueError for too few sound periods."""
    kept = _sound(first, second)
    rejected = tuple(int(np.sum(~keep)) for keep in kept)
    pair = (first.chosen(kept[0]), second.chosen(kept[1]))
    for number, (phasor, lost) in enumerate(zip(pair, rejected, strict=True), 1):
        periods = len(phasor.mean_sign)
        if periods < _FEWEST or lost > _MOST_REJECTED * (periods + lost):
            raise NotShown(
                f"oscillation {number} has {periods} sound periods of {periods + lost}; the axis "
                "does not settle, or the link is too irregular"
            )
    names, values = _numbers(*pair)
    blocks = [
        _numbers(*(_without(p, k) if n == which else p for n, p in enumerate(pair)))[1]
        for which in (0, 1)
        for k in range(len(pair[which].mean_sign))
    ]
    errors = np.zeros(len(values))
    for which in (0, 1):  # two samples, jackknifed each
        count = len(pair[which].mean_sign)
        part = np.array(blocks[:count] if which == 0 else blocks[-count:])
        errors += (count - 1) / count * ((part - part.mean(axis=0)) ** 2).sum(axis=0)
    errors = np.sqrt(errors) * (1 + 1.5 / min(len(p.mean_sign) for p in pair))
    found = dict(zip(names, zip(values.tolist(), errors.tolist(), strict=True), strict=True))
    solved = [balance(*pair, k) for k in range(len(HARMONICS))]
    f, period = found["coulomb"][0], first.period
    w = 2 * pi / period
    coarse = resolution / min(p.half_swing for p in pair)
    # a reversal is found to a few hundredths of a sample; harmonic 3 shows what else is wrong
    timing = 0.05 * cycle / period
    apart = abs(abs(solved[1].friction) - f)
    share = {
        "coulomb": 1e-3 + 2 * timing + 0.3 * coarse, "offset": 0.0, "inertia": 2e-3 + 2 * timing,
        "viscous": 0.02, "dead_time": 0.02,
    }  # fmt: skip
    stiff = [
        _stiffness(s, w * h, found["dead_time"][0]) for s, h in zip(solved, HARMONICS, strict=True)
    ]
    inertia, other = (
        -one.real / (w * h) ** 2 for one, h in zip(stiff[:2], HARMONICS[:2], strict=True)
    )
    elastic = abs(other / inertia - 1) > _RIGID if inertia else True
    extra = {
        "inertia": abs(other - inertia) if elastic else 0.0,
        "coulomb": min(0.05 * apart, 0.02 * f),
        "offset": 2e-3 * f,
        "viscous": 4 * timing * f * period / (2 * pi * min(p.half_swing for p in pair))
        + (abs(stiff[1].imag / (3 * w) - stiff[0].imag / w) if elastic else 0.0),
        "dead_time": 0.05 * cycle,
    }
    estimates = {
        name: Estimate.around(value, error, share[name] * abs(value) + extra.get(name, 0.0))
        for name, (value, error) in found.items()
    }
    return LockIn(
        **estimates,
        complex_coulomb=solved[0].friction,
        plant=solved[0].plant,
        harmonics=tuple(abs(s.friction) for s in solved),
        elastic=bool(elastic),
        apart=max(
            (
                abs(abs(s.friction) / f - 1)
                for s, h in zip(solved[1:], HARMONICS[1:], strict=True)
                if f and _NOISE * h * h * coarse < _HIDDEN
            ),
            default=float("inf"),
        ),
        period=period,
        half_swing=(first.half_swing, second.half_swing),
        fundamental=tuple(float(np.mean(np.abs(p.position[:, 0]))) for p in pair),  # type: ignore[arg-type]
        periods=tuple(len(p.mean_sign) for p in pair),  # type: ignore[arg-type]
        rejected=rejected,  # type: ignore[arg-type]
    )


def _numbers(first: Phasors, second: Phasors) -> tuple[tuple[str, ...], Array]:
    """F = |f̄|, τ = arg(f̄)/ω; with the delay removed 1/G gives J = −Re/ω² and B = Im/ω."""
    w = 2 * pi / first.period
    solved = balance(first, second)
    f = abs(solved.friction)
    delay = float(np.angle(solved.friction)) / w
    stiffness = _stiffness(solved, w, delay)
    offsets = np.concatenate(
        [phasor.mean_torque - f * phasor.mean_sign for phasor in (first, second)]
    )
    names = ("coulomb", "offset", "viscous", "inertia", "dead_time")
    values = (f, float(offsets.mean()), stiffness.imag / w, -stiffness.real / w**2, delay)
    return names, np.array(values)


def _stiffness(solved: Balance, w: float, delay: float) -> complex:
    """1/G at ω, rad/s, without the delay: −J·ω² + jω·B of a rigid axis."""
    return complex(np.exp(-1j * w * delay) / solved.plant)


def _sound(first: Phasors, second: Phasors) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Periods that obey the balance of all others: a late switching alone spoils none."""
    kept = tuple(np.ones(len(p.mean_sign), bool) for p in (first, second))
    for _ in range(3):
        pair = tuple(p.chosen(keep) for p, keep in zip((first, second), kept, strict=True))
        if min(len(p.mean_sign) for p in pair) < _FEWEST:
            break
        solved = balance(pair[0], pair[1])
        for n, phasor in enumerate((first, second)):
            y = phasor.position[:, 0]
            rest = y - solved.plant * (phasor.torque[:, 0] - solved.friction * phasor.sign[:, 0])
            miss = np.abs(rest) / np.abs(y)
            usual = float(np.median(miss[kept[n]]))
            kept[n][miss > max(_OUTLIER * usual, _ALWAYS_SOUND)] = False
    return kept[0], kept[1]


def _without(phasor: Phasors, number: int) -> Phasors:
    keep = np.ones(len(phasor.mean_sign), bool)
    keep[number] = False
    return phasor.chosen(keep)
