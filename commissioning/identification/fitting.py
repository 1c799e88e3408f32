"""One friction law fitted to one record by modulating functions, and the next law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.errors import NotShown
from commissioning.identification.friction_laws import Law, Rung
from commissioning.identification.motion import MANY, Cells, Model, Motion, Turning
from commissioning.identification.record import Record, reversals
from commissioning.identification.signals import hat_moments
from commissioning.identification.windows import (
    LONGEST_DELAY,
    MEAN_WEIGHT,
    NARROWEST,
    Problem,
    Windows,
)

__all__ = ["EXPONENTS", "WIDTHS", "Fit", "Fitter", "friction_in"]

Array = NDArray[np.float64]

WIDTHS = (0.5, 0.2)  # of the period
_COULOMB = 3  # place of the Coulomb coefficient in a solution
_FEWEST_REVERSALS = 6
_FEWEST_WINDOWS = 20
_DELAYS = 12  # first guesses of the dead time
_MOST_PASSES = 12
_UNSETTLED, _BETTER = 0.01, 0.7  # held-out residual above which reversals are sought another way
_SETTLING_PASSES = 2  # of a motion whose model is known
_FLOOR = 1e-3  # of a row's torque: what a row may miss beside the noise of the resolution
_NEGATIVE = 0.01  # of the Coulomb friction, at the fastest: negative viscous friction that is noise
_CLEARLY, _WORTH = 6.0, 3e-3  # times its error; of f: a linear term that is there
EXPONENTS = (2.0, 1.0, 0.5)  # of Stribeck curves
_GOLDEN = 8  # steps to the best shape
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
    covariance : (k+4, k+4) of inertia, viscous, offset, coefficients, dead time; jackknife over
        periods
    residual : rms of the fit as a share of the rms of its right-hand side
    held_out : the same on periods that were left out of the fit
    condition : of the scaled least-squares matrix
    halves : Coulomb friction of the odd and of the even periods, N.m or N
    parts : inertia and Coulomb friction of the first and of the second half of the time
    widths : Coulomb friction from the wide windows alone and from the narrow ones alone, N.m or N
    instants : of the reversals, s
    lateness : median distance of the reversals from where the velocity is zero, as a share of a
        sample; where it is not small they make up for something that the law lacks
    """

    law: Law
    model: Model
    coefficients: Array
    covariance: Array
    residual: float
    held_out: float
    condition: float
    halves: tuple[float, float]
    parts: tuple[tuple[float, float], tuple[float, float]]
    widths: tuple[float, float]
    instants: Array
    lateness: float


class Fitter:
    """Windows over one record, and the fits that were tried.

    `shares`: widths of the windows as shares of the period; `at_rest`: (m, 2) begin and end of
    stretches at rest, s, which no window may touch.
    """

    def __init__(
        self,
        record: Record,
        shares: tuple[float, ...] = WIDTHS,
        at_rest: Array | None = None,
    ) -> None:
        instants, begins = reversals(record)
        if not len(instants):
            raise NotShown(
                "the axis moves one way only, or not at all: friction cannot be told from the "
                "offset; record the other direction, too"
            )
        if len(instants) < _FEWEST_REVERSALS:
            raise NotShown(
                f"the record has {len(instants)} velocity reversals; {_FEWEST_REVERSALS} are needed"
            )
        self.record = record
        self.count = len(instants)
        self.period = 2 * float(np.median(np.diff(instants)))
        self._begin = (instants, begins)
        time = record.time
        self.step = float(np.median(np.diff(time)))
        self._windows = Windows(
            time, shares, self.period, self.step, np.zeros((0, 2)) if at_rest is None else at_rest
        )
        if len(self._windows) < _FEWEST_WINDOWS:
            raise NotShown(
                f"the record has room for {len(self._windows)} windows of half a period only"
            )
        h = np.diff(time)
        self._accelerations = self._windows @ hat_moments(
            time, record.position - record.position[0]
        )
        self._ones = self._windows @ (0.5 * (h[1:] + h[:-1]))
        swing = record.command - record.command.mean()
        if not np.ptp(record.command):
            raise NotShown("the torque is constant: it excites nothing")
        self._typical = float(np.abs(swing).mean()) * MEAN_WEIGHT * self._windows.width
        speeds = np.abs(np.diff(record.position) / h)
        self._fast = float(np.quantile(speeds, 0.99))
        self._quantum = record.resolution / sqrt(12)

    # -- one fit -----------------------------------------------------------------------------------

    def fit(self, law: Law, start: Fit | None = None) -> Fit:
        """Fit `law`, from the beginning or from another fit of the same record."""
        found = self._fit(law, start, "speed")
        few = self.period < MANY * self.step  # and with gaps the velocity is not seen well enough
        if few and found.held_out > _UNSETTLED:
            other = self._fit(law, start, "position")
            if other.model.inertia > 0 and other.held_out < _BETTER * found.held_out:
                return other
        return found

    def _fit(self, law: Law, start: Fit | None, by: Turning) -> Fit:
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
                delay = min(max(delay, -self.step), 1.2 * LONGEST_DELAY * self.period)
                inertia = float(solution[0])
            model = Model(inertia, float(solution[1]), float(solution[2]), delay)
            if not inertia > 0:
                break
            moved = motion.update(model, friction_in(law, solution[_COULOMB:-1]), by)
            if moved < 1e-3 * self.step and abs(solution[-1]) < 1e-3 * self.step:
                break
        problem = self._problem(motion, law, delay, inertia)
        assert model is not None
        return self._told(problem, law, model, motion)

    def _told(self, problem: Problem, law: Law, model: Model, motion: Motion) -> Fit:
        """Everything that a solved problem tells."""
        periods, is_wide = self._periods_of_rows, self._windows.is_wide
        odd = periods % 2 == 1
        halves, widths = (
            (float(problem.solve(part)[_COULOMB]), float(problem.solve(~part)[_COULOMB]))
            for part in (odd, is_wide)
        )
        if self._windows.width.min() < 2 * NARROWEST * self.step:
            widths = (widths[0], widths[0])  # too few samples in the narrow windows to say anything
        return Fit(
            law,
            model,
            problem.solution[_COULOMB:-1],
            problem.jackknife(periods),
            problem.residual,
            problem.held_out(periods),
            problem.condition,
            halves,
            self._parts(problem),
            widths,
            motion.instants,
            motion.lateness / self.step,
        )

    def _parts(self, problem: Problem) -> tuple[tuple[float, float], tuple[float, float]]:
        """Inertia and Coulomb friction by the windows of the first half, and of the second."""
        early = self._windows.centre < self.record.time.mean()
        solved = [problem.solve(part) for part in (early, ~early)]
        first, second = ((float(one[0]), float(one[_COULOMB])) for one in solved)
        return first, second

    def motion_of(self, fit: Fit) -> Motion:
        """The motion as a fit has it."""
        motion = Motion(self.record, fit.instants, self._begin[1], self.period)
        for _ in range(_SETTLING_PASSES):
            motion.update(fit.model, friction_in(fit.law, fit.coefficients), "nothing")
        return motion

    def with_rung(self, fit: Fit, rung: Rung) -> Fit | None:
        """The fit with one more rung at its best shape; None where the record cannot show it."""
        if rung in ("load", "drag", "drift"):
            return self._checked(self.fit(_with_term(fit.law, rung), fit))
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

    def with_exponents(self, fit: Fit) -> list[Fit]:
        """A fit with a Stribeck term, and the same with the other shapes of it at their best."""
        found = [fit]
        assert fit.law.stribeck is not None
        motion = self.motion_of(fit)
        for exponent in EXPONENTS:
            if exponent == fit.law.exponent:
                continue
            other = replace(fit, law=replace(fit.law, exponent=exponent))
            around = fit.law.stribeck * np.geomspace(0.03, 3, _SHAPES)
            costs = [
                self._cost(motion, _with_shape(other.law, "stribeck", float(x)), fit.model)
                for x in around
            ]
            shape = self._refined(motion, other, "stribeck", around, int(np.argmin(costs)))
            checked = self._checked(self.fit(_with_shape(other.law, "stribeck", shape), fit))
            if checked is not None:
                found.append(checked)
        return found

    def shows(self, fit: Fit, rung: Rung) -> bool:
        """Whether a linear term stands clearly above its error, the motion taken as it is."""
        law = _with_term(fit.law, rung)
        problem = self._problem(self.motion_of(fit), law, fit.model.dead_time, fit.model.inertia)
        place = _COULOMB + law.place(rung)
        size = abs(float(problem.solution[place]))
        error = float(np.sqrt(problem.jackknife(self._periods_of_rows)[place, place]))
        reach = self.record.time[-1] - self.record.time[0] if rung == "drift" else self._fast**2
        f = abs(float(problem.solution[_COULOMB]))
        return size > _CLEARLY * error and size * float(reach) > _WORTH * f

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
        grows = [rung for rung in fit.law.rungs if rung in ("load", "drag")]
        if any(fit.coefficients[fit.law.place(rung)] < 0 for rung in grows):
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
        for _ in range(_GOLDEN):
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
        taken = -problem.solution[1] * self._fast / abs(problem.solution[_COULOMB])
        return problem.held_out(self._periods_of_rows) + max(float(taken) - _NEGATIVE, 0.0)

    def _problem(self, motion: Motion, law: Law, delay: float, inertia: float) -> Problem:
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
        return Problem(left, sums[:, -1], 1 / self._misses(inertia))

    def _first_delay(self, motion: Motion, law: Law) -> float:
        """Dead time of the least residual on a coarse grid, s."""
        grid = np.linspace(0, 0.8 * LONGEST_DELAY * self.period, _DELAYS)
        costs = [self._problem(motion, law, float(delay), 0.0).without_delay() for delay in grid]
        return float(grid[int(np.argmin(costs))])

    @cached_property
    def _periods_of_rows(self) -> NDArray[Any]:
        """Number of the period that each window lies in."""
        begin = self.record.time[0]
        return np.asarray((self._windows.centre - begin) // self.period, int)

    @property
    def windows(self) -> int:
        """How many windows there are."""
        return len(self._windows)

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


def friction_in(law: Law, coefficients: Array) -> Callable[[Cells], Array]:
    """Friction torque in the cells."""
    return lambda cells: np.asarray(law.terms(cells) @ coefficients, np.float64)


def _with_term(law: Law, rung: Rung) -> Law:
    if rung == "load":
        return replace(law, load=True)
    return replace(law, drag=True) if rung == "drag" else replace(law, drift=True)


def _with_shape(law: Law, rung: Rung, shape: float) -> Law:
    if rung == "stribeck":
        return replace(law, stribeck=shape)
    if rung == "soft":
        return replace(law, soft=shape)
    return replace(law, position=shape)
