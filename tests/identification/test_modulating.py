"""Modulating functions against records of an exactly solved axis with known parameters."""

from __future__ import annotations

import numpy as np
import pytest

from commissioning.identification.modulating import estimate
from commissioning.identification.record import Record, reversals
from drivers.virtual.plant import Plant, PlantParameters

TRUTH = PlantParameters(1e-3, 2e-3, 0.1, 0.1)


def record(
    p: PlantParameters = TRUTH,
    *,
    cycle: float = 0.001,
    delay: float = 0.002,
    amplitudes: tuple[float, ...] = (0.18, 0.32),
    hysteresis: float = 0.02,
    periods: int = 6,
    count: float = 2 * np.pi / 131072,
    late: float = 0.0,
    seed: int = 0,
) -> Record:
    """Relay tests at each amplitude, one after the other, from rest; stamps are exact."""
    rng = np.random.default_rng(seed)
    plant, now = Plant(p), 0.0
    pending: list[tuple[float, float]] = []
    in_force = 0.0
    rows = []
    for d in amplitudes:
        sign, switches = 1, 0
        while switches < 2 * periods:
            y = round(plant.position / count) * count
            if sign * y > hysteresis:
                sign, switches = -sign, switches + 1
            rows.append((now, y, now, sign * d + p.load))
            pending.append((now + delay, sign * d + p.load))
            until = now + cycle * (1 + (rng.exponential() if rng.random() < late else 0.0))
            while now < until:
                for t, u in [x for x in pending if x[0] <= now + 1e-12]:
                    in_force = u
                    pending.remove((t, u))
                step = min([until, *[t for t, _ in pending]])
                plant.advance(step - now, in_force)
                now = step
    time, position, sent, command = np.array(rows).T
    return Record.of(time, position, sent, command, count)


@pytest.mark.parametrize("cycle", [0.001, 0.004])
def test_all_five_numbers_of_a_rigid_axis(cycle: float) -> None:
    found = estimate(record(cycle=cycle))
    assert found.coulomb.value == pytest.approx(0.1, rel=0.005)
    assert found.inertia.value == pytest.approx(1e-3, rel=0.01)
    assert found.viscous.value == pytest.approx(2e-3, rel=0.3)
    assert found.offset.value == pytest.approx(0.0, abs=1e-3)
    assert found.dead_time.value == pytest.approx(0.002, rel=0.1)
    for name, truth in (
        ("coulomb", 0.1),
        ("inertia", 1e-3),
        ("viscous", 2e-3),
        ("dead_time", 2e-3),
    ):
        interval = getattr(found, name)
        assert interval.low <= truth <= interval.high, name
    assert found.residual < 0.02
    assert found.periods < 13


@pytest.mark.parametrize(
    "p",
    [
        PlantParameters(1e-3, 2e-3, 0.1, 0.1, load=0.05),
        PlantParameters(1e-3, 2e-3, 0.1, 0.1, asymmetry=0.2),
        PlantParameters(1e-3, 0.01, 0.1, 0.1),
        PlantParameters(1e-3, 2e-3, 0.1, 0.12),
    ],
)
def test_load_direction_viscosity_and_breakaway(p: PlantParameters) -> None:
    found = estimate(record(p))
    assert found.coulomb.value == pytest.approx(0.1, rel=0.01)
    assert found.offset.value == pytest.approx(p.load + 0.1 * p.asymmetry, abs=1.5e-3)


def test_late_cycles_with_true_stamps_do_no_harm() -> None:
    found = estimate(record(late=0.1, cycle=0.002))
    assert found.coulomb.value == pytest.approx(0.1, rel=0.01)


def test_dead_time_is_told_from_friction() -> None:
    for delay in (0.0, 0.005, 0.01):
        found = estimate(record(delay=delay))
        assert found.dead_time.value == pytest.approx(delay, abs=3e-4)
        assert found.coulomb.value == pytest.approx(0.1, rel=0.01)


def test_one_amplitude_alone_shows_in_the_condition() -> None:
    p = PlantParameters(1e-3, 0.02, 0.1, 0.1)
    two = estimate(record(p, amplitudes=(0.2, 0.5)))
    one = estimate(record(p, amplitudes=(0.3, 0.3)))
    assert one.condition > 1.5 * two.condition


def test_a_stribeck_like_axis_shows_in_the_residual() -> None:
    """The same record with a friction that is no Coulomb friction.

    The torque is bent afterwards.
    """
    good = record()
    speed = np.gradient(good.position, good.time)
    bent = good.command + 0.08 * np.tanh(speed) ** 3
    spoiled = Record.of(good.time, good.position, good.sent, bent, good.resolution)
    assert estimate(spoiled).residual > 3 * estimate(good).residual


def test_reversals_are_found_to_a_fraction_of_a_cycle() -> None:
    time = np.arange(0, 2, 0.004)
    position = np.sin(2 * np.pi * 2.3 * time + 0.4)
    wave = Record.of(time, position, time, np.zeros_like(time), 1e-4)
    instants, begins = reversals(wave)
    expected = (np.pi / 2 - 0.4 + np.pi * np.arange(20)) / (2 * np.pi * 2.3)
    expected = expected[expected < time[-1]]
    np.testing.assert_allclose(instants, expected[: len(instants)], atol=4e-4)
    assert len(instants) >= len(expected) - 1
    assert begins == 1


def test_too_short_a_record_is_refused() -> None:
    short = record(periods=1, amplitudes=(0.2,))
    with pytest.raises(ValueError, match="reversals"):
        estimate(short)
