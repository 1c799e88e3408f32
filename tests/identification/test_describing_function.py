"""Describing functions against the Fourier integral of the waveform that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from commissioning.identification.describing_function import (
    equivalent,
    inverse_locus,
    relay,
)

ratios = st.floats(0.02, 0.95)
torques = st.floats(0.01, 100)


def fundamental_of_relay(swing: float, d: float, eps: float) -> complex:
    """Fourier coefficient of a relay's output for the input A·sin θ, by quadrature, over A.

    The relay switches up where A·sin θ = +ε rising, and down where it is −ε falling.
    """
    up = np.arcsin(eps / swing)
    down = np.pi + up

    def output(theta: float) -> float:
        return d if up <= theta < down else -d

    edges = [up, down]
    real = quad(lambda x: output(x) * np.sin(x), 0, 2 * np.pi, points=edges, limit=200)[0]
    imaginary = quad(lambda x: output(x) * np.cos(x), 0, 2 * np.pi, points=edges, limit=200)[0]
    return complex(real, imaginary) / (np.pi * swing)


@given(share=ratios, d=torques, swing=st.floats(1e-4, 10))
def test_a_relay_with_hysteresis_is_the_first_harmonic_of_its_output(
    share: float, d: float, swing: float
) -> None:
    expected = fundamental_of_relay(swing, d, share * swing)
    assert complex(relay(swing, d, share * swing)) == pytest.approx(expected, rel=1e-6)


def test_friction_adds_a_quadrature_term_because_it_follows_velocity() -> None:
    # sign(cos θ)·f has the Fourier coefficient 4f/π on cos θ, that is +j in (4.7)
    swing, d, eps, f = 0.3, 0.5, 0.1, 0.2
    difference = complex(equivalent(swing, d, eps, f) - relay(swing, d, eps))
    assert difference == pytest.approx(4j * f / (np.pi * swing))


@given(share=ratios, f=st.floats(0, 2), d=st.floats(0.1, 10), swing=st.floats(1e-3, 10))
def test_4_10_with_its_missing_factor_is_minus_one_over_n(
    share: float, f: float, d: float, swing: float
) -> None:
    n = complex(equivalent(swing, d, share * swing, f))
    if abs(n) > 1e-3 * d / swing:
        assert complex(inverse_locus(swing, d, share * swing, f)) == pytest.approx(-1 / n, rel=1e-6)


def test_4_10_becomes_4_9_without_hysteresis() -> None:
    swings = np.array([0.1, 0.2, 0.7])
    closed_form = -np.pi * swings / 4 * (0.4 - 0.1j) / (0.4**2 + 0.1**2)
    np.testing.assert_allclose(inverse_locus(swings, 0.4, 0.0, 0.1), closed_form, rtol=1e-12)


def test_without_hysteresis_the_measured_point_lies_at_minus_180_minus_atan_f_over_d() -> None:
    # method.md 6, with the source's misprint mended
    point = complex(inverse_locus(1.0, 0.4, 0.0, 0.1))
    assert np.degrees(np.angle(point)) % 360 - 360 == pytest.approx(
        -180 - np.degrees(np.arctan(0.1 / 0.4)), abs=1e-9
    )


def test_a_swing_below_the_hysteresis_is_refused() -> None:
    with pytest.raises(ValueError, match="never switches"):
        relay(0.1, 1.0, 0.2)
