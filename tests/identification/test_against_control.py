"""Describing functions and loci against python-control, an independent oracle (test only)."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from commissioning.identification.describing_function import (
    equivalent,
    inverse_locus,
    relay,
)

ratios = st.floats(0.05, 0.95)
torques = st.floats(0.05, 20)
swings = st.floats(1e-2, 10)


def relay_of_control(swing: float, d: float, eps: float) -> complex:
    if eps == 0:
        return complex(ct.describing_function(ct.relay_hysteresis_nonlinearity(d, 0.0), swing))
    return complex(ct.describing_function(ct.relay_hysteresis_nonlinearity(d, eps), swing))


def both_of_control(swing: float, d: float, eps: float, f: float) -> complex:
    """Friction is a relay without hysteresis on the velocity, which leads the position by 90°."""
    return relay_of_control(swing, d, eps) + 1j * relay_of_control(swing, f, 0.0)


@given(share=ratios, d=torques, swing=swings)
def test_the_relay_with_hysteresis(share: float, d: float, swing: float) -> None:
    assert complex(relay(swing, d, share * swing)) == pytest.approx(
        relay_of_control(swing, d, share * swing), rel=1e-9
    )


@given(d=torques, swing=swings)
def test_the_relay_without_hysteresis(d: float, swing: float) -> None:
    assert complex(relay(swing, d, 0.0)) == pytest.approx(relay_of_control(swing, d, 0.0), rel=1e-9)


@given(share=ratios, d=torques, f=torques, swing=swings)
def test_relay_and_friction_together_4_7(share: float, d: float, f: float, swing: float) -> None:
    eps = share * swing
    assert complex(equivalent(swing, d, eps, f)) == pytest.approx(
        both_of_control(swing, d, eps, f), rel=1e-9
    )


@given(d=torques, f=torques, swing=swings)
def test_the_locus_without_hysteresis_4_9_figure_4(d: float, f: float, swing: float) -> None:
    assert complex(inverse_locus(swing, d, 0.0, f)) == pytest.approx(
        -1 / both_of_control(swing, d, 0.0, f), rel=1e-9
    )


@given(d=torques, share=st.floats(0.05, 0.8), swing=swings)
def test_the_locus_with_hysteresis_4_10_figure_5(d: float, share: float, swing: float) -> None:
    eps, f = 0.02 * swing / 0.05, share * d
    assert complex(inverse_locus(swing, d, eps, f)) == pytest.approx(
        -1 / both_of_control(swing, d, eps, f), rel=1e-9
    )


@given(eps=st.floats(1e-3, 0.5), beyond=st.floats(1.01, 50), f=st.floats(0.01, 0.39))
def test_the_locus_over_the_hysteresis_4_10_figure_6(eps: float, beyond: float, f: float) -> None:
    swing = beyond * eps
    assert complex(inverse_locus(swing, 0.4, eps, f)) == pytest.approx(
        -1 / both_of_control(swing, 0.4, eps, f), rel=1e-9
    )


class _Waveform(ct.DescribingFunctionNonlinearity):  # type: ignore[misc]
    """Relay and friction as python-control samples them itself: no formula of anybody's."""

    def __init__(self, d: float, eps: float, f: float) -> None:
        self.d, self.eps, self.f = d, eps, f
        self.state, self.before = -1.0, 0.0

    def __call__(self, value: Any) -> float:
        if self.state < 0 and value > self.eps:
            self.state = 1.0
        elif self.state > 0 and value < -self.eps:
            self.state = -1.0
        direction = 1.0 if value > self.before else -1.0
        self.before = value
        return self.d * self.state + self.f * direction

    def _isstatic(self) -> bool:
        return False


@given(share=st.floats(0.1, 0.9), f=st.floats(0.05, 0.9))
@settings(max_examples=6, deadline=None)
def test_the_sampled_waveform_has_that_first_harmonic(share: float, f: float) -> None:
    found = ct.describing_function(
        _Waveform(1.0, share, f), 1.0, num_points=2000, zero_check=False, try_method=False
    )
    # the direction of the first sample is not known to it, and a switching falls between samples
    first = complex(np.ravel(found)[0])
    assert first == pytest.approx(complex(equivalent(1.0, 1.0, share, f)), abs=0.01)
