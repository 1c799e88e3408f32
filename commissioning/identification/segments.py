"""A record cut into segments, and how positions on them answer to parameters and first states.

Every segment has a state of its own, position and speed at its begin, so that what came before, a
jump or a rest, is nothing to it. Differences to parameters and states are simulated beside the
motion itself: as lanes of one integration (`trajectory`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.errors import NotShown
from commissioning.identification.record import Record, reversals
from commissioning.identification.trajectory import PARAMETERS, Lanes, Torque, positions

__all__ = ["SEEN", "Answers", "Segments", "segments_of"]

Array = NDArray[np.float64]

# parameters of the axis, and of how its encoder shows it: y = x + p·cos x + q·sin x
SEEN = (*PARAMETERS, "eccentricity_cos", "eccentricity_sin")

_BEFORE_PEAK = 0.05  # of a period: where a segment begins, before the speed is highest
_AROUND = 0.12  # of a period, in which the first state is read off the samples
_LONGEST_STEP = 0.55  # of a period
_STATE_STEP = 1e-2  # of its scale
_LEAST_SWING, _LEAST_SPEED = 1e-4, 1e-3  # of swing and peak speed: scales of a first state


@dataclass(frozen=True, slots=True)
class Answers:
    """Positions of the model, and what changes of parameters and scaled first states do to them.

    Attributes
    ----------
    left : (s, n) what the samples have beyond the model, rad or m; 0 where there is no sample
    by_parameter : (s, n, p) rad or m, for the changes that were asked for
    by_state : (s, n, 2) rad or m
    """

    left: Array
    by_parameter: Array
    by_state: Array

    @property
    def cost(self) -> float:
        """Sum of squares, rad2 or m2."""
        return float(np.einsum("sn,sn->", self.left, self.left))


@dataclass(frozen=True, slots=True)
class Segments:
    """Segments of one record, padded to one length.

    Attributes
    ----------
    torque : the commands
    begin : (s,) where the states are, s
    time, position : (s, n) s, rad or m
    is_there : (s, n) whether it is a sample
    period, step : typical ones, s
    resolution : rad or m
    swing, speed : typical half-swing and peak speed, rad or m, a second
    middle, centre : where drift and spring are none, s, rad or m
    origin : of all instants here, on the record's clock, s
    """

    torque: Torque
    begin: Array
    time: Array
    position: Array
    is_there: NDArray[np.bool_]
    period: float
    step: float
    resolution: float
    swing: float
    speed: float
    middle: float
    centre: float
    origin: float

    @property
    def samples(self) -> int:
        """How many there are."""
        return int(self.is_there.sum())

    @property
    def span(self) -> float:
        """From the first sample to the last, s."""
        return float(self.time.max() - self.time.min())

    def begun_between(self, delay: float) -> Segments:
        """With states that lie between two changes of the torque, which come `delay` s late.

        A torque that changes with its lag just where a state is free would be taken for the state.
        """
        edges = self.torque.time + delay
        first = self.time[:, 0]
        last = np.maximum(np.searchsorted(edges, first, side="right") - 1, 0)
        near, before = edges[last], edges[np.maximum(last - 1, 0)]
        between = 0.5 * (near + np.maximum(before, near - self.step))
        is_near = (first - near < 2 * self.step) & (first >= near)
        return replace(self, begin=np.where(is_near, between, first))

    def first_states(self) -> Array:
        """Position and speed at the begins, (s, 2), by a parabola through the first samples."""
        found = np.empty((len(self.time), 2))
        for k, (begin, time, y, is_there) in enumerate(
            zip(self.begin, self.time, self.position, self.is_there, strict=True)
        ):
            count = max(int(np.searchsorted(time, time[0] + _AROUND * self.period)), 3)
            count = min(count, int(is_there.sum()))
            _, slope, level = np.polyfit(time[:count] - begin, y[:count], 2)
            found[k] = level, slope
        return found

    def state_scale(self) -> Array:
        """Of position and speed, (2,)."""
        return np.array(
            [
                max(self.resolution, _LEAST_SWING * self.swing),
                max(self.resolution / self.step, _LEAST_SPEED * self.speed),
            ]
        )

    def positions_at(self, parameters: Array, states: Array, time: Array) -> Array:
        """Of the model at other instants (s, n), s; `parameters`: (12,)."""
        rows = np.broadcast_to(parameters, (len(time), len(SEEN)))
        return self._simulated(rows, states, self.begin, time)

    def answer(self, parameters: Array, states: Array, which: list[int], steps: Array) -> Answers:
        """To small changes of some parameters and of all first states.

        Parameters
        ----------
        parameters : (12,) in the order of SEEN
        states : (s, 2)
        which : numbers of the parameters, p of them
        steps : (12,) by which each is changed
        """
        count, p = len(self.time), len(which)
        each = 1 + p + 2
        rows = np.tile(parameters, (count * each, 1))
        initial = np.repeat(states, each, axis=0)
        small = _STATE_STEP * self.state_scale()
        for n, number in enumerate(which):
            rows[n + 1 :: each, number] += steps[number]
        for n in range(2):
            initial[1 + p + n :: each, n] += small[n]
        begin, time = (np.repeat(one, each, axis=0) for one in (self.begin, self.time))
        found = self._simulated(rows, initial, begin, time).reshape(count, each, -1)
        base = found[:, :1]
        moved = np.where(self.is_there[:, None], found[:, 1:] - base, 0.0).transpose(0, 2, 1)
        return Answers(
            np.where(self.is_there, self.position - base[:, 0], 0.0),
            moved[..., :p],
            moved[..., p:] / _STATE_STEP,
        )

    def _simulated(self, rows: Array, states: Array, begin: Array, time: Array) -> Array:
        axes, cos, sin = rows[:, : len(PARAMETERS)], rows[:, -2:-1], rows[:, -1:]
        start = Lanes(axes, begin, states[:, 0], states[:, 1], self.middle, self.centre)
        x = positions(start, self.torque, time, _LONGEST_STEP * self.period)
        if np.any(rows[:, -2:]):
            x = x + cos * np.cos(x) + sin * np.sin(x)
        return x


def segments_of(
    record: Record, periods: int | None, spans: Sequence[tuple[float, float]] = ()
) -> Segments:
    """Cut a record into segments of so many periods (None: as long as they can be).

    A segment begins a little before a peak of speed, so that its state is far from a reversal.
    `spans`: begin and end of the stretches that may be used, s; (): all.

    Raises NotShown where there are not two reversals.
    """
    time, y = record.time, record.position
    turns, _ = reversals(record)
    if len(turns) < 4:
        raise NotShown(f"the record has {len(turns)} velocity reversals; 4 are needed")
    period = 2 * float(np.median(np.diff(turns)))
    step = float(np.median(np.diff(time)))
    begins = _peaks(record, turns) - _BEFORE_PEAK * period
    cut: list[tuple[int, int]] = []
    for begin, end in spans or [(float(time[0]), float(time[-1]))]:
        inside = begins[(begins >= begin) & (begins < end)]
        halves = len(inside) if periods is None else 2 * periods
        for k in range(0, len(inside), max(halves, 1)):
            last = inside[k + halves] if k + halves < len(inside) else end
            first, beyond = np.searchsorted(time, (inside[k], last))
            if (last - inside[k]) < 0.4 * period and cut and k:
                cut[-1] = (cut[-1][0], int(beyond))  # a rest of a period belongs to the one before
            elif beyond - first >= 6:
                cut.append((int(first), int(beyond)))
    if not cut:
        raise NotShown("the record has no whole oscillation")
    longest = max(b - a for a, b in cut)
    rows = np.array([np.minimum(np.arange(a, a + longest), b - 1) for a, b in cut])
    is_there = np.array([np.arange(longest) < b - a for a, b in cut])
    swings = np.abs(np.diff(np.interp(turns, time, y)))
    origin = float(time[0])
    used = rows[is_there]
    return Segments(
        _relative(Torque.of(record.sent, record.command), origin),
        time[rows[:, 0]] - origin,
        time[rows] - origin,
        y[rows],
        is_there,
        period,
        step,
        record.resolution,
        float(np.median(swings)) / 2,
        float(np.quantile(np.abs(np.diff(y) / np.diff(time)), 0.99)),
        float(time[used].mean()) - origin,
        float(y[used].mean()),
        origin,
    )


def _relative(torque: Torque, origin: float) -> Torque:
    return replace(torque, time=torque.time - origin)


def _peaks(record: Record, turns: Array) -> Array:
    """Instants at which the speed is highest between two reversals, s."""
    time, y = record.time, record.position
    found = []
    for before, after in pairwise(turns.tolist()):
        first, last = np.searchsorted(time, (before, after))
        wide = max((last - first) // 8, 1)
        if last - first < 2 * wide + 1:
            found.append(0.5 * (before + after))
            continue
        way = np.abs(y[first + wide : last] - y[first : last - wide])
        took = time[first + wide : last] - time[first : last - wide]
        at = int(np.argmax(way / took))
        found.append(0.5 * (time[first + at] + time[first + at + wide]))
    return np.array(found)
