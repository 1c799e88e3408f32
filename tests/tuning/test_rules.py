"""Tuning rules against their printed numbers,
and against the property that each one is made for."""

from __future__ import annotations

from collections.abc import Callable
from math import atan, degrees, inf, pi, sqrt

import control as ct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from commissioning.tuning.rules import (
    Pid,
    astrom_hagglund,
    cascade,
    landau_voda_pi,
    landau_voda_pid,
    symmetrical_optimum,
    tyreus_luyben_pi,
    tyreus_luyben_pid,
    ziegler_nichols_pi,
    ziegler_nichols_pid,
)


def continuous(gains: Pid) -> ct.TransferFunction:
    """K·(1 + 1/(Ti·s) + Td·s)."""
    ti, td = gains.integral_time, gains.derivative_time
    return gains.gain * ct.tf([ti * td, ti, 1], [ti, 0])


@pytest.mark.parametrize(
    ("rule", "gains"),
    [
        (ziegler_nichols_pi, Pid(0.9, 5 / 6)),
        (ziegler_nichols_pid, Pid(1.2, 0.5, 0.125)),
        (tyreus_luyben_pi, Pid(0.625, 2.2)),
        (tyreus_luyben_pid, Pid(2 / 2.2, 2.2, 1 / 6.3)),
    ],
)
def test_rules_of_the_ultimate_point_have_their_printed_numbers(
    rule: Callable[[float, float], Pid], gains: Pid
) -> None:
    """Ku = 2, Tu = 1 s."""
    found = rule(2.0, 1.0)
    assert (found.gain, found.integral_time, found.derivative_time) == pytest.approx(
        (gains.gain, gains.integral_time, gains.derivative_time)
    )


@given(
    gain=st.floats(1e-3, 1e3),
    phase=st.floats(-205, -125),
    frequency=st.floats(0.1, 1e3),
    margin=st.floats(35, 49),
)
def test_astrom_hagglund_puts_any_point_on_the_unit_circle_at_the_margin(
    gain: float, phase: float, frequency: float, margin: float
) -> None:
    gains = astrom_hagglund(gain, phase, frequency, margin)
    loop = continuous(gains)(1j * frequency) * gain * np.exp(1j * np.radians(phase))
    assert abs(loop) == pytest.approx(1.0)
    assert np.degrees(np.angle(loop)) == pytest.approx(margin - 180)
    assert gains.integral_time == pytest.approx(4 * gains.derivative_time)


def test_a_point_that_no_pid_can_turn_to_the_margin_is_refused() -> None:
    with pytest.raises(ValueError, match="turned by 85°"):
        astrom_hagglund(1.0, -220.0, 10.0)


@pytest.mark.parametrize(("k", "lag"), [(1.0, 0.1), (40.0, 3e-3)])
def test_landau_voda_is_the_symmetrical_optimum_on_an_integrator_with_one_lag(
    k: float, lag: float
) -> None:
    """K/(s(1+sT)) is at −135° at ω = 1/T with |G| = K·T/√2.

    The optimum is Kc = 1/(2KT), Ti = 4T.
    """
    gains = landau_voda_pi(k * lag / sqrt(2), 1 / lag)
    assert gains.gain == pytest.approx(1 / (2 * k * lag))
    assert gains.integral_time == pytest.approx(4 * lag)
    _, margin, _, _ = ct.margin(continuous(gains) * ct.tf([k], [lag, 1, 0]))
    assert margin == pytest.approx(degrees(atan(2) - atan(0.5)), abs=1e-6)  # 36.87°


def test_landau_voda_pid_has_its_printed_numbers() -> None:
    gains = landau_voda_pid(1.0, 1.0, beta=1.0)
    assert (gains.gain, gains.integral_time, gains.derivative_time) == pytest.approx(
        (5 / (8 * sqrt(2)), 5.0, 0.8)
    )
    with pytest.raises(ValueError, match=r"1…2"):
        landau_voda_pid(1.0, 1.0, beta=3.0)


def velocity_loop(gain: float, integral: float, inertia: float) -> ct.TransferFunction:
    return gain * ct.tf([integral, 1], [integral, 0]) * ct.tf([1], [inertia, 0])


def test_the_symmetrical_optimum_has_its_margin_with_a_lag_and_with_a_dead_time() -> None:
    gains = symmetrical_optimum(2e-3, 0.01)
    loop = velocity_loop(gains.velocity_gain, gains.integral_time, 2e-3)
    _, with_lag, _, crossover = ct.margin(loop * ct.tf([1], [0.01, 1]))
    assert with_lag == pytest.approx(36.87, abs=0.01)
    assert crossover == pytest.approx(1 / 0.02)  # 1/(2T)
    _, alone, _, at = ct.margin(loop)
    assert alone - degrees(at * 0.01) == pytest.approx(34.0, abs=1.0)


@pytest.mark.parametrize("ratio", [3.0, 4.0, 6.0])
def test_the_cascade_crosses_at_the_inverse_of_ratio_times_delay(ratio: float) -> None:
    j, delay = 5e-3, 0.004
    gains = cascade(j, 0.0, delay, ratio=ratio)
    loop = velocity_loop(gains.velocity_gain, gains.integral_time, j)
    _, margin, _, crossover = ct.margin(loop)
    assert crossover == pytest.approx(1 / (ratio * delay), rel=0.06)
    # atan(ωTi) = atan(a), less ω·T, less what the position loop takes: atan(1/5)
    left = margin - degrees(crossover * delay) - degrees(atan(gains.position_gain / crossover))
    assert left == pytest.approx(
        degrees(atan(ratio)) - degrees(1 / ratio) - degrees(atan(0.2)), abs=1
    )


def test_the_cascade_cancels_a_short_time_constant_of_the_axis() -> None:
    assert cascade(1e-3, 0.1, 0.01).integral_time == pytest.approx(0.01)
    assert cascade(1e-3, 1e-4, 0.01).integral_time == pytest.approx(0.16)


def test_the_cascade_is_no_faster_than_it_may_be() -> None:
    gains = cascade(1e-3, 0.0, 1e-4, fastest=100.0)
    assert gains.velocity_gain == pytest.approx(1e-3 * 100)
    assert gains.position_gain == pytest.approx(20)
    assert cascade(1e-3, 0.0, 0.1, fastest=100.0) == cascade(1e-3, 0.0, 0.1, fastest=inf)


def test_the_ultimate_period_is_in_seconds_not_in_radians() -> None:
    assert ziegler_nichols_pi(1.0, 2 * pi).integral_time == pytest.approx(2 * pi / 1.2)
