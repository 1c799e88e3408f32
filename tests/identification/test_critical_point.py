"""What a relay test says about the plant, against the plant."""

from __future__ import annotations

from math import atan, degrees, pi

import numpy as np
import pytest

from commissioning.identification.critical_point import (
    CriticalPoint,
    at_its_phase,
    at_phase,
    corrected,
    friction_of,
    from_model,
    hysteresis_only,
    naive,
)
from commissioning.identification.estimate import Estimate
from commissioning.identification.limit_cycle import LimitCycle, measure, periods_of
from commissioning.identification.two_relay import from_cycles

from .axis import matched


def exactly(value: float) -> Estimate:
    return Estimate(value, value, value)


BENCH = exactly(1e-3), exactly(2e-3), exactly(0.002)


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
    point = from_model(*BENCH, 0.2)
    again = corrected(cycle, friction_of(cycle, point))
    assert again.gain == pytest.approx(point.gain)
    assert again.phase_deg == pytest.approx(point.phase_deg)


def test_the_point_of_a_model_is_its_frequency_response() -> None:
    w = 2 * pi / 0.2
    value = np.exp(-1j * w * 0.002) / (1e-3 * (1j * w) ** 2 + 2e-3 * 1j * w)
    point = from_model(*BENCH, 0.2)
    assert point.gain == pytest.approx(abs(value))
    assert point.phase_deg == pytest.approx(np.degrees(np.angle(value)) % -360)


@pytest.mark.parametrize("phase", [-135.0, -160.0, -180.0, -190.0])
def test_a_point_at_a_phase_lies_there(phase: float) -> None:
    point = at_phase(*BENCH, phase)
    assert point is not None
    s = 2j * pi / point.period
    plant = np.exp(-s * 0.002) / (1e-3 * s**2 + 2e-3 * s)
    assert abs(plant) == pytest.approx(point.gain)
    assert np.degrees(np.angle(plant)) % -360 == pytest.approx(phase % -360, abs=1e-6)


def test_where_damping_and_delay_are_equal_in_phase_the_plant_is_at_180_degrees() -> None:
    # atan(ωJ/B) + ωτ = 90° at ω = 10 rad/s, if J/B·10 = 1 and 10·τ = π/4
    point = at_phase(exactly(0.1), exactly(1.0), exactly(pi / 40), -180.0)
    assert point is not None
    assert point.period == pytest.approx(2 * pi / 10)
    assert point.gain == pytest.approx(1 / abs(-0.1 * 100 + 10j))
    assert point.ku == pytest.approx(1 / point.gain)


def test_a_rigid_axis_without_dead_time_has_no_point_at_180_degrees() -> None:
    assert at_phase(exactly(1e-3), exactly(2e-3), exactly(0.0), -180.0) is None
    assert at_phase(exactly(1e-3), exactly(2e-3), exactly(0.0), -179.0) is not None


def test_a_rigid_axis_without_viscous_friction_has_no_point_above_180_degrees() -> None:
    assert at_phase(exactly(1e-3), exactly(0.0), exactly(0.002), -135.0) is None


def test_the_interval_of_a_computed_point_covers_the_axes_that_the_model_allows() -> None:
    j, b, tau = (Estimate(e.value, 0.95 * e.value, 1.05 * e.value) for e in BENCH)
    point = at_phase(j, b, tau, -180.0)
    assert point is not None
    for factors in ((1.05, 1, 1), (1, 1.05, 1), (1, 1, 1.05), (0.95, 1, 1)):
        inertia, damping, delay = (e.value * k for e, k in zip(BENCH, factors, strict=True))
        s = 2j * pi / point.period
        other = np.exp(-s * delay) / (inertia * s**2 + damping * s) / point.value
        assert point.gain_error is not None
        assert point.phase_error is not None
        assert abs(abs(other) - 1) <= 1.001 * point.gain_error
        assert abs(np.degrees(np.angle(other))) <= 1.001 * point.phase_error
        # and the ultimate gain of that axis, where its own phase is −180°
        there = gain_at_180(inertia, damping, delay)
        assert abs(there / point.gain - 1) <= 1.001 * point.gain_error


def gain_at_180(j: float, b: float, tau: float) -> float:
    """On a fine grid of frequencies: −90° − atan(ω·J/B) − ω·τ."""
    w = np.geomspace(1e-2, 1e5, 2_000_000)
    phase = -np.pi / 2 - np.arctan(w * j / b) - w * tau
    at = w[np.argmin(np.abs(phase + np.pi))]
    return float(1 / (at * np.hypot(j * at, b)))


def test_where_the_phase_is_flat_a_degree_makes_much_of_the_ultimate_gain() -> None:
    """Much viscous friction, little dead time: ω·τ = atan(B/(ω·J)), both some degrees."""
    j, b, tau = 1e-3, 0.02, 1.5e-3
    point = CriticalPoint(gain_at_180(j, b, tau), -180.0, 2 * pi / 115.0, 0.01, 0.8, measured=True)
    widened = at_its_phase(point, j, b, tau)
    assert widened.gain_error is not None
    w = np.geomspace(10, 1e4, 400_000)
    phase = np.degrees(-np.pi / 2 - np.arctan(w * j / b) - w * tau)
    gain = 1 / (w * np.hypot(j * w, b))
    within = gain[np.abs(phase + 180) <= 0.8]
    worst = max(within.max() / point.gain - 1, 1 - within.min() / point.gain)
    assert worst > 0.05, "else there is nothing to say"
    assert widened.gain_error == pytest.approx(np.hypot(0.01, worst), rel=0.02)


def test_a_phase_that_the_axis_does_not_have_leaves_no_interval() -> None:
    point = CriticalPoint(1.0, -180.0, 0.1, 0.01, 2.0, measured=True)
    assert at_its_phase(point, 1e-3, 2e-3, 0.0).gain_error is None


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
