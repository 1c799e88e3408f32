"""What an axis does between its samples, by the model that explains them.

    J·ÿ = u(t − τ) − B·ẏ − F(t) − offset

Torque u and friction F are held in small cells, so the response of the axis to them is exact
(`response`). What that leaves of the position has no kinks, however hard the torque switches: it is
smoothed, and position, velocity and the instants of its sign changes follow between the samples,
too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.record import Record
from commissioning.identification.response import Response
from commissioning.identification.signals import Steps

__all__ = ["MANY", "Cells", "Model", "Motion", "Turning"]

Array = NDArray[np.float64]
Speed = Callable[[Array], Array]
Turning = Literal["speed", "position", "nothing"]

_A_SAMPLE = 4  # cells in a sample interval …
_FINE = 300  # … and 2 where a period has more samples than this
_MOST = 5000  # samples of a record in which all reversals are found together
MANY = 60  # samples a period in which the velocity is seen well enough
_SOFT = 0.1  # of the largest friction: a smaller jump at a reversal says nothing
_RIDGE = 1e-13
_WANDERS, _STRAYS = 2.0, 0.05  # samples, of a period: a reversal that goes farther is lost
_KNOTS = 6  # of what the model leaves over, a period


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
    """Small pieces of time with no reversal and no switching of the torque inside.

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
    lateness : s, median distance of the reversals from where the velocity is zero, of the last
        update
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
        self._switchings = record.sent[1:][np.diff(record.command) != 0]
        self.instants = instants
        self.lateness = 0.0
        self._first, self._most = instants, max(_WANDERS * self._step, _STRAYS * period)
        self._moved = np.zeros(len(instants))
        self._reach = np.full(len(instants), self._step)
        # trapezoids with the curvature that the samples themselves show
        y, h = self._y, self._h
        middle = 0.5 * (h[1:] + h[:-1])
        bend = np.concatenate(([0.0], np.diff(np.diff(y) / h) / middle, [0.0]))
        pieces = h * (y[1:] + y[:-1]) / 2 - h**3 / 24 * (bend[1:] + bend[:-1])
        self.integral = np.concatenate(([0.0], np.cumsum(pieces)))
        slope = np.gradient(y, self._time)
        self.speed: Speed = lambda t: np.interp(t, self._time, slope)
        self._position: Speed = lambda t: np.interp(t, self._time, self._y)
        self.cells = self._cells(Model(1.0, 0.0, 0.0, 0.0))

    @property
    def signs(self) -> Steps:
        """Sign of the velocity."""
        return Steps.sign(float(self._time[0]), self.begins, self.instants)

    def position(self, time: Array) -> Array:
        """Position at instants of the record, rad or m, of the last update."""
        return self._position(time) + self._level

    def update(
        self, model: Model, friction_in: Callable[[Cells], Array], by: Turning = "speed"
    ) -> float:
        """Take `model` and the friction torque that a law gives in the cells, (n,), for true.

        `by` : reversals go where the velocity is zero, or where they fit the position best – which
            needs
        no velocity, but lets them make up for a wrong law – or stay. Returns how far they have
        moved, the mean in s.
        """
        t, y, h = self._time, self._y, self._h
        cells = self._cells(model)
        friction = friction_in(cells)
        response = Response(cells.edges, cells.torque - friction, model.inertia, model.viscous)
        at_nodes = response.position(t)
        rest = y - at_nodes
        # ∫y: arcs of the model through the samples
        arcs = np.diff(response.area(t)) - h * (at_nodes[1:] + at_nodes[:-1]) / 2
        pieces = h * (y[1:] + y[:-1]) / 2 + arcs
        self.integral = np.concatenate(([0.0], np.cumsum(pieces)))
        resist = cells.signal(friction)
        drift = self._smooth(rest).derivative()

        def speed(at: Array) -> Array:
            result: Array = response.speed(at) + drift(at)
            return result

        self.speed = speed
        self._position = lambda at: response.position(at) + np.interp(at, t, rest)
        late = self._by_speed(model, resist)
        self.lateness = float(np.median(np.abs(late))) if len(late) else 0.0
        found = self._by_position(model, resist, rest) if by == "position" else None
        moves = late if found is None else found
        if by == "nothing":
            moves = np.zeros_like(late)
        # one that is turned back has gone too far: it takes shorter steps from then on
        self._reach = np.where(moves * self._moved < 0, 0.5 * self._reach, self._reach)
        self._moved = np.clip(moves, -self._reach, self._reach)
        near = np.clip(
            self.instants + self._moved, self._first - self._most, self._first + self._most
        )
        self.instants = np.maximum.accumulate(near)
        self.cells = self._cells(model)
        return float(np.abs(self._moved).mean()) if len(moves) else 0.0

    def _knots(self) -> Array:
        t = self._time
        stride = max(4, round(self._period / self._step / _KNOTS))
        inner = t[stride : len(t) - stride // 2 - 1 : stride]
        return np.concatenate(([t[0]] * 4, inner, [t[-1]] * 4))

    def _smooth(self, values: Array) -> Any:
        """Least-squares cubic spline with some knots a period."""
        from scipy.interpolate import make_lsq_spline

        return make_lsq_spline(self._time, values, self._knots(), 3)

    def _by_position(self, model: Model, resist: Steps, rest: Array) -> Array | None:
        """How late each reversal is, (m,) s, by what it does to the position.

        Friction that turns too early is an impulse, and its response a bend – on a damped axis a
        step – that no smooth curve follows: all are found together with that curve. None where many
        samples show the velocity well enough, or where the friction does not jump.
        """
        from scipy.interpolate import BSpline

        at, t = self.instants, self._time
        if not len(at) or len(t) > _MOST or self._period > MANY * self._step:
            return None
        inside = self._step * 1e-3
        jumps = resist.at(at - inside) - resist.at(at + inside)
        if np.any(np.abs(jumps) < _SOFT * np.abs(resist.values).max()):
            return None
        rate = max(model.viscous / model.inertia, 1e-9)
        after = np.maximum(t[:, None] - at[None, :], 0.0)
        bends = jumps * -np.expm1(-rate * after) / (rate * model.inertia)
        columns = np.column_stack((BSpline.design_matrix(t, self._knots(), 3).toarray(), bends))
        scale = np.linalg.norm(columns, axis=0).clip(1e-300)
        columns = columns / scale
        normal = columns.T @ columns + _RIDGE * np.eye(columns.shape[1])
        found = np.linalg.solve(normal, columns.T @ rest) / scale
        return np.asarray(-found[-len(at) :], np.float64)

    def _by_speed(self, model: Model, resist: Steps) -> Array:
        """How late the velocity is zero, (m,) s: by what is left of it, and the acceleration."""
        at = self.instants
        before = self.begins * (-1.0) ** np.arange(len(at))
        left = self.speed(at)
        inside = self._step * 1e-3
        level = np.where(left * before > 0, resist.at(at - inside), resist.at(at + inside))
        pull = self.torque.at(at - model.dead_time) - model.offset - level
        moves = np.where(pull != 0, -left * model.inertia / np.where(pull == 0, 1, pull), 0.0)
        return np.asarray(moves, np.float64)

    def _cells(self, model: Model) -> Cells:
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
            self.speed(middle),
            self._position(middle) + self._level,
            self.torque.at(middle - model.dead_time) - model.offset,
        )
