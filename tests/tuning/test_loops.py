"""The sampled loop against python-control, and against the loop simulated."""

from __future__ import annotations

import warnings
from collections import deque
from itertools import pairwise

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from commissioning.tuning.controllers import Gains, law, response
from commissioning.tuning.margins import margins
from commissioning.tuning.plant import LoopPlant
from commissioning.tuning.rules import (
    Cascade,
    Pid,
    cascade,
    landau_voda_pi,
    landau_voda_pid,
    symmetrical_optimum,
)
from commissioning.tuning.step import Friction, step
from drivers.virtual.plant import Plant, PlantParameters

J = 1e-3
PLANTS = [
    LoopPlant(J, 2e-3, 0.002, 0.001),
    LoopPlant(J, 2e-3, 0.0025, 0.001),
    LoopPlant(J, 0.03, 0.0133, 0.004),
    LoopPlant(J, 0.0, 0.003, 0.01),
    LoopPlant(J, 2e-3, 0.0, 0.00025),
]
GAINS: list[Gains] = [Pid(2.0, 1.0, 0.05), Pid(0.5, 2.0, 0.1), Cascade(0.05, 0.1, 8.0)]


def exact(plant: LoopPlant) -> ct.StateSpace:
    """The sampled axis by matrix exponentials: position, velocity, and the commands under way."""
    a = np.array([[0, 1, 0], [0, -plant.viscous / plant.inertia, 1 / plant.inertia], [0, 0, 0]])
    ts, n = plant.cycle, plant.cycles
    late = plant.split
    early, rest, whole = (expm(a * t) for t in (late, ts - late, ts))
    old = rest[:2, :2] @ early[:2, 2]
    new = rest[:2, 2]
    states = 2 + n  # u(k−1) … u(k−n)
    phi, gamma = np.zeros((states, states)), np.zeros((states, 1))
    phi[:2, :2] = whole[:2, :2]
    if n == 0:
        gamma[:2, 0] = new
    else:
        phi[:2, 1 + n] += old
        if n == 1:
            gamma[:2, 0] += new
        else:
            phi[:2, n] += new
        gamma[2, 0] = 1
        for k in range(1, n):
            phi[2 + k, 1 + k] = 1
    output = np.zeros((1, states))
    output[0, 0] = 1
    return ct.ss(phi, gamma, output, 0, ts)


@pytest.mark.parametrize("cycles", [0, 1, 3])
def test_whole_cycles_of_dead_time_are_zero_order_hold_of_python_control(cycles: int) -> None:
    plant = LoopPlant(J, 2e-3, cycles * 0.004, 0.004)
    held = ct.sample_system(ct.tf([1], [J, 2e-3, 0]), 0.004, method="zoh")
    held *= ct.tf([1], [1, *[0] * cycles], 0.004) if cycles else 1
    w = np.geomspace(1, 700, 20)
    np.testing.assert_allclose(plant.response(w), held(np.exp(1j * w * 0.004)), rtol=1e-6)


@pytest.mark.parametrize("plant", PLANTS)
def test_the_response_is_that_of_the_exponential_matrices(plant: LoopPlant) -> None:
    w = np.geomspace(0.1, 0.99 * np.pi / plant.cycle, 30)
    expected = np.array([complex(exact(plant)(z)) for z in np.exp(1j * w * plant.cycle)])
    np.testing.assert_allclose(plant.response(w), expected, rtol=1e-5)


@pytest.mark.parametrize("plant", PLANTS)
def test_a_pulse_of_torque_moves_the_matrices_as_it_moves_the_axis(plant: LoopPlant) -> None:
    count = 40
    impulse = np.zeros(count)
    impulse[3] = 1.0
    response = ct.forced_response(exact(plant), np.arange(count) * plant.cycle, impulse).outputs
    axis = Plant(PlantParameters(plant.inertia, plant.viscous, 0.0, 0.0))
    seen = []
    for n in range(count):
        seen.append(axis.position)
        for k, duration in pieces(plant, n):
            axis.advance(duration, 1.0 if k == 3 else 0.0)
    np.testing.assert_allclose(response, seen, rtol=1e-9, atol=1e-12)


def pieces(plant: LoopPlant, n: int) -> list[tuple[int, float]]:
    """Which command acts how long in cycle n, by its arrival at k·Ts + τ."""
    ts, edges = plant.cycle, [n * plant.cycle, (n + 1) * plant.cycle]
    arrivals = {k: k * ts + plant.dead_time for k in range(n - plant.cycles - 2, n + 1)}
    edges = sorted({*edges, *(t for t in arrivals.values() if edges[0] < t < edges[1])})
    found = []
    for begin, end in pairwise(edges):
        k = max(k for k, t in arrivals.items() if t <= begin + 1e-12)
        found.append((k, end - begin))
    return found


def controller(gains: Gains, ts: float) -> ct.TransferFunction:
    """The same law written down by hand: backward rectangles, filtered derivative, difference."""
    z = ct.tf([1, 0], [1], ts)
    integral = 1 + ts / gains.integral_time * z / (z - 1)
    if isinstance(gains, Cascade):
        return gains.velocity_gain * integral * (gains.position_gain + (z - 1) / (z * ts))
    tf = gains.derivative_time / 10
    slope = gains.derivative_time * (z - 1) / ((tf + ts) * z - tf)
    return gains.gain * (integral + slope)


def of_control(plant: LoopPlant, gains: Gains) -> ct.TransferFunction:
    return ct.minreal(ct.tf(exact(plant)), verbose=False) * controller(gains, plant.cycle)


@pytest.mark.parametrize("gains", [*GAINS, Pid(1.0, np.inf, 0.05)])
def test_the_controller_s_response_is_its_law_written_in_z(gains: Gains) -> None:
    w = np.geomspace(1, 3000, 20)
    expected = controller(gains, 0.001)(np.exp(1j * w * 0.001))
    np.testing.assert_allclose(response(gains, 0.001, w), expected, rtol=1e-9)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("gains", [*GAINS, Pid(1.0, np.inf, 0.05)])
def test_margins_are_those_of_python_control(plant: LoopPlant, gains: Gains) -> None:
    found = margins(plant, gains)
    loop = of_control(plant, gains)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns about its own grid
        gain, phase, distance, _, _, _ = ct.stability_margins(loop)
        poles = ct.feedback(loop, 1).poles()
    assert found.stable == bool(np.all(np.abs(poles) < 1))
    assert found.sensitivity == pytest.approx(1 / distance, rel=1e-3)
    if found.stable:
        assert found.phase == pytest.approx(abs(phase), abs=0.02)
        if gain > 1:  # it gives the nearer of rise and fall
            assert found.gain_db == pytest.approx(20 * np.log10(gain), abs=0.02)


def test_a_velocity_loop_leaves_the_position_open_and_is_stable_nevertheless() -> None:
    plant = LoopPlant(J, 2e-3, 0.002, 0.001)
    found = margins(plant, symmetrical_optimum(J, plant.delay + 0.0005))
    assert found.stable
    assert found.phase == pytest.approx(35, abs=1)


@given(
    b=st.floats(0, 0.05), tau=st.floats(0, 0.02), cycle=st.sampled_from([0.001, 0.004, 0.01]),
    ratio=st.floats(1.2, 8),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_a_loop_that_margins_call_stable_comes_to_rest_and_no_other(
    b: float, tau: float, cycle: float, ratio: float
) -> None:
    plant = LoopPlant(J, b, tau, cycle)
    gains = cascade(J, b, plant.delay + cycle / 2, ratio=ratio)
    found = margins(plant, gains)
    if found.phase is None or abs(found.phase) < 3 or found.sensitivity > 15:
        return  # at the border nobody can tell in a finite time
    moved = linear_step(plant, gains, 4000)
    late = np.abs(moved[-400:] - 1).max()
    assert (late < np.abs(moved - 1).max() * 0.9 and late < 5) == found.stable


def linear_step(plant: LoopPlant, gains: Gains, count: int) -> np.ndarray:
    """The loop without friction and limits, on the virtual axis, reference 1 rad."""
    axis = Plant(PlantParameters(plant.inertia, plant.viscous, 0.0, 0.0))
    controller = law(gains, plant.cycle, 1e12, 0.0)
    commands: dict[int, float] = {}
    seen = []
    for n in range(count):
        seen.append(axis.position)
        if abs(axis.position) > 1e6:
            seen += [1e6] * (count - len(seen))
            break
        commands[n] = controller(1.0, axis.position)
        for k, duration in pieces(plant, n):
            axis.advance(duration, commands.get(k, 0.0))
    return np.array(seen)


@pytest.mark.parametrize("plant", PLANTS[:3])
def test_the_law_in_time_is_its_transfer_function(plant: LoopPlant) -> None:
    """y/r = P·C_r/(1 + P·C), C_r without the derivative, which acts on the position alone."""
    gains = Pid(1.0, 0.5, 0.05)
    ts = plant.cycle
    reference = gains.gain * ct.tf([1 + ts / gains.integral_time, -1], [1, -1], ts)
    closed = ct.feedback(exact(plant), ct.ss(controller(gains, ts))) * ct.ss(reference)
    expected = ct.step_response(closed, np.arange(150) * ts).outputs
    np.testing.assert_allclose(linear_step(plant, gains, 150), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("gains", [GAINS[0], GAINS[2]])
def test_the_phase_margin_is_the_delay_that_makes_the_loop_swing(gains: Gains) -> None:
    """A loop with margin φ at ω swings without end when its dead time grows by φ/ω."""
    plant = LoopPlant(J, 2e-3, 0.002, 0.001)
    found = margins(plant, gains)
    assert found.phase is not None
    assert found.crossover is not None
    extra = np.radians(found.phase) / found.crossover
    for factor, grows in ((0.93, False), (1.07, True)):
        late = LoopPlant(J, 2e-3, 0.002 + factor * extra, 0.001)
        swing = np.abs(linear_step(late, gains, 3000) - 1)
        assert (swing[-600:].max() > swing[600:1200].max()) == grows


NO_FRICTION = Friction(0.0, 0.0, 0.0, 1e9, 1e-9)


def test_a_step_without_friction_is_the_linear_one() -> None:
    plant = LoopPlant(J, 2e-3, 0.0025, 0.001)
    gains = GAINS[0]
    moved = step(plant, gains, NO_FRICTION, 1.0, 100.0)
    expected = linear_step(plant, gains, 800)
    at = np.round(moved.time / plant.cycle).astype(int)
    np.testing.assert_allclose(moved.position, expected[at], atol=1e-6)
    assert moved.overshoot == pytest.approx(expected.max() - 1, abs=1e-3)


def test_friction_holds_an_axis_that_a_weak_loop_does_not_move() -> None:
    plant = LoopPlant(J, 2e-3, 0.002, 0.001)
    weak = Pid(0.05, np.inf)  # 0.05 N.m for the whole step of 1 rad: below the breakaway
    moved = step(plant, weak, Friction(0.1, 0.12, 0.0, 1.0, 1e-4), 1.0, 10.0)
    assert moved.error == -1.0
    assert moved.settling is None


def test_an_integral_part_and_stiction_hunt_about_the_goal() -> None:
    plant = LoopPlant(J, 2e-3, 0.002, 0.001)
    gains = Pid(2.0, 0.3, 0.05)
    hunting = step(plant, gains, Friction(0.1, 0.15, 0.0, 1.0, 1e-5), 0.1, 60.0)
    free = step(plant, gains, Friction(0.0, 0.0, 0.0, 1.0, 1e-5), 0.1, 60.0)
    assert hunting.hunting > 1e-4
    assert free.settling is not None
    assert np.ptp(free.position[-20:]) < 1e-4, "it only creeps: the integral part is slow"


def test_the_torque_stays_within_its_limit_and_the_integral_does_not_wind_up() -> None:
    controller = law(Pid(10.0, 0.1, 0.0), 0.001, 0.5, 0.0)
    torques = [controller(1.0, 0.0) for _ in range(5000)]
    assert max(torques) == 0.5
    assert controller(1.0, 1.2) < 0.5, "it lets go at once when the error turns"


def test_an_offset_is_held_from_the_beginning() -> None:
    plant = LoopPlant(J, 2e-3, 0.002, 0.001)
    moved = step(plant, Pid(2.0, 0.3, 0.05), Friction(0.0, 0.0, 0.2, 2.0, 1e-6), 0.1, 60.0)
    assert moved.position.min() > -1e-6, "the load does not pull it down"
    assert moved.error == pytest.approx(0.0, abs=2e-3)


def test_commands_come_late_by_the_dead_time() -> None:
    plant = LoopPlant(J, 0.0, 0.0035, 0.001)
    moved = step(plant, Pid(1.0, np.inf, 0.05), NO_FRICTION, 1.0, 100.0)
    # the command of the first sample acts from 3.5 ms on; before, nothing moves
    assert np.all(moved.position[moved.time <= 0.0035] == 0.0)
    assert moved.position[moved.time > 0.0045][0] > 0.0
    assert deque(moved.time).popleft() == 0.0


@pytest.mark.parametrize("period", [250e-6, 62.5e-6, 10e-6])
@pytest.mark.parametrize(
    ("gains", "margin", "sensitivity"),
    [(landau_voda_pi(176.8, 2.0), 36.87, 1.68), (landau_voda_pid(176.8, 2.0), 65.7, 1.04)],
)
def test_a_slow_loop_in_a_fast_drive_keeps_its_margins(
    period: float, gains: Gains, margin: float, sensitivity: float
) -> None:
    """B/J = 2 rad/s and no dead time.

    An integrator with one lag, whatever the drive's period is.
    """
    found = margins(LoopPlant(J, 2e-3, 0.0, period), gains)
    assert found.stable
    assert found.phase == pytest.approx(margin, abs=0.3)
    assert found.sensitivity == pytest.approx(sensitivity, abs=0.02)


def test_a_slow_loop_in_a_fast_drive_is_followed_to_its_end() -> None:
    gains = Pid(0.5, np.inf, 0.1)
    slow, fast = (
        step(LoopPlant(J, 2e-3, 0.0, period), gains, NO_FRICTION, 1.0, 20.0)
        for period in (1e-3, 1e-5)
    )
    assert fast.time[-1] == pytest.approx(slow.time[-1], rel=0.01)
    assert fast.settling == pytest.approx(slow.settling, rel=0.05)
