"""Cramér–Rao bound of what a record of a rigid axis can tell (method.md 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.record import Record
from drivers.virtual.plant import Plant, PlantParameters

__all__ = ["coulomb_bound"]

Array = NDArray[np.float64]

_STEP = 1e-4  # of a parameter's scale, for differences
_STATE_PASSES = 3


def coulomb_bound(
    record: Record,
    truth: PlantParameters,
    delay: float,
    noise: float,
    spans: Sequence[tuple[float, float]] = (),
) -> float:
    """Smallest standard deviation of the Coulomb friction of any unbiased estimator, N.m.

    J, B, f, offset, dead time, lag and the initial position and speed of each span are unknown; the
    positions have white noise. The true parameters are taken, the initial states are fitted.

    Parameters
    ----------
    truth : of the axis
    delay : s, from a command to its torque
    noise : rms of a position, rad
    spans : begin and end of what was used, s; (): all of the record
    """
    parts = [record.between(begin, end) for begin, end in spans] or [record]
    information = np.sum([_information(part, truth, delay) for part in parts], axis=0)
    size = np.sqrt(np.diag(information))
    variance = np.linalg.pinv(information / np.outer(size, size))[2, 2] / size[2] ** 2
    return float(noise * np.sqrt(variance))


def _information(record: Record, truth: PlantParameters, delay: float) -> Array:
    """Of the parameters, (6, 6), the initial state eliminated."""
    lag = max(truth.lag, 1e-5)
    values = np.array([truth.inertia, truth.viscous, truth.coulomb, truth.load, delay, lag])
    speeds = np.abs(np.diff(record.position) / np.diff(record.time))
    fast, cycle = float(speeds.max()), float(np.median(np.diff(record.time)))
    f = truth.coulomb
    scale = np.array([truth.inertia, f / fast, f, f, cycle, min(cycle, lag)])
    state = np.array([record.position[0], float(np.diff(record.position)[0] / cycle)])
    state_scale = np.array([max(record.resolution, 1e-4 * float(np.ptp(record.position))), fast])

    def moved(parameters: Array, initial: Array) -> Array:
        j, b, coulomb, load, tau, slow = parameters
        own = replace(
            truth, inertia=j, viscous=b, coulomb=coulomb, breakaway=coulomb, load=load, lag=slow
        )
        return _simulated(record, own, float(tau), initial)

    for _ in range(_STATE_PASSES):
        rest = record.position - moved(values, state)
        columns = _columns(lambda s: moved(values, s), state, 0.01 * state_scale)
        state = state + np.linalg.lstsq(columns, rest, rcond=None)[0]
    left = _columns(lambda p: moved(p, state), values, _STEP * scale)
    right = _columns(lambda s: moved(values, s), state, 0.01 * state_scale)
    q, _ = np.linalg.qr(right)
    own = left - q @ (q.T @ left)
    result: Array = own.T @ own
    return result


def _columns(function, at: Array, steps: Array) -> Array:  # type: ignore[no-untyped-def]
    found = []
    for k, step in enumerate(steps):
        change = np.zeros(len(at))
        change[k] = step
        found.append((function(at + change) - function(at - change)) / (2 * step))
    return np.column_stack(found)


def _simulated(record: Record, own: PlantParameters, delay: float, initial: Array) -> Array:
    """Positions at the record's instants."""
    plant = Plant(own, float(initial[0]))
    plant.velocity = float(initial[1])
    begins, torques = (record.sent + delay).tolist(), record.command.tolist()
    at = float(record.time[0])
    k = max(int(np.searchsorted(begins, at, side="right")) - 1, 0)
    plant.torque = torques[k]
    found = [plant.position]
    for instant in record.time[1:].tolist():
        while k + 1 < len(begins) and begins[k + 1] < instant:
            if begins[k + 1] > at:
                plant.advance(begins[k + 1] - at, torques[k])
                at = begins[k + 1]
            k += 1
        plant.advance(instant - at, torques[k])
        at = instant
        found.append(plant.position)
    return np.array(found)
