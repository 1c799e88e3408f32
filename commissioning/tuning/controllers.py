"""Gains as sampled controllers: their frequency response, and their law in the time domain."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from commissioning.tuning.rules import Cascade, Pid

__all__ = ["ControlLaw", "Gains", "law", "response"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Gains = Pid | Cascade
ControlLaw = Callable[[float, float], float]  # reference, position → torque

_FILTER = 10.0  # derivative times over the time constant of the derivative's filter


def _integral(gains: Gains, cycle: float) -> float:
    """Share of the error that the integral part gains in a cycle."""
    return cycle / gains.integral_time if isfinite(gains.integral_time) else 0.0


def response(gains: Gains, cycle: float, frequency: Array) -> Complex:
    """u/(−y) at ω, rad/s, at a constant reference, (n,) N.m/rad or N/m.

    Integral by backward rectangles; the PID's derivative behind a filter of a tenth of its time,
    the cascade's velocity as difference of two samples. z − 1 is taken by expm1, so that nothing
    cancels.
    """
    angle = 1j * np.asarray(frequency, np.float64) * cycle
    z, near = np.exp(angle), np.expm1(angle)
    integral = 1 + _integral(gains, cycle) * z / near
    if isinstance(gains, Cascade):
        slope = gains.position_gain + near / (z * cycle)
        return np.asarray(gains.velocity_gain * integral * slope, np.complex128)
    smoothing = gains.derivative_time / _FILTER
    keep = smoothing / (smoothing + cycle)
    lead = gains.derivative_time / (smoothing + cycle) * near / (near + 1 - keep)
    return np.asarray(gains.gain * (integral + lead), np.complex128)


def law(
    gains: Gains, cycle: float, limit: float, position: float, holding: float = 0.0
) -> ControlLaw:
    """The controller as a function that is called once a cycle, at rest at `position`.

    An integral part begins with the torque `holding`, N.m or N, that holds the axis there. The
    torque stays within ±`limit`, and the integral part does not wind up beyond that.
    """
    share = _integral(gains, cycle)
    proportional = gains.velocity_gain if isinstance(gains, Cascade) else gains.gain
    integral = holding / proportional if share else 0.0
    before, slope = position, 0.0

    def limited(error: float, torque: float) -> float:
        nonlocal integral
        integral += share * error
        whole = torque + proportional * integral
        if abs(whole) > limit:
            if whole * error > 0:
                integral -= share * error
            return limit if whole > 0 else -limit
        return whole

    if isinstance(gains, Cascade):
        kp = gains.position_gain

        def cascade(reference: float, y: float) -> float:
            nonlocal before
            error = kp * (reference - y) - (y - before) / cycle
            before = y
            return limited(error, proportional * error)

        return cascade

    smoothing = gains.derivative_time / _FILTER
    keep, td = smoothing / (smoothing + cycle), gains.derivative_time

    def pid(reference: float, y: float) -> float:
        nonlocal before, slope
        slope = keep * slope + td / (smoothing + cycle) * (y - before)
        before = y
        error = reference - y
        return limited(error, proportional * (error - slope))

    return pid
