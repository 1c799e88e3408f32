"""Limit-cycle measurement against parabolas with known period and half-swing."""

from __future__ import annotations

import numpy as np
import pytest

from commissioning.identification.limit_cycle import measure, periods_of, settled

from .axis import Parabolas

CYCLE = Parabolas(j=1e-3, f=0.1, d=0.2, eps=0.05)


@pytest.mark.parametrize("cycle", [0.0005, 0.001, 0.002, 0.005])
def test_period_half_swing_and_direction_of_parabolas(cycle: float) -> None:
    periods = periods_of(*CYCLE.sample(cycle, 12.0), reference=0.0)
    assert len(periods) == 11
    assert np.mean(periods.period) == pytest.approx(CYCLE.period, rel=1e-3)
    np.testing.assert_allclose(periods.half_swing, CYCLE.half_swing, rtol=4e-3)
    assert np.mean(periods.direction) == pytest.approx(0.0, abs=0.01)
    assert np.mean(periods.duty) == pytest.approx(0.5, abs=0.02)


def test_the_fundamental_is_the_fourier_coefficient_of_the_whole_wave() -> None:
    time, position, command = CYCLE.sample(CYCLE.period / 4000, 3.0)
    whole = slice(0, 4000)
    expected = 2 * abs(np.mean(position[whole] * np.exp(-2j * np.pi * time[whole] / CYCLE.period)))
    periods = periods_of(time, position, command, reference=0.0)
    assert periods.fundamental[0] == pytest.approx(expected, rel=1e-3)


def test_a_coarse_encoder_costs_less_than_a_count_of_half_swing() -> None:
    time, position, command = CYCLE.sample(0.001, 12.0)
    count = CYCLE.half_swing / 200
    periods = periods_of(time, np.round(position / count) * count, command, reference=0.0)
    assert np.mean(periods.half_swing) == pytest.approx(CYCLE.half_swing, abs=count)


def test_an_offset_shows_in_direction_and_command() -> None:
    time, position, command = CYCLE.sample(0.001, 6.0)
    periods = periods_of(time, position, command + 0.07, reference=0.0, bias=0.07)
    assert np.mean(periods.command) == pytest.approx(0.07, abs=5e-3)
    assert np.mean(periods.duty) == pytest.approx(0.5, abs=0.02)


def test_a_record_without_two_crossings_has_no_period() -> None:
    assert len(periods_of([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], [0.0, 0.0, 0.0], reference=0.0)) == 0


def test_wander_is_settled_and_a_trend_is_not() -> None:
    rng = np.random.default_rng(1)
    wander = 0.1 + 1e-3 * rng.standard_normal(12)
    assert settled(wander, 1e-5)
    assert not settled(wander + np.linspace(0, 0.02, 12), 1e-5)
    assert not settled(wander[:5], 1e-5), "five periods are too few for a mean"


def test_errors_are_standard_errors_of_the_mean() -> None:
    periods = periods_of(*CYCLE.sample(0.001, 12.0), reference=0.0)
    cycle = measure(periods, 0.2, 0.05, 0.0, is_settled=True)
    expected = np.std(periods.period, ddof=1) / np.sqrt(len(periods))
    assert cycle.period_error == pytest.approx(expected)
    assert cycle.periods == 11
