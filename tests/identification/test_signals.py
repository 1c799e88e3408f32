"""Hat moments and exact integrals against closed forms and quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from commissioning.identification.signals import Steps, hat_moments

TIMES = np.array([0.0, 0.1, 0.15, 0.4, 0.42, 0.7, 1.0])


def hat(k: int, t: float) -> float:
    """Λ_k of TIMES."""
    left, middle, right = TIMES[k - 1 : k + 2]
    if left <= t <= middle:
        return (t - left) / (middle - left)
    return (right - t) / (right - middle) if middle <= t <= right else 0.0


def test_second_differences_are_hat_moments_of_the_acceleration_at_any_sampling() -> None:
    """y = sin(3t): ∫Λ·ÿ by quadrature, of the samples alone by hat_moments."""
    found = hat_moments(TIMES, np.sin(3 * TIMES))
    for n, k in enumerate(range(1, len(TIMES) - 1)):
        a, m, b = TIMES[k - 1 : k + 2]
        integral = sum(
            quad(lambda t, k=k: -9 * np.sin(3 * t) * hat(k, t), *span)[0]
            for span in ((a, m), (m, b))
        )
        assert found[n] == pytest.approx(integral, abs=1e-12)


def test_steps_have_the_integrals_of_their_closed_form() -> None:
    steps = Steps(np.array([0.0, 1.0, 3.0]), np.array([2.0, -1.0, 0.5]))
    at = np.array([-0.5, 0.5, 1.0, 2.0, 4.0])
    np.testing.assert_allclose(steps.at(at), [2, 2, -1, -1, 0.5])
    np.testing.assert_allclose(steps.integral(at), [-1, 1, 2, 1, 0.5])
    # ∬: t² up to 1; then 1 + 2(t−1) − (t−1)²/2; at 3 it is 3; then 3 + 0·(t−3) + (t−3)²/4
    np.testing.assert_allclose(steps.double_integral(at), [0.25, 0.25, 1, 2.5, 3.25])


def test_a_sign_alternates_at_its_changes() -> None:
    sign = Steps.sign(0.0, -1, np.array([0.3, 0.5]))
    np.testing.assert_allclose(sign.at(np.array([0.1, 0.4, 0.6])), [-1, 1, -1])
    assert Steps.sign(0.0, 1, np.array([])).at(np.array([5.0]))[0] == 1
