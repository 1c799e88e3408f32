"""Answers of positions to a Stribeck curve, against two integrations in small steps."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest
from numpy.typing import NDArray

from commissioning.identification.bending import SPEEDS, stribeck_columns
from commissioning.identification.motion import Model
from commissioning.identification.position_fit import PositionFit
from commissioning.identification.record import Record
from commissioning.identification.segments import segments_of

J, B, F = 1e-3, 2e-3, 0.1
STEP, EVERY, PERIOD, SAMPLES = 2e-5, 50, 0.1, 600


def moved(height: float, speed: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and torques every ms of an axis with a curve `height`·e^(−|v|/speed)."""
    x = v = 0.0
    positions, torques = [], []
    for n in range(SAMPLES * EVERY):
        t = n * STEP
        amplitude = 0.2 if t < 0.3 else 0.33
        u = amplitude if (t / PERIOD) % 1 < 0.5 else -amplitude
        if n % EVERY == 0:
            positions.append(x)
            torques.append(u)
        level = F + height * exp(-abs(v) / speed)
        sign = np.sign(v) if v else np.sign(u)
        follows = v + STEP * (u - B * v - sign * level) / J
        if v * follows < 0:  # the rest of the step with the friction of the other direction
            share = v / (v - follows)
            follows = (1 - share) * STEP * (u + sign * level) / J
        x, v = x + STEP * 0.5 * (v + follows), follows
    return np.array(positions), np.array(torques)


@pytest.mark.parametrize("number", [4, 6, 8])
def test_the_answer_to_a_small_curve_is_that_of_the_equation(number: int) -> None:
    plain, torque = moved(0.0, 1.0)
    time = np.arange(SAMPLES) * STEP * EVERY
    record = Record.of(time, plain, time, torque, 1e-9)
    segments = segments_of(record, 1)
    fit = PositionFit.begun(segments, Model(J, B, 0.0, 1e-5), F, 0.0).solved()
    columns = stribeck_columns(fit)
    height = 2e-4
    bent, _ = moved(height, float(SPEEDS[number] * segments.speed))
    difference = np.zeros_like(segments.time)
    for k, (at, is_there) in enumerate(zip(segments.time, segments.is_there, strict=True)):
        difference[k] = np.where(is_there, np.interp(at, time, bent - plain), 0.0)
    expected = fit.projected(difference[..., None])[..., 0] / height
    found = columns[..., number]
    together = float((found * expected).sum())
    assert together / np.sqrt((found**2).sum() * (expected**2).sum()) > 0.98
    assert together / float((expected**2).sum()) == pytest.approx(1.0, abs=0.12)
