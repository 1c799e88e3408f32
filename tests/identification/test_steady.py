"""The friction curve of constant speeds against curves that are known."""

from __future__ import annotations

import numpy as np
import pytest

from commissioning.identification.steady import SteadyPoint, fit, plateaus


def points(noise: float = 0.0, stribeck: float = 0.3, seed: int = 0) -> list[SteadyPoint]:
    """f 1, vs 2, B 0.02, offset 0.1."""
    rng = np.random.default_rng(seed)
    speeds = np.concatenate((np.geomspace(0.2, 30, 16), -np.geomspace(0.2, 30, 16)))
    torque = np.sign(speeds) * (1 + stribeck * np.exp(-((speeds / 2) ** 2))) + 0.02 * speeds + 0.1
    torque *= 1 + noise * rng.standard_normal(len(speeds))
    return [SteadyPoint(float(v), float(u), 0.0) for v, u in zip(speeds, torque, strict=True)]


def test_a_stribeck_curve_is_found_with_all_its_numbers() -> None:
    found = fit(points())
    assert found.coulomb.value == pytest.approx(1.0, rel=0.01)
    assert found.viscous.value == pytest.approx(0.02, rel=0.03)
    assert found.offset.value == pytest.approx(0.1, abs=0.01)
    assert found.stribeck_speed == pytest.approx(2.0, rel=0.1)
    assert found.stribeck_level == pytest.approx(0.3, rel=0.1)
    assert found.held_out < 0.01
    speed = np.array([0.5, 10.0])
    np.testing.assert_allclose(
        found.curve(speed), 1 + 0.3 * np.exp(-((speed / 2) ** 2)) + 0.02 * speed, rtol=0.01
    )


def test_a_straight_line_stays_one() -> None:
    found = fit(points(noise=0.01, stribeck=0.0))
    assert found.stribeck_speed is None
    assert found.coulomb.low <= 1.0 <= found.coulomb.high


def test_plateaus_of_a_staircase_are_its_steps() -> None:
    rng = np.random.default_rng(1)
    speeds = [2.0, 5.0, -5.0, -2.0]
    velocity = np.repeat(speeds, 200) + 0.05 * rng.standard_normal(800)
    torque = np.repeat([1.0, 1.3, -1.1, -0.9], 200) + 0.02 * rng.standard_normal(800)
    found = plateaus(velocity, torque)
    assert [p.speed for p in found] == pytest.approx(speeds, abs=0.03)
    assert [p.torque for p in found] == pytest.approx([1.0, 1.3, -1.1, -0.9], abs=0.01)


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        (lambda ps: ps[:3], "3 constant speeds"),
        (lambda ps: [p for p in ps if p.speed > 0], "one direction"),
        (lambda ps: [SteadyPoint(p.speed, -p.torque, 0.0) for p in ps], "acts against the motion"),
    ],
)
def test_points_that_show_no_curve_are_refused(chosen: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        fit(chosen(points()))  # type: ignore[operator]
