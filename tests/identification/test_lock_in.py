"""The exact balance against closed forms, and against an axis that no rigid model fits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from commissioning.identification.fitting import Fitter
from commissioning.identification.friction_laws import Law
from commissioning.identification.lock_in import Phasors, balance, lock_in, phasors
from commissioning.identification.oscillation import pair, steady_oscillations
from commissioning.identification.phase_locked import phase_locked, solve
from commissioning.identification.record import Kinematics, Record, kinematics, reversals
from drivers.virtual.compliant_plant import CompliantParameters, CompliantPlant
from drivers.virtual.friction import Dry
from tests.identification.axis import matched

J, F, D1, EPS = 1e-3, 0.1, 0.18, 0.05


def test_two_parabolic_limit_cycles_give_the_friction_of_their_closed_form() -> None:
    """method.md 3 on the rigid axis of tests/identification/axis.py.

    F, J and no dead time, exactly.
    """
    pair_of = matched(J, F, D1, EPS, 0.33)
    found = []
    for cycle in pair_of:
        step = cycle.period / 200
        time, position, command = cycle.sample(step, 8)
        record = Record.of(time, position, time - step, command, 1e-7)
        # the closed form knows the reversals: half a period apart, the first at phase 1/2 of
        # `sample`
        at = (0.5 - 0.123) * cycle.period + cycle.period / 2 * np.arange(15)
        # the switchings, too: at ε after the reversal, not at a sample
        known = exact_switchings(cycle, record)
        slope = kinematics(record).speed
        begin = (0.55 - 0.123) * cycle.period  # a little after a reversal
        found.append(phasors(known, Kinematics(at, 1, slope), begin, cycle.period, 6))
    result = lock_in(found[0], found[1], 1e-7, pair_of[0].period / 200)
    assert result.coulomb.value == pytest.approx(F, rel=2e-4)
    assert result.inertia.value == pytest.approx(J, rel=2e-4)
    assert result.dead_time.value == pytest.approx(0.0, abs=2e-4 * pair_of[0].period)
    assert result.viscous.value == pytest.approx(0.0, abs=2e-4 * J / pair_of[0].period * 40)


def exact_switchings(cycle: Any, record: Record) -> Record:
    """The record with the torque at the instants where the relay switches."""
    up = (cycle.d - cycle.f) / cycle.j
    after = np.sqrt(2 * (cycle.half_swing + cycle.eps) / up)
    half = cycle.period / 2
    # `sample` begins at phase 0.123; each half wave begins at a reversal with +d along the motion
    first = -0.123 * cycle.period
    starts = first + half * np.arange(18)
    sent = np.concatenate([[t + after] for t in starts])
    command = np.array([-cycle.d if k % 2 == 0 else cycle.d for k in range(len(starts))])
    return Record.of(record.time, record.position, sent, command, record.resolution)


def random_phasors(count: int, plant: complex, friction: complex, size: float) -> Phasors:
    rng = np.random.default_rng(int(1e6 * size))
    torque = size * np.exp(1j * rng.normal(0.0, 0.05, (count, 3)))
    sign = 4 / np.pi * np.exp(1j * (1.2 + rng.normal(0.0, 0.05, (count, 3))))
    return Phasors(
        torque, plant * (torque - friction * sign), sign, np.zeros(count), np.zeros(count), 0.1,
        1.0,
    )  # fmt: skip


def test_any_linear_plant_drops_out() -> None:
    plant, friction = 0.3 * np.exp(2j), 0.07 * np.exp(0.2j)
    solved = balance(
        random_phasors(3, plant, friction, 0.2), random_phasors(3, plant, friction, 0.4)
    )
    assert solved.plant == pytest.approx(plant)
    assert solved.friction == pytest.approx(friction)


def test_one_period_each_is_the_closed_form() -> None:
    a, b = (random_phasors(1, 0.3j, 0.05, size) for size in (0.2, 0.4))
    b = Phasors(b.torque * np.exp(0.3j), b.position, b.sign, b.mean_torque, b.mean_sign, 0.1, 1.0)
    (u1, y1, s1), (u2, y2, s2) = ((p.torque[0, 0], p.position[0, 0], p.sign[0, 0]) for p in (a, b))
    closed = (y1 * u2 - y2 * u1) / (y1 * s2 - y2 * s1)
    assert balance(a, b).friction == pytest.approx(closed)


def oscillate(plant: CompliantPlant, period: float, amplitudes: tuple[float, ...]) -> Record:
    """A square wave of each amplitude with a weak centring, 40 periods each, sampled at 1 ms."""
    rows, now, before = [], 0.0, 0.0
    for d in amplitudes:
        for _ in range(round(40 * period / 0.001)):
            y = plant.position
            u = (d if now % period < period / 2 else -d) - 0.3 * y - 0.002 * (y - before) / 0.001
            rows.append((now, y, u))
            before = y
            plant.advance(0.001, u)
            now += 0.001
    time, position, command = np.array(rows).T
    return Record.of(time, position, time, command, 1e-6)


def test_a_resonant_axis_has_its_friction_where_no_rigid_model_has() -> None:
    """Motor and load on a spring at 12 Hz, oscillated at 5 Hz.

    The load is a part of G and drops out.
    """
    p = CompliantParameters(1e-3, 1e-3, Dry(0.1, 0.1), resonance=12.0, ratio=1.0, damping=0.1)
    record = oscillate(CompliantPlant(p), 0.2, (0.25, 0.45))
    known = kinematics(record)
    first, second = (phasors(record, known, begin + 0.06, 0.2, 12) for begin in (5.0, 13.0))
    exact = lock_in(first, second, 1e-6, 0.001)
    assert exact.coulomb.value == pytest.approx(0.1, rel=0.01)
    assert exact.coulomb.low <= 0.1 <= exact.coulomb.high
    rigid = Fitter(record.between(5.0, 16.0)).fit(Law())
    assert abs(rigid.coefficients[0] / 0.1 - 1) > 0.02, "the rigid model is wrong here"
    assert rigid.held_out > 0.03, "and its residual says so"


def test_steady_oscillations_of_one_period_are_found() -> None:
    p = CompliantParameters(1e-3, 2e-3, Dry(0.1, 0.1))
    record = oscillate(CompliantPlant(p), 0.2, (0.25, 0.45))
    found = pair(steady_oscillations(record, kinematics(record)))
    assert found is not None
    assert found[0].period == pytest.approx(0.2, rel=2e-3)
    assert found[1].half_swing > 1.5 * found[0].half_swing
    assert min(o.periods for o in found) > 15


def test_phase_locked_is_the_balance_of_first_harmonics() -> None:
    """U = Y/G + 4j·f/(πA)·Y for two amplitudes of one G: f is found exactly."""
    plant, friction = -0.2 + 0.05j, 0.08
    y = (0.3 * np.exp(0.4j), 0.9 * np.exp(-0.7j))
    u = [v / plant + 4j * friction / (np.pi * abs(v)) * v for v in y]
    assert solve(u[0], y[0], u[1], y[1]) == pytest.approx(friction)
    made = [
        Phasors(
            np.full((4, 3), uu), np.full((4, 3), yy), np.ones((4, 3), complex), np.full(4, 0.02),
            np.zeros(4), 0.1, abs(yy),
        )
        for uu, yy in zip(u, y, strict=True)
    ]  # fmt: skip
    found = phase_locked(*made)
    assert found.coulomb.value == pytest.approx(friction)
    assert found.offset.value == pytest.approx(0.02)
    assert found.plant == pytest.approx(plant)


def test_reversals_of_a_coarsely_sampled_wave_are_found_by_a_spline() -> None:
    time = np.arange(0, 3, 0.02)
    position = np.sin(2 * np.pi * 2.3 * time + 0.4)
    instants, begins = reversals(Record.of(time, position, time, np.zeros_like(time), 1e-6))
    expected = (np.pi / 2 - 0.4 + np.pi * np.arange(20)) / (2 * np.pi * 2.3)
    np.testing.assert_allclose(instants, expected[: len(instants)], atol=2e-4)
    assert begins == 1
