"""Friction against speed from records at constant speeds.

    τ = s·(f + b·e^(−(v/vs)²)) + B·v + offset          s = sign(v)

No inertia acts, so each constant speed is one point of the curve. The Stribeck term stays where
every other speed, left out of the fit, is clearly better met with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.errors import NotShown
from commissioning.identification.estimate import Estimate

__all__ = ["SteadyFit", "SteadyPoint", "at_speed", "fit", "plateaus"]

Array = NDArray[np.float64]

_FEWEST_POINTS = 8
_LEAST_SAMPLES = 20  # of a plateau
_REST = 1e-3  # of the largest speed of a recording: below, the axis rests
_IN_NOISE = 0.1  # of the noise of the speed: a mean that is no speed
_MEDIAN = 15  # samples of the running median
_ONE_SPEED = 0.15  # of the speed: a record that wavers by less is one at one speed
_STEP = 0.02  # of the largest speed: a change of speed that begins a new plateau
_LEAST_TORQUE = 0.05  # of the largest: a smaller one weighs no more
_BETTER = 0.85
_CLEARLY = 4.0  # times its error: a Stribeck term that is there
_SYSTEMATIC = 1e-3  # of each number: what a speed that is not quite constant makes
_SHAPES = 40


@dataclass(frozen=True, slots=True)
class SteadyPoint:
    """Means over one stretch of constant speed.

    Attributes
    ----------
    speed : rad/s or m/s, with its sign
    torque : N.m or N
    error : standard error of the torque's mean, N.m or N
    """

    speed: float
    torque: float
    error: float


@dataclass(frozen=True, slots=True)
class SteadyFit:
    """Result of the fit.

    Attributes
    ----------
    coulomb, offset : N.m or N
    viscous : N.m.s/rad or N.s/m
    stribeck_level : b, N.m or N; 0 without a Stribeck effect
    stribeck_speed : vs, rad/s or m/s; None without
    rms : of the relative residual, all points
    held_out : the same on every other speed, left out of the fit, both ways
    points : how many
    """

    coulomb: Estimate
    offset: Estimate
    viscous: Estimate
    stribeck_level: float
    stribeck_speed: float | None
    rms: float
    held_out: float
    points: int

    def curve(self, speed: Array) -> Array:
        """Friction against speed ≥ 0, mean of both directions, (n,) N.m or N."""
        level = np.full_like(speed, self.coulomb.value)
        if self.stribeck_speed is not None:
            level = level + self.stribeck_level * np.exp(-((speed / self.stribeck_speed) ** 2))
        return np.asarray(level + self.viscous.value * speed, np.float64)


def at_speed(velocity: Array) -> NDArray[np.bool_]:
    """Whether the axis moves at each sample, (n,).

    It rests where for a while the speed stays below a small share of the largest.
    """
    smooth = _running_median(np.abs(velocity), _MEDIAN)
    result: NDArray[np.bool_] = smooth > _REST * float(np.quantile(np.abs(velocity), 0.99))
    return result


def plateaus(
    velocity: Array, torque: Array, moves: NDArray[np.bool_] | None = None
) -> list[SteadyPoint]:
    """Stretches of constant speed of one record.

    Parameters
    ----------
    velocity, torque : (n,) rad/s or m/s, N.m or N
    moves : (n,) where the axis moves; `at_speed` where it is not given
    """
    moves = at_speed(velocity) if moves is None else moves
    change = np.flatnonzero(np.diff(np.concatenate(([0], moves.astype(int), [0]))))
    points = []
    for begin, end in zip(change[::2], change[1::2], strict=True):
        if end - begin >= _LEAST_SAMPLES:
            points += _of_motion(velocity[begin:end], torque[begin:end])
    return points


def _of_motion(velocity: Array, torque: Array) -> list[SteadyPoint]:
    """Stretches of constant speed of a motion without rest."""
    smooth = _running_median(velocity, _MEDIAN)
    noise = 1.48 * float(np.median(np.abs(velocity - smooth)))
    step = max(_STEP * float(np.abs(velocity).max()), 2 * noise)
    borders, first, level = [0], 0, float(smooth[0])
    middle = np.quantile(smooth, (0.05, 0.5, 0.95))
    if middle[2] - middle[0] < max(_ONE_SPEED * abs(middle[1]), step):
        smooth = np.full_like(smooth, middle[1])  # one speed, however it wavers
    for k, value in enumerate(smooth.tolist()):
        if k - first >= _MEDIAN and abs(value - level) > step:
            borders.append(k)
            first = k
        if k - first < _MEDIAN:
            level = float(np.mean(smooth[first : k + 1]))
    points = []
    for begin, end in pairwise([*borders, len(velocity)]):
        # the beginning and the end may still accelerate
        edge = max((end - begin) // 10, _MEDIAN // 2) if len(borders) > 1 else 0
        part = slice(begin + edge, end - edge)
        v, u = velocity[part], torque[part]
        if len(v) < _LEAST_SAMPLES:
            continue
        if abs(v.mean()) <= noise * max(len(v) ** -0.5, _IN_NOISE):
            continue
        steadiness = abs(float(np.mean(v[len(v) // 2 :]) - np.mean(v[: len(v) // 2])))
        if steadiness > max(step, _ONE_SPEED * abs(v.mean())):
            continue
        points.append(SteadyPoint(float(v.mean()), float(u.mean()), float(u.std() / len(v) ** 0.5)))
    return points


def _running_median(values: Array, width: int) -> Array:
    half = width // 2
    padded = np.concatenate((np.repeat(values[0], half), values, np.repeat(values[-1], half)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return np.asarray(np.median(windows, axis=1), np.float64)


def fit(points: list[SteadyPoint]) -> SteadyFit:
    """Fit the curve; raises ValueError where the points cannot show it."""
    if len(points) < _FEWEST_POINTS:
        raise NotShown(f"{len(points)} constant speeds; {_FEWEST_POINTS} are needed")
    ordered = sorted(points, key=lambda point: point.speed)
    speed = np.array([p.speed for p in ordered])
    torque = np.array([p.torque for p in ordered])
    if not (np.any(speed > 0) and np.any(speed < 0)):
        raise NotShown(
            "all speeds have one direction: friction cannot be told from the offset; record the "
            "other, too"
        )
    if np.corrcoef(np.sign(speed), torque)[0, 1] < 0:
        raise NotShown(
            "the torque acts against the motion: the sign of torque or velocity is wrong"
        )
    order = np.argsort(np.abs(speed))
    odd = np.zeros(len(speed), bool)
    for direction in (1, -1):  # every other speed of each direction
        odd[[k for k in order if np.sign(speed[k]) == direction][1::2]] = True
    plain = _held_out(speed, torque, odd, None)
    peak = float(np.abs(speed).max())
    shapes = np.geomspace(max(float(np.abs(speed).min()), 0.005 * peak), 0.6 * peak, _SHAPES)
    costs = [_held_out(speed, torque, odd, float(shape)) for shape in shapes]
    best = int(np.argmin(costs))
    shape = float(shapes[best]) if costs[best] < _BETTER * plain else None
    if shape is not None:
        levels, errors_of, _ = _solve(speed, torque, shape)
        if levels[3] < _CLEARLY * errors_of[3]:
            shape = None
    solution, errors, rms = _solve(speed, torque, shape)
    if not solution[0] > 0:
        raise NotShown(
            f"the fit gives a Coulomb friction of {solution[0]:.3g}: these points are no friction "
            "curve"
        )
    names = {}
    for n, name in enumerate(("coulomb", "viscous", "offset")):
        size = abs(float(solution[n]))
        names[name] = Estimate.around(float(solution[n]), float(errors[n]), _SYSTEMATIC * size)
    return SteadyFit(
        **names,
        stribeck_level=float(solution[3]) if shape is not None else 0.0,
        stribeck_speed=shape,
        rms=rms,
        held_out=_held_out(speed, torque, odd, shape),
        points=len(points),
    )


def _columns(speed: Array, shape: float | None) -> Array:
    sign = np.sign(speed)
    columns = [sign, speed, np.ones_like(speed)]
    if shape is not None:
        columns.append(sign * np.exp(-((speed / shape) ** 2)))
    return np.column_stack(columns)


def _solve(speed: Array, torque: Array, shape: float | None) -> tuple[Array, Array, float]:
    """Coefficients, their standard errors, and the rms of the relative residual."""
    least = np.maximum(np.abs(torque), _LEAST_TORQUE * float(np.abs(torque).max()))
    a = _columns(speed, shape) / least[:, None]
    b = torque / least
    scale = np.linalg.norm(a, axis=0)
    solution, *_ = np.linalg.lstsq(a / scale, b, rcond=None)
    rest = b - a / scale @ solution
    variance = float(rest @ rest) / max(len(b) - a.shape[1], 1)
    normal = (a / scale).T @ (a / scale)
    errors = np.sqrt(np.diag(np.linalg.pinv(normal)) * variance)
    rms = float(np.sqrt(np.mean(rest**2)))
    return np.asarray(solution / scale), np.asarray(errors / scale), rms


def _held_out(speed: Array, torque: Array, odd: NDArray[np.bool_], shape: float | None) -> float:
    """Rms of the relative residual on the speeds left out, both ways."""
    squares = []
    for fitted, left_out in ((odd, ~odd), (~odd, odd)):
        if fitted.sum() < 3 + (shape is not None) or not left_out.any():
            return float("inf")
        solution, _, _ = _solve(speed[fitted], torque[fitted], shape)
        found = _columns(speed[left_out], shape) @ solution
        least = np.maximum(np.abs(torque[left_out]), _LEAST_TORQUE * float(np.abs(torque).max()))
        squares.append(((found - torque[left_out]) / least) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))
