"""What an axis does between its samples, by the model that explains them.

    J·ÿ = u(t − τ) − B·ẏ − F(t) − offset

Torque u and friction F are held in small cells, so their integrals are exact. What the model leaves over,

    e(t) = y − (∬u − ∬F − offset·t²/2 − B·∫y)/J

has no kinks, however hard the torque switches: it is smoothed, and position, velocity and the instants
of its sign changes follow between the samples, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.record import Record
from commissioning.identification.signals import Steps

__all__ = ["Cells", "Model", "Motion"]

Array = NDArray[np.float64]
Speed = Callable[[Array], Array]

_A_SAMPLE = 4  # cells in a sample interval …
_FINE = 300  # … and 2 where a period has more samples than this
_KNOTS = 6  # of what the model leaves over, a period
_LARGE_JUMP = 0.1  # of the torque's range: gets a cell border of its own


@dataclass(frozen=True, slots=True)
class Model:
    """Parameters of the equation of motion, beside the friction law.

    Attributes
    ----------
    inertia : kg.m2 or kg
    viscous : N.m.s/rad or N.s/m
    offset : N.m or N
    dead_time : s
    """

    inertia: float
    viscous: float
    offset: float
    dead_time: float


@dataclass(frozen=True, slots=True)
class Cells:
    """Small pieces of time with no reversal and no large switching inside.

    Attributes
    ----------
    edges : (n+1,) s
    sign : (n,) of the velocity
    velocity : (n,) in the middle of each cell, rad/s or m/s
    position : (n,) rad or m
    torque : (n,) u(t − τ) − offset, N.m or N
    """

    edges: Array
    sign: Array
    velocity: Array
    position: Array
    torque: Array

    def signal(self, values: Array) -> Steps:
        """A signal with these values in the cells, (n,)."""
        return Steps(self.edges[:-1], values)

    def hat_moments(self, time: Array, values: Array) -> Array:
        """∫ Λ_k·s dt at the inner nodes of `time` for signals held in the cells, (n, k).

        No cell reaches across a node, so a hat is straight in each.
        """
        from scipy.sparse import csr_array

        middle, width = 0.5 * (self.edges[1:] + self.edges[:-1]), np.diff(self.edges)
        left = np.searchsorted(time[1:-1], middle)
        share = (middle - time[left]) / (time[left + 1] - time[left])
        count = len(middle)
        weights = np.concatenate((width * (1 - share), width * share))
        nodes = np.concatenate((left, left + 1))
        cells = np.tile(np.arange(count), 2)
        hats = csr_array((weights, (nodes, cells)), shape=(len(time), count))
        return np.asarray(hats @ values, np.float64)[1:-1]


class Motion:
    """Follows one record; knows more after each `update`.

    Attributes
    ----------
    instants, begins : (m,) s, of the reversals, and the sign of the velocity before the first
    speed : velocity at instants, rad/s or m/s
    integral : (n,) ∫y from the first sample, rad.s or m.s
    cells : velocity and position there are of the last update
    """

    def __init__(self, record: Record, instants: Array, begins: int, period: float) -> None:
        self._time = record.time
        self._y = record.position - record.position.mean()
        self._level = float(record.position.mean())
        self._h = np.diff(self._time)
        self._step = float(np.median(self._h))
        self.begins = begins
        self._period = period
        self.torque = Steps(record.sent, record.command)
        jumps = np.abs(np.diff(record.command))
        large = jumps > _LARGE_JUMP * (float(np.ptp(record.command)) or 1.0)
        self._switchings = record.sent[1:][large]
        self.instants = instants
        # trapezoids with the curvature that the samples themselves show
        y, h = self._y, self._h
        middle = 0.5 * (h[1:] + h[:-1])
        bend = np.concatenate(([0.0], np.diff(np.diff(y) / h) / middle, [0.0]))
        pieces = h * (y[1:] + y[:-1]) / 2 - h**3 / 24 * (bend[1:] + bend[:-1])
        self.integral = np.concatenate(([0.0], np.cumsum(pieces)))
        slope = np.gradient(y, self._time)
        self.speed: Speed = lambda t: np.interp(t, self._time, slope)
        self.cells = self._cells(Model(1.0, 0.0, 0.0, 0.0), self.speed)

    @property
    def signs(self) -> Steps:
        """Sign of the velocity."""
        return Steps.sign(float(self._time[0]), self.begins, self.instants)

    def update(self, model: Model, friction: Array) -> float:
        """Take `model` and the friction torque in the cells, (n,), for true.

        Returns how far the reversals have moved, the mean in s.
        """
        t, y, h = self._time, self._y, self._h
        resist, origin, rate = self.cells.signal(friction), t[0], model.viscous / model.inertia

        def explained(at: Array) -> Array:
            drive = self.torque.double_integral(at - model.dead_time)
            drop = model.offset * (at - origin) ** 2 / 2
            result: Array = (drive - resist.double_integral(at) - drop) / model.inertia
            return result

        def explained_speed(at: Array) -> Array:
            drive = self.torque.integral(at - model.dead_time)
            drop = model.offset * (at - origin)
            result: Array = (drive - resist.integral(at) - drop) / model.inertia
            return result

        at_nodes = explained(t)
        share = (np.arange(_A_SAMPLE) + 0.5) / _A_SAMPLE
        inner = explained((t[:-1, None] + h[:, None] * share).ravel()).reshape(-1, _A_SAMPLE)
        chord = at_nodes[:-1, None] * (1 - share) + at_nodes[1:, None] * share
        bulge = (inner - chord).mean(axis=1) * h + rate * np.diff(y) * h**2 / 12
        self.integral = np.concatenate(([0.0], np.cumsum(h * (y[1:] + y[:-1]) / 2 + bulge)))
        rest = self._smooth(y - at_nodes + rate * self.integral)
        drift = rest.derivative()

        def speed(at: Array) -> Array:
            result: Array = explained_speed(at) + drift(at) - rate * np.interp(at, t, y)
            return result

        self.speed = speed
        moved = self._move_reversals(model, speed, resist)
        self.cells = self._cells(model, speed)
        return moved

    def _smooth(self, values: Array) -> Any:
        """Least-squares cubic spline with some knots a period."""
        from scipy.interpolate import make_lsq_spline

        t = self._time
        stride = max(4, round(self._period / self._step / _KNOTS))
        inner = t[stride : len(t) - stride // 2 - 1 : stride]
        knots = np.concatenate(([t[0]] * 4, inner, [t[-1]] * 4))
        return make_lsq_spline(t, values, knots, 3)

    def _move_reversals(self, model: Model, speed: Speed, resist: Steps) -> float:
        """Each reversal to where the velocity is zero, by what is left of it and the acceleration."""
        at = self.instants
        if not len(at):
            return 0.0
        before = self.begins * (-1.0) ** np.arange(len(at))
        left = speed(at)
        inside = self._step * 1e-3
        level = np.where(left * before > 0, resist.at(at - inside), resist.at(at + inside))
        pull = self.torque.at(at - model.dead_time) - model.offset - level
        moves = np.where(pull != 0, -left * model.inertia / np.where(pull == 0, 1, pull), 0.0)
        moves = np.clip(moves, -self._step, self._step)
        self.instants = np.maximum.accumulate(at + moves)
        return float(np.abs(moves).mean())

    def _cells(self, model: Model, speed: Speed) -> Cells:
        t, h = self._time, self._h
        count = 2 if self._period > _FINE * self._step else _A_SAMPLE
        grid = (t[:-1, None] + h[:, None] * (np.arange(count) / count)).ravel()
        switched = self._switchings + model.dead_time
        borders = np.concatenate((self.instants, switched))
        inside = borders[(borders > t[0]) & (borders < t[-1])]
        edges = np.unique(np.concatenate((grid, inside, t[-1:])))
        middle = 0.5 * (edges[1:] + edges[:-1])
        return Cells(
            edges,
            self.signs.at(middle),
            speed(middle),
            np.interp(middle, t, self._y) + self._level,
            self.torque.at(middle - model.dead_time) - model.offset,
        )
