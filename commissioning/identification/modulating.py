"""Friction, inertia and dead time by modulating functions: no settling, no period, no derivative.

For a rigid axis  J·ÿ + B·ẏ = u(t−τ) − F − offset  is multiplied by a φ that vanishes with its first
derivatives at both ends of a window, and integrated by parts (Shinbrot 1957; Preisig and Rippin 1993;
method.md 3a):

    J·∫φ''·y − B·∫φ'·y + f·∫φ·sign(ẏ) + offset·∫φ = ∫φ·u(t−τ)

φ is sin⁴ at the samples and straight between them. For such a φ the integrals are sums of hat moments
(`signals`), exact at any sampling: late cycles and lost samples are nothing special. Many windows of two
widths make a linear least-squares problem; τ joins it by its derivative. Velocity, reversals and ∫y
between the samples come from the model itself (`motion`) and are improved from pass to pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.estimate import Estimate
from commissioning.identification.friction_laws import Law, Rung, curve
from commissioning.identification.motion import Model, Motion
from commissioning.identification.record import (
    Kinematics,
    Record,
    kinematics,
    rests,
    reversals,
)
from commissioning.identification.signals import hat_moments

__all__ = ["Fit", "ModulatingEstimate", "estimate", "refined_kinematics"]

Array = NDArray[np.float64]

_WIDTHS = (0.5, 0.2)  # of the period
_SHIFT = 0.1  # of a window's width
_NARROWER, _FEW_SAMPLES = 0.4, 60  # each width of the last, down to this many samples
_MEAN_WEIGHT = 0.375  # of sin⁴
_NARROWEST = 6  # samples in a window
_FEWEST_REVERSALS = 6
_FEWEST_WINDOWS = 20
_LONGEST_DELAY, _LONGEST_LEAD = 0.25, 0.5  # of the period, and s
_DELAYS = 12  # first guesses of the dead time
_MOST_PASSES = 12
_SETTLING_PASSES = 4  # of a motion whose model is known
_FLOOR = 1e-3  # of a row's torque: what a row may miss beside the noise of the resolution
# the ladder: a richer law must explain held-out periods better by this factor
_BETTER = 0.6
_EXPLAINED = 1e-3  # of the torque: below this nothing is left that a richer law could explain
_EXPLAINS = 0.03  # of the torque: a model that leaves more says nothing about reversals
_NEGATIVE = 0.01  # of the Coulomb friction, at the fastest: negative viscous friction that is noise
_SHAPES = 11  # first guesses of a shape parameter
_MOST_WAVES = 150  # of a position-periodic torque along the swing


@dataclass(frozen=True, slots=True)
class Fit:
    """One law fitted to one record.

    Attributes
    ----------
    law : friction law
    model : inertia, viscous friction, offset, dead time
    coefficients : (k,) of the law's terms, the Coulomb one first, N.m or N
    covariance : (k+4, k+4) of inertia, viscous, offset, coefficients, dead time; jackknife over periods
    residual : rms of the fit as a share of the rms of its right-hand side
    held_out : the same on periods that were left out of the fit
    condition : of the scaled least-squares matrix
    halves : Coulomb friction of the odd and of the even periods, N.m or N
    widths : Coulomb friction from the wide windows alone and from the narrow ones alone, N.m or N
    """

    law: Law
    model: Model
    coefficients: Array
    covariance: Array
    residual: float
    held_out: float
    condition: float
    halves: tuple[float, float]
    widths: tuple[float, float]


@dataclass(frozen=True, slots=True)
class ModulatingEstimate:
    """Result of the fit; each number with its interval.

    Attributes
    ----------
    coulomb, offset : N.m or N
    viscous : N.m.s/rad or N.s/m
    inertia : kg.m2 or kg
    dead_time : s
    law : friction law that the record asks for
    coefficients : of its terms
    low_speed : friction at the lowest speed that the law resolves, where compensation acts, N.m or N
    peak_speed : largest speed of the record, rad/s or m/s
    residual, held_out, rigid_residual : what is left as a share of the torque: of the law, on periods
        that were left out, and of Coulomb friction alone
    condition : of the scaled least-squares matrix; large means that the record cannot tell apart
    halves, widths : relative difference of f between odd and even periods, wide and narrow windows
    noise : what the resolution alone would leave, as a share of the torque
    periods : of the record
    windows : that were used
    reversals : that were found
    """

    coulomb: Estimate
    offset: Estimate
    viscous: Estimate
    inertia: Estimate
    dead_time: Estimate
    law: Law
    coefficients: Array
    low_speed: float
    peak_speed: float
    residual: float
    held_out: float
    rigid_residual: float
    condition: float
    halves: float
    widths: float
    noise: float
    periods: float
    windows: int
    reversals: int

    def curve(self, speed: Array) -> Array:
        """Friction against speed, mean of both directions, (n,) N.m or N."""
        return curve(self.law, self.coefficients, self.viscous.value, speed)


def estimate(
    record: Record, *, ladder: bool = True, any_motion: bool = False
) -> ModulatingEstimate:
    """Fit the record; raises ValueError when it is too short.

    Two amplitudes are needed in the record to tell Coulomb from viscous friction. `ladder`: look for a
    richer friction law where Coulomb friction leaves something unexplained. `any_motion`: the record is
    no oscillation; windows of many widths are used, none in which the axis rests.
    """
    fitter = _Fitter(record)
    if any_motion:
        samples = fitter.period / fitter.step
        count = max(int(np.log(0.5 * samples / _FEW_SAMPLES) / np.log(1 / _NARROWER)) + 1, 2)
        shares = tuple(float(x) for x in 0.5 * _NARROWER ** np.arange(count))
        fitter = _Fitter(record, shares, rests(record))
    rigid = best = fitter.fit(Law())
    if ladder:
        best = _climb(fitter, rigid)
    return fitter.estimate(best, rigid)


def refined_kinematics(record: Record) -> Kinematics:
    """Velocity and its sign changes, by the model where it explains the record.

    A rigid axis gives them to a hundredth of a sample; else the samples alone do.
    """
    try:
        fitter = _Fitter(record)
    except ValueError:
        return kinematics(record)
    fit = fitter.fit(Law())
    if not fit.held_out < _EXPLAINS:
        return kinematics(record)
    motion = fitter.motion_of(fit)
    return Kinematics(motion.instants, motion.begins, motion.speed)


def _climb(fitter: _Fitter, rigid: Fit) -> Fit:
    """The simplest law that no richer one beats clearly on held-out periods."""
    best = rigid
    for _ in range(2):
        if best.held_out < max(_EXPLAINED, 1.2 * fitter.noise(best)):
            return best
        richer = [
            found
            for rung in _beside(best.law)
            if (found := fitter.with_rung(best, rung)) is not None
        ]
        if not richer:
            return best
        challenger = min(richer, key=lambda fit: fit.held_out)
        if not challenger.held_out < _BETTER * best.held_out:
            return best
        best = challenger
    return best


def _beside(law: Law) -> tuple[Rung, ...]:
    """Rungs that may be added to a law."""
    rungs: list[Rung] = []
    if law.stribeck is None and law.soft is None:
        rungs += ["stribeck", "soft"]
    if not law.load:
        rungs.append("load")
    if law.position is None:
        rungs.append("position")
    return tuple(rungs)


class _Fitter:
    """Windows over one record, and the fits that were tried.

    `shares`: widths of the windows as shares of the period; `at_rest`: (m, 2) begin and end of stretches
    at rest, s, which no window may touch.
    """

    def __init__(
        self,
        record: Record,
        shares: tuple[float, ...] = _WIDTHS,
        at_rest: Array | None = None,
    ) -> None:
        instants, begins = reversals(record)
        if len(instants) < _FEWEST_REVERSALS:
            raise ValueError(
                f"the record has {len(instants)} velocity reversals; {_FEWEST_REVERSALS} are needed"
            )
        self.record = record
        self.count = len(instants)
        self.period = 2 * float(np.median(np.diff(instants)))
        self._begin = (instants, begins)
        time = record.time
        self.step = float(np.median(np.diff(time)))
        self._windows = _Windows(
            time, shares, self.period, self.step, np.zeros((0, 2)) if at_rest is None else at_rest
        )
        if len(self._windows) < _FEWEST_WINDOWS:
            raise ValueError(
                f"the record has room for {len(self._windows)} windows of half a period only"
            )
        h = np.diff(time)
        self._accelerations = self._windows @ hat_moments(
            time, record.position - record.position[0]
        )
        self._ones = self._windows @ (0.5 * (h[1:] + h[:-1]))
        swing = record.command - record.command.mean()
        if not np.ptp(record.command):
            raise ValueError("the torque is constant: it excites nothing")
        self._typical = float(np.abs(swing).mean()) * _MEAN_WEIGHT * self._windows.width
        speeds = np.abs(np.diff(record.position) / h)
        self._fast = float(np.quantile(speeds, 0.99))
        self._quantum = record.resolution / sqrt(12)

    # -- one fit -----------------------------------------------------------------------------------

    def fit(self, law: Law, start: Fit | None = None) -> Fit:
        """Fit `law`, from the beginning or from another fit of the same record."""
        motion = self.motion_of(start) if start else Motion(self.record, *self._begin, self.period)
        model = start.model if start else None
        delay = model.dead_time if model else self._first_delay(motion, law)
        inertia = model.inertia if model else 0.0
        problem = self._problem(motion, law, delay, inertia)
        for number in range(_MOST_PASSES):
            for _ in range(4 if number == 0 and start is None else 1):
                problem = self._problem(motion, law, delay, inertia)
                solution = problem.solution
                delay += float(np.clip(solution[-1], -self.period / 16, self.period / 16))
                delay = min(max(delay, -self.step), 1.2 * _LONGEST_DELAY * self.period)
                inertia = float(solution[0])
            model = Model(inertia, float(solution[1]), float(solution[2]), delay)
            if not inertia > 0:
                break
            friction = law.terms(motion.cells) @ solution[3:-1]
            moved = motion.update(model, friction)
            if moved < 1e-3 * self.step and abs(solution[-1]) < 1e-3 * self.step:
                break
        problem = self._problem(motion, law, delay, inertia)
        assert model is not None
        return problem.fit(law, model, self._periods_of_rows, self._windows.is_wide)

    def motion_of(self, fit: Fit) -> Motion:
        """The motion as a fit has it."""
        motion = Motion(self.record, *self._begin, self.period)
        for _ in range(_SETTLING_PASSES):
            motion.update(fit.model, fit.law.terms(motion.cells) @ fit.coefficients)
        return motion

    def with_rung(self, fit: Fit, rung: Rung) -> Fit | None:
        """The fit with one more rung at its best shape; None where the record cannot show it."""
        if rung == "load":
            return self._checked(self.fit(replace(fit.law, load=True), fit))
        motion = self.motion_of(fit)
        if rung == "position":
            shapes = self._pitches(motion, fit)
        else:
            shapes = np.geomspace(0.01, 0.8, _SHAPES) * self._fast
        if len(shapes) < 3:
            return None
        laws = [_with_shape(fit.law, rung, float(shape)) for shape in shapes]
        costs = [self._cost(motion, law, fit.model) for law in laws]
        at = int(np.argmin(costs))
        shape = self._refined(motion, fit, rung, shapes, at)
        found = self.fit(_with_shape(fit.law, rung, shape), fit)
        if rung != "position":  # the first shape was sought with a velocity that knew nothing of it
            motion = self.motion_of(found)
            around = np.array([shape / 1.6, shape, shape * 1.6])
            shape = self._refined(motion, found, rung, around, 1)
            found = self.fit(_with_shape(fit.law, rung, shape), found)
        return self._checked(found)

    def _checked(self, fit: Fit) -> Fit | None:
        """None for a fit that is no friction."""
        if not fit.model.inertia > 0 or not fit.coefficients[0] > 0:
            return None
        if fit.model.viscous * self._fast < -3 * _NEGATIVE * fit.coefficients[0]:
            return None
        if fit.law.stribeck is not None and fit.coefficients[1] < 0:
            return None
        if fit.law.position is not None and np.hypot(*fit.coefficients[-2:]) > fit.coefficients[0]:
            return None
        if fit.law.load and fit.coefficients[fit.law.load_term] < 0:
            return None
        return fit

    def _pitches(self, motion: Motion, fit: Fit) -> Array:
        """Three pitches about the one whose waves explain most of what `fit` leaves, rad or m."""
        time, y = self.record.time, self.record.position
        swing, steps = float(np.ptp(y)), np.abs(np.diff(y))
        finest = max(8 * self.record.resolution, 2.5 * float(np.quantile(steps, 0.8)))
        waves = np.arange(1.0, min(swing / finest, _MOST_WAVES), 0.5)  # along the swing
        if len(waves) < 3:
            return np.array([])
        problem = self._problem(motion, fit.law, fit.model.dead_time, fit.model.inertia)
        angle = 2 * np.pi / swing * y[1:-1]
        middle = 0.5 * (time[2:] - time[:-2])
        gains = []
        for number in waves:  # wide windows see no waves
            turned = np.column_stack((np.cos(number * angle), np.sin(number * angle)))
            columns = self._windows.narrow @ (turned * middle[:, None])
            gains.append(problem.explained_by(columns, self._windows.is_narrow))
        best = float(waves[int(np.argmax(gains))])
        return swing / np.array([best + 0.4, best, max(best - 0.4, 0.6)])

    def _refined(self, motion: Motion, fit: Fit, rung: Rung, shapes: Array, at: int) -> float:
        """Golden section about the best of the first guesses."""
        a, b = np.log(shapes[max(at - 1, 0)]), np.log(shapes[min(at + 1, len(shapes) - 1)])
        ratio = (sqrt(5) - 1) / 2
        for _ in range(12):
            c, d = b - ratio * (b - a), a + ratio * (b - a)
            left, right = (
                self._cost(motion, _with_shape(fit.law, rung, float(np.exp(x))), fit.model)
                for x in (c, d)
            )
            a, b = (a, d) if left < right else (c, b)
        return float(np.exp((a + b) / 2))

    def _cost(self, motion: Motion, law: Law, model: Model) -> float:
        """Held-out residual of a law, the motion taken as it is.

        Viscous friction is not negative: a law that needs that takes one for the other.
        """
        problem = self._problem(motion, law, model.dead_time, model.inertia)
        taken = -problem.solution[1] * self._fast / abs(problem.solution[3])
        return problem.held_out(self._periods_of_rows) + max(float(taken) - _NEGATIVE, 0.0)

    def _problem(self, motion: Motion, law: Law, delay: float, inertia: float) -> _Problem:
        time = self.record.time
        terms = law.terms(motion.cells)
        moments = (
            hat_moments(time, motion.integral),
            motion.cells.hat_moments(time, terms),
            hat_moments(time, motion.torque.integral(time - delay)),
            hat_moments(time, motion.torque.double_integral(time - delay)),
        )
        sums = self._windows @ np.column_stack(moments)
        left = np.column_stack(
            (self._accelerations, sums[:, 0], self._ones, sums[:, 1:-2], sums[:, -2])
        )
        return _Problem(left, sums[:, -1], 1 / self._misses(inertia))

    def _first_delay(self, motion: Motion, law: Law) -> float:
        """Dead time of the least residual on a coarse grid, s."""
        grid = np.linspace(0, 0.8 * _LONGEST_DELAY * self.period, _DELAYS)
        costs = [self._problem(motion, law, float(delay), 0.0).without_delay() for delay in grid]
        return float(grid[int(np.argmin(costs))])

    @cached_property
    def _periods_of_rows(self) -> NDArray[Any]:
        """Number of the period that each window lies in."""
        begin = self.record.time[0]
        return np.asarray((self._windows.centre - begin) // self.period, int)

    def noise(self, fit: Fit) -> float:
        """Residual that the resolution alone leaves, as a share of the torque."""
        noise = fit.model.inertia * self._quantum * self._windows.noise
        misses = self._misses(fit.model.inertia)
        return float(np.linalg.norm(noise / misses) / np.linalg.norm(self._typical / misses))

    def _misses(self, inertia: float) -> Array:
        """What each row may miss: the noise of the resolution, and a share of its torque."""
        noise = inertia * self._quantum * self._windows.noise
        result: Array = np.hypot(noise, _FLOOR * self._typical)
        return result

    # -- numbers with intervals --------------------------------------------------------------------

    def estimate(self, fit: Fit, rigid: Fit) -> ModulatingEstimate:
        """The fit as numbers."""
        errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0))
        f = float(fit.coefficients[0])
        motion = self.motion_of(fit)
        peak = float(np.abs(motion.cells.velocity).max())
        slowest = fit.law.stribeck or 0.02 * peak
        low = float(
            curve(fit.law, fit.coefficients, fit.model.viscous, np.array([0.2 * slowest]))[0]
        )
        swing = float(np.abs(self.record.command - self.record.command.mean()).mean())
        left = swing * fit.residual  # torque that no term explains, N.m or N
        halves, widths = (abs(a - b) for a, b in (fit.halves, fit.widths))
        if self._windows.width.min() < 2 * _NARROWEST * self.step:
            widths = 0.0  # too few samples in the narrow windows to say anything
        model = fit.model
        return ModulatingEstimate(
            coulomb=Estimate.around(f, float(errors[3]), 5e-4 * f + 0.5 * left + 0.25 * widths),
            offset=Estimate.around(model.offset, float(errors[2]), 5e-4 * f + 0.3 * left),
            viscous=Estimate.around(
                model.viscous, float(errors[1]), 2e-3 * abs(model.viscous) + left / peak
            ),
            inertia=Estimate.around(
                model.inertia,
                float(errors[0]),
                model.inertia * (1e-3 + fit.residual),
            ),
            dead_time=Estimate.around(
                max(model.dead_time, 0.0),
                float(errors[-1]),
                0.01 * self.step + 0.02 * model.dead_time,
            ),
            law=fit.law,
            coefficients=fit.coefficients,
            low_speed=low,
            peak_speed=peak,
            residual=fit.residual,
            held_out=fit.held_out,
            rigid_residual=rigid.held_out,
            condition=fit.condition,
            halves=halves / abs(f) if f else float("inf"),
            widths=widths / abs(f) if f else float("inf"),
            noise=self.noise(fit),
            periods=float(self.record.time[-1] - self.record.time[0]) / self.period,
            windows=len(self._windows),
            reversals=self.count,
        )


def _with_shape(law: Law, rung: Rung, shape: float) -> Law:
    if rung == "stribeck":
        return replace(law, stribeck=shape)
    if rung == "soft":
        return replace(law, soft=shape)
    return replace(law, position=shape)


class _Windows:
    """sin⁴ windows of all widths over the inner samples, as a sparse matrix.

    Attributes
    ----------
    noise : (n,) what white noise of unit rms in the position makes in J = 1 times each row
    centre, width : (n,) s
    is_wide, is_narrow : (n,) whether a row belongs to the widest, to the narrowest windows
    narrow : the rows of the narrowest alone
    """

    def __init__(
        self, time: Array, shares: tuple[float, ...], period: float, step: float, rests: Array
    ) -> None:
        from scipy.sparse import csr_array

        inner = time[1:-1]
        begins: list[Array] = []
        widths: list[Array] = []
        lead = min(_LONGEST_DELAY * period, _LONGEST_LEAD)
        for share in shares:
            width = max(share * period, _NARROWEST * step)
            starts = np.arange(time[0] + lead, time[-1] - width, _SHIFT * width)
            for rest_begin, rest_end in rests:  # windows in which the axis rests tell nothing
                starts = starts[(starts + width < rest_begin) | (starts > rest_end)]
            begins.append(starts)
            widths.append(np.full(len(starts), width))
        begin, width_of = np.concatenate(begins), np.concatenate(widths)
        first = np.searchsorted(inner, begin)
        last = np.searchsorted(inner, begin + width_of)
        counts = last - first
        pointers = np.concatenate(([0], np.cumsum(counts)))
        rows = np.repeat(np.arange(len(begin)), counts)
        columns = np.arange(pointers[-1]) - np.repeat(pointers[:-1] - first, counts)
        x = (inner[columns] - begin[rows]) / width_of[rows]
        phi = np.sin(np.pi * x) ** 4
        self._matrix = csr_array((phi, columns, pointers), shape=(len(begin), len(inner)))
        self.is_narrow = width_of == (width_of.min() if len(width_of) else 0.0)
        self.narrow = self._matrix[np.flatnonzero(self.is_narrow)]
        # rms of Σ φ_k·D_k for white noise in y: the norm of D^T·φ, from sin⁴'s second derivative
        mean_square = 4 * np.pi**4  # of φ'' for unit width
        self.noise = np.sqrt(mean_square * step / width_of**3)
        self.centre = begin + 0.5 * width_of
        self.width = width_of
        self.is_wide = width_of == width_of.max() if len(width_of) else np.zeros(0, bool)

    def __len__(self) -> int:
        return len(self.centre)

    def __matmul__(self, moments: Array) -> Array:
        result: Array = self._matrix @ moments
        return result


class _Problem:
    """Weighted least squares: columns inertia, viscous, offset, the law's terms, change of dead time."""

    def __init__(self, left: Array, right: Array, weights: Array) -> None:
        self._weights = weights
        self._left = left * weights[:, None]
        self._right = right * weights
        self._scale = np.linalg.norm(self._left, axis=0)
        self._scale[self._scale == 0] = 1.0

    def _solve(self, rows: Any = slice(None), columns: Any = slice(None)) -> Array:
        scale = self._scale[columns]
        a = self._left[rows][:, columns] / scale
        solution, *_ = np.linalg.lstsq(a, self._right[rows], rcond=None)
        result: Array = solution / scale
        return result

    @cached_property
    def solution(self) -> Array:
        """Of all rows."""
        return self._solve()

    def without_delay(self) -> float:
        """Relative residual with the dead time as it is."""
        solution = self._solve(columns=slice(0, -1))
        rest = self._right - self._left[:, :-1] @ solution
        return float(np.linalg.norm(rest) / np.linalg.norm(self._right))

    def explained_by(self, columns: Array, rows: NDArray[np.bool_]) -> float:
        """Share of the residual's square of some rows that further columns take away.

        `columns` : (rows, k) before weighting
        """
        more = columns * self._weights[rows][:, None]
        a = self._left[rows] / self._scale
        rest = self._right[rows] - self._left[rows] @ self.solution
        more = more - a @ np.linalg.lstsq(a, more, rcond=None)[0]
        left = rest - more @ np.linalg.lstsq(more, rest, rcond=None)[0]
        return 1 - float(left @ left) / float(rest @ rest)

    def held_out(self, periods: NDArray[Any]) -> float:
        """Relative residual on the odd periods of a fit to the even ones, and the other way round."""
        odd = periods % 2 == 1
        if odd.all() or not odd.any():
            return float("inf")
        square = 0.0
        for fitted, left_out in ((odd, ~odd), (~odd, odd)):
            rest = self._right[left_out] - self._left[left_out] @ self._solve(fitted)
            square += float(rest @ rest)
        return sqrt(square) / float(np.linalg.norm(self._right))

    def fit(self, law: Law, model: Model, periods: NDArray[Any], is_wide: NDArray[Any]) -> Fit:
        """Everything that this problem tells."""
        solution = self.solution
        rest = self._right - self._left @ solution
        a = self._left / self._scale
        odd = periods % 2 == 1
        coulomb = 3
        return Fit(
            law,
            model,
            solution[3:-1],
            self._jackknife(periods),
            float(np.linalg.norm(rest) / np.linalg.norm(self._right)),
            self.held_out(periods),
            float(np.linalg.cond(a)),
            (float(self._solve(odd)[coulomb]), float(self._solve(~odd)[coulomb])),
            (float(self._solve(is_wide)[coulomb]), float(self._solve(~is_wide)[coulomb])),
        )

    def _jackknife(self, periods: NDArray[Any]) -> Array:
        """Covariance of the solution by leaving out one period at a time.

        Neighbouring windows overlap, so rows are no independent data; periods nearly are.
        """
        a, b = self._left / self._scale, self._right
        whole, moment = a.T @ a, a.T @ b
        numbers = np.unique(periods)
        found = []
        for number in numbers:
            rows = periods == number
            part = a[rows]
            found.append(
                np.linalg.lstsq(whole - part.T @ part, moment - part.T @ b[rows], rcond=None)[0]
            )
        count = len(numbers)
        if count < 3:
            return np.full((a.shape[1], a.shape[1]), np.inf)
        spread = np.array(found) - np.mean(found, axis=0)
        small = 1 + 3 / count  # Student's t over 2 for so few periods, about
        covariance: Array = (count - 1) / count * spread.T @ spread * small**2
        return covariance / np.outer(self._scale, self._scale)
