"""Long columns as fewer points that look the same: the extremes of each stretch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from commissioning.samples import Array, Samples

__all__ = ["reduced", "velocity_of"]


def reduced(time: Array, columns: Sequence[Array], most: int) -> tuple[Array, list[Array]]:
    """Times and columns of `most` points at most, of which each column keeps its extremes.

    Each stretch of samples is two points: where it has no extreme, as it begins and ends.
    """
    count = len(time)
    if count <= most:
        return time, list(columns)
    stretches = max(most // 2, 1)
    edges = np.linspace(0, count, stretches + 1).astype(int)[:-1]
    found = []
    for column in columns:
        lows, highs = np.minimum.reduceat(column, edges), np.maximum.reduceat(column, edges)
        rises = column[np.append(edges[1:], count) - 1] >= column[edges]
        pair = np.where(rises, (lows, highs), (highs, lows))
        found.append(pair.T.ravel())
    ends = np.append(edges[1:], count) - 1
    times = np.stack((time[edges], time[ends])).T.ravel()
    return times, found


def velocity_of(samples: Samples) -> Array:
    """Velocity by central differences over the record's own time stamps, (n,) rad/s or m/s."""
    time = samples.time
    steps = np.diff(time)
    if len(time) < 2 or not np.all(steps > 0):
        return np.zeros(len(time))
    velocity: Array = np.gradient(samples.position, time)
    return velocity
