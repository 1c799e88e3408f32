"""What a relay test says about the plant, against the plant."""

from __future__ import annotations

from math import atan, degrees, pi

import numpy as np
import pytest

from commissioning.identification.critical_point import (
    corrected,
    friction_of,
    from_model,
    hysteresis_only,
    naive,
)
from commissioning.identification.limit_cycle import LimitCycle, measure, periods_of
from commissioning.identification.two_relay import from_cycles

from .axis import matched


def cycle_with(half_swing: float, d: float, eps: float, period: float = 0.2) -> LimitCycle:
    return LimitCycle(d, eps, 0, period, 0, half_swing, 0, half_swing, 0, 0, 0.5, 1, 10, True)


def test_naive_is_what_astrom_and_hagglund_wrote() -> None:
    point = naive(cycle_with(0.3, 0.5, 0.0))
    assert point.ku == pytest.approx(4 * 0.5 / (pi * 0.3))
    assert point.phase_deg == -180.0


def test_hysteresis_moves_the_phase_by_its_arcsine_and_leaves_the_gain() -> None:
    point = hysteresis_only(cycle_with(0.3, 0.5, 0.15))
    assert point.gain == pytest.approx(pi * 0.3 / (4 * 0.5))
    assert point.phase_deg == pytest.approx(-150.0)
    assert point.ku is None


def test_friction_without_hysteresis_turns_the_point_beyond_180_degrees() -> None:
    point = corrected(cycle_with(0.3, 0.5, 0.0), 0.2)
    assert point.phase_deg == pytest.approx(-180 - degrees(atan(0.2 / 0.5)))
    assert point.gain == pytest.approx(pi * 0.3 / (4 * 0.5) / np.hypot(1, 0.4))


def test_the_friction_that_puts_a_cycle_on_a_point_gives_that_point_back() -> None:
    cycle = cycle_with(0.3, 0.5, 0.15)
    point = from_model(1e-3, 2e-3, 0.002, 0.2)
    again = corrected(cycle, friction_of(cycle, point))
    assert again.gain == pytest.approx(point.gain)
    assert again.phase_deg == pytest.approx(point.phase_deg)


def test_the_point_of_a_model_is_its_frequency_response() -> None:
    w = 2 * pi / 0.2
    value = np.exp(-1j * w * 0.002) / (1e-3 * (1j * w) ** 2 + 2e-3 * 1j * w)
    point = from_model(1e-3, 2e-3, 0.002, 0.2)
    assert point.gain == pytest.approx(abs(value))
    assert point.phase_deg == pytest.approx(np.degrees(np.angle(value)) % -360)


def test_the_corrected_point_is_the_plant_where_the_naive_one_is_far_off() -> None:
    pair = []
    for axis in matched(j=1e-3, f=0.1, d1=0.17, eps1=0.02, d2=0.3):
        periods = periods_of(*axis.sample(0.0005, 10.0), reference=0.0)
        pair.append(measure(periods, axis.d, axis.eps, 0.0, is_settled=True))
    estimate = from_cycles(*pair)
    w = pair[0].frequency
    truth = 1 / (1e-3 * w**2)  # |G| of the double integrator, at −180°
    point = corrected(pair[0], estimate.complex_coulomb)
    assert point.gain == pytest.approx(truth, rel=0.06)
    assert point.phase_deg == pytest.approx(-180, abs=8)
    assert naive(pair[0]).gain < 0.7 * truth
