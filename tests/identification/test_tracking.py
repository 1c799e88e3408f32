"""Following errors with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from commissioning.identification.tracking import at_rest, creeping, reversal_error

TURNS, COUNT = 2, 1000
PHASE = 2 * np.pi * np.arange(1, TURNS * COUNT + 1) / COUNT
COMMAND = 1 - np.cos(PHASE)


def test_a_lag_is_no_error_of_friction() -> None:
    found, left = reversal_error(COMMAND, COMMAND - 0.02 * np.sin(PHASE) - 0.003, TURNS)
    assert found == pytest.approx(0, abs=1e-12)
    assert np.abs(left).max() < 1e-12


def test_a_pulse_after_each_reversal_is_found_whole_in_spite_of_a_lag() -> None:
    since = (PHASE % np.pi) / np.pi  # from reversal to reversal
    pulse = np.sign(np.sin(PHASE - 1e-9)) * 0.005 * np.exp(-(((since - 0.1) / 0.03) ** 2))
    found, left = reversal_error(COMMAND, COMMAND - 0.02 * np.sin(PHASE) - pulse, TURNS)
    assert found == pytest.approx(0.005, rel=1e-3)
    assert left == pytest.approx(pulse, abs=1e-9)


def test_a_creeping_axis_that_only_lags_has_no_error_and_one_that_sticks_has() -> None:
    out = np.linspace(0, 1e-3, 500)
    command = np.concatenate([out, out[::-1]])
    lag = np.concatenate([np.full(500, 1e-5), np.full(500, -1e-5)])
    assert creeping(command, command - lag) == pytest.approx(0, abs=1e-15)
    stuck = np.floor(command / 1e-4) * 1e-4  # it moves in steps of 0.1 mm
    assert creeping(command, stuck) == pytest.approx(1e-4 / 12**0.5, rel=0.05)


def test_hunting_is_turning_around_again_and_again_by_more_than_the_encoder() -> None:
    time = np.arange(0, 2, 1e-3)
    swing, hunts = at_rest(0.01 * np.sign(np.sin(2 * np.pi * 4 * time)), 1e-4)
    assert swing == pytest.approx(0.01)
    assert hunts
    assert at_rest(2e-4 * np.sign(np.sin(2 * np.pi * 4 * time)), 1e-3)[1] is False
    assert at_rest(0.01 * np.exp(-time), 1e-4)[1] is False  # it settles, slowly
    assert at_rest(np.zeros(100), 1e-4) == (0.0, False)
