"""The plants that are more than rigid: against solve_ivp, closed forms, and what the papers say."""

from __future__ import annotations

from math import exp, log, pi, sqrt, tanh
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.virtual.axes import AXES, configured
from drivers.virtual.compliant_plant import CompliantParameters, CompliantPlant
from drivers.virtual.friction import Dry, LuGre, Soft
from drivers.virtual.plant import Plant, PlantParameters
from profiles.errors import UsageError


def square(plant: Any, seconds: float, torque: float, period: float, step: float = 1e-3) -> None:
    for n in range(round(seconds / step)):
        plant.advance(step, torque if (n * step) % period < period / 2 else -torque)


@pytest.mark.parametrize(
    ("load", "asymmetry", "breakaway", "lag"),
    [(0, 0, 0.1, 0), (0.05, 0, 0.1, 0), (0, 0.2, 0.13, 0), (0, 0, 0.1, 1e-3)],
)
def test_coulomb_friction_is_that_of_the_closed_form(
    load: float, asymmetry: float, breakaway: float, lag: float
) -> None:
    exact = Plant(PlantParameters(1e-3, 2e-3, 0.1, breakaway, load, asymmetry, lag))
    stepped = CompliantPlant(
        CompliantParameters(1e-3, 2e-3, Dry(0.1, breakaway), load, asymmetry, lag=lag)
    )
    for plant in (exact, stepped):
        square(plant, 1.0, 0.3, 0.11)
    assert stepped.position == pytest.approx(exact.position, abs=2e-6)
    assert stepped.velocity == pytest.approx(exact.velocity, abs=2e-5)


def test_stribeck_friction_against_an_independent_integration() -> None:
    """From rest under a constant torque, then braked through zero.

    Solve_ivp with its own events.
    """
    j, b, fc, fs, vs = 2e-6, 3e-5, 2.6e-3, 3.1e-3, 3.5
    plant = CompliantPlant(CompliantParameters(j, b, Dry(fc, fs, vs)))
    plant.advance(0.02, 6e-3)
    plant.advance(0.02, -6e-3)

    def level(v: float) -> float:
        return fc + (fs - fc) * exp(-((v / vs) ** 2))

    def part(
        sign: int, torque: float, start: tuple[float, float], span: tuple[float, float]
    ) -> Any:
        def turned(_t: float, x: Any) -> float:
            return float(x[1])

        turned.terminal = True  # type: ignore[attr-defined]
        turned.direction = -sign  # type: ignore[attr-defined]
        return solve_ivp(
            lambda _t, x: (x[1], (torque - b * x[1] - sign * level(x[1])) / j),
            span, start, events=turned, rtol=1e-10, atol=1e-13,
        )  # fmt: skip

    up = part(1, 6e-3, (0.0, 0.0), (0.0, 0.02))
    down = part(1, -6e-3, tuple(up.y[:, -1]), (0.02, 0.04))
    back = part(-1, -6e-3, (down.y[0, -1], 0.0), (down.t[-1], 0.04))
    assert plant.position == pytest.approx(back.y[0, -1], rel=1e-4)
    assert plant.velocity == pytest.approx(back.y[1, -1], rel=1e-4)


def test_an_axis_that_barely_breaks_away_comes_to_rest_again() -> None:
    """The torque is above the breakaway level for a part of a step only.

    Behind a lag, on its way back.
    """
    p = CompliantParameters(2.2e-6, 3e-5, Dry(2.6e-3, 3.1e-3, 3.5), load=0.36e-3, lag=5e-4)
    plant = CompliantPlant(p)
    for n in range(400):
        plant.advance(2.5e-4, -2.9e-3 if n % 7 < 2 else -1.9e-3)
    assert abs(plant.position) < 1e-3
    assert plant.velocity == 0.0


def terminal_speed(plant: CompliantPlant, torque: float, seconds: float) -> float:
    for _ in range(round(seconds / 1e-3)):
        plant.advance(1e-3, torque)
    return plant.velocity


def test_soft_friction_creeps_at_any_torque_and_follows_its_sigmoid() -> None:
    """Gaz et al. 2019, joint 1: φ1/(1+e^(−φ2(v+φ3))) − φ1/(1+e^(−φ2·φ3))."""
    phi1, phi2, phi3 = 0.546, 5.1, 0.0395
    for torque in (0.05, 0.2, -0.15):
        plant = AXES["franka"].build()
        assert isinstance(plant, CompliantPlant)
        v = terminal_speed(plant, torque, 8.0)
        sigmoid = phi1 / (1 + exp(-phi2 * (v + phi3))) - phi1 / (1 + exp(-phi2 * phi3))
        assert sigmoid == pytest.approx(torque, rel=2e-3)


def test_friction_that_grows_with_the_torque() -> None:
    p = CompliantParameters(1e-3, 0.01, Dry(0.1, 0.1), load_friction=0.2)
    v = terminal_speed(CompliantPlant(p), 0.5, 2.0)
    assert v == pytest.approx((0.5 - 0.1 - 0.2 * 0.5) / 0.01, rel=1e-3)
    held = CompliantPlant(p)
    held.advance(1.0, 0.124)  # 0.1 + 0.2·0.124 = 0.1248: held
    assert held.position == 0.0


def test_the_resonance_is_that_of_two_masses_on_a_spring() -> None:
    """k = 6000 N.m/rad between 0.3594 and 0.1120 kg.m2: sqrt(k(1/J1 + 1/J2))."""
    axis = configured("tree", {"coulomb": "0", "load_coulomb": "0", "viscous": "0", "damping": "0"})
    plant = axis.build()
    assert isinstance(plant, CompliantPlant)
    plant.advance(1e-3, 30.0)
    values = []
    for _ in range(20_000):
        plant.advance(1e-4, 0.0)
        values.append(plant.deflection)
    rising = np.flatnonzero((np.array(values[:-1]) < 0) & (np.array(values[1:]) >= 0))
    period = (rising[-1] - rising[0]) * 1e-4 / (len(rising) - 1)
    stiff = sqrt(6000 * (1 / 0.3594 + 1 / 0.1120))
    assert 2 * pi / period == pytest.approx(stiff, rel=2e-3)


def test_backlash_is_lost_motion() -> None:
    """With the load held by its own friction the motor runs free for the play,
    then meets the spring."""
    p = CompliantParameters(
        2e-3, 0.0, Dry(0.0, 0.0), resonance=50.0, ratio=1.0, backlash=0.1, load_coulomb=1.0
    )
    plant = CompliantPlant(p)
    positions = []
    for torque in (0.05, -0.05):
        for _ in range(600):
            plant.advance(1e-3, torque)
            positions.append(plant.position)
    stiff = 0.5e-3 * (2 * pi * 50) ** 2  # the reduced inertia is half of 1e-3
    first, second = max(positions[:600]), min(positions[600:])
    assert 0.05 < first < 0.05 + 2 * (0.05 + sqrt(2 * 0.05 * 0.05 * stiff)) / stiff
    assert first - second > 0.1
    free = CompliantPlant(p)
    free.advance(0.02, 0.05)  # half of the play is 0.05 rad away: 0.05/1e-3·t²/2 = 0.01
    assert free.position == pytest.approx(0.05 / 1e-3 * 0.02**2 / 2, rel=1e-6)


def test_cogging_holds_the_axis_in_its_valleys() -> None:
    """Without friction: small oscillation about a valley with ω² = 2π·T/(λ·J)."""
    t, pitch, j = 0.05, 0.5, 1e-3
    p = CompliantParameters(j, 0.0, Dry(0.0, 0.0), cogging=t, pitch=pitch)
    plant = CompliantPlant(p, position=-pitch / 4 + 0.01)  # cos rises through zero at −λ/4
    positions = []
    for _ in range(4000):
        plant.advance(1e-3, 0.0)
        positions.append(plant.position + pitch / 4)
    y = np.array(positions)
    rising = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    period = (rising[-1] - rising[0]) * 1e-3 / (len(rising) - 1)
    assert 2 * pi / period == pytest.approx(sqrt(2 * pi * t / (pitch * j)), rel=5e-3)


# -- LuGre: Canudas de Wit, Olsson, Astrom, Lischinsky 1995, Table I ------------------------------

S0, S1, S2, FC, FS, VS = 1e5, sqrt(1e5), 0.4, 1.0, 1.5, 1e-3


def lugre() -> CompliantPlant:
    return CompliantPlant(CompliantParameters(1.0, S2, LuGre(FC, FS, VS, S0, S1)))


def test_lugre_is_a_spring_before_it_slides() -> None:
    """III.A: pre-sliding displacement.

    A force below Fs moves it by about F/σ0, and it springs back.
    """
    plant = lugre()
    for n in range(1000):
        plant.advance(1e-3, 0.9 * n / 1000)
    # dz/dx = 1 − σ0·z/Fs, so x = −Fs/σ0·ln(1 − F/Fs)
    assert plant.position == pytest.approx(-FS / S0 * log(1 - 0.9 / FS), rel=0.02)
    pushed = plant.position
    for n in range(1000):
        plant.advance(1e-3, 0.9 * (1 - n / 1000))
    assert 0 < plant.position < 0.7 * pushed, "hysteresis: it does not come back whole"


def test_lugre_slides_at_the_level_of_its_stribeck_curve() -> None:
    v = terminal_speed(lugre(), 1.02, 12.0)
    assert v == pytest.approx((1.02 - FC) / S2, rel=0.02)


def test_lugre_lags_behind_the_velocity() -> None:
    """III.B: at the same speed friction is larger while the speed rises than while it falls.

    On a heavy mass: its speed is nearly that of a sinusoidal force, and what is missing of its
    momentum is friction's.
    """
    mass, w, step = 1e3, 2 * pi * 10, 1e-4
    plant = CompliantPlant(CompliantParameters(mass, 0.0, LuGre(FC, FS, VS, S0, S1)))
    plant.advance(1e-3, mass * 2.0)  # 2 mm/s
    seen: dict[bool, list[float]] = {True: [], False: []}
    for n in range(4000):
        before, force = plant.velocity, mass * 1e-3 * w * np.cos(w * n * step) + 1.0
        plant.advance(step, force)
        friction = force - mass * (plant.velocity - before) / step
        if n > 2000 and abs(plant.velocity - 2e-3) < 1e-4:
            seen[bool(np.cos(w * n * step) > 0)].append(friction)
    assert len(seen[True]) > 50
    assert len(seen[False]) > 50
    assert np.mean(seen[True]) > np.mean(seen[False]) * 1.01


def test_lugre_sticks_and_slips_when_it_is_pulled_by_a_spring() -> None:
    """III.D: a spring of 2 N/m pulled at 0.1 m/s.

    It rests, then jumps, with a force up to about Fs.
    """
    plant = lugre()
    forces, speeds, step = [], [], 1e-3
    for n in range(30_000):
        force = 2.0 * (0.1 * n * step - plant.position)
        plant.advance(step, force)
        forces.append(force)
        speeds.append(plant.velocity)
    rests = np.abs(speeds) < 1e-3
    assert 0.2 < rests.mean() < 0.95
    assert np.count_nonzero(np.diff(rests.astype(int)) == 1) >= 2, (
        "it comes to rest again and again"
    )
    assert max(forces) == pytest.approx(FS, rel=0.1)
    assert max(speeds) > 0.15, "and is faster than its pull in between"


def test_lugre_breaks_away_later_when_the_force_rises_slowly() -> None:
    """III.C: the break-away force falls with the rate at which the force grows."""
    found = []
    for rate in (1.0, 10.0, 50.0):
        plant, force, step, most = lugre(), 0.0, 1e-4, 0.0
        while plant.velocity < 0.02:
            before = plant.velocity
            force += rate * step
            plant.advance(step, force)
            # what of the force does not accelerate the mass is friction
            most = max(most, force - (plant.velocity - before) / step - S2 * plant.velocity)
        found.append(most)
    assert found[0] == pytest.approx(FS, rel=0.05)
    assert found[0] > found[1] > found[2]


def test_a_position_filter_is_first_order() -> None:
    p = CompliantParameters(1e-3, 0.01, Dry(0.0, 0.0), output_filter=20.0)
    plant = CompliantPlant(p)
    v = terminal_speed(plant, 0.05, 3.0)
    before = plant.position
    plant.advance(1e-3, 0.05)
    true = CompliantPlant(CompliantParameters(1e-3, 0.01, Dry(0.0, 0.0)))
    for _ in range(3000):
        true.advance(1e-3, 0.05)
    assert plant.position - before == pytest.approx(v * 1e-3, rel=1e-3)
    assert true.position - before == pytest.approx(v / 20, rel=1e-3), "it lags by 1/20 s"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"soft": "0.1", "lugre": "100"}, "exclude each other"),
        ({"backlash": "0.1"}, "give resonance too"),
        ({"breakaway": "0.05"}, "must be at least coulomb"),
        ({"jitter": "2"}, "must be 0…1"),
        ({"pitch": "0"}, "must be 1e-06…"),
        ({"inertia": "0"}, "must be 1e-09…"),
        ({"resonance": "20", "ratio": "-1"}, "must be 0.001…"),
        ({"lugre": "1000", "coulomb": "0", "breakaway": "0"}, "needs coulomb > 0"),
    ],
)
def test_options_that_make_no_axis_are_refused(options: dict[str, str], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        configured("bench", options)


def test_soft_friction_has_no_value_at_rest() -> None:
    """F(0) = 0 with any shift; far from rest it is Fc·(1 − tanh(v₃/w)) one way."""
    p = CompliantParameters(1e-3, 0.0, Soft(1.0, 0.5, 0.1))
    still = CompliantPlant(p)
    still.advance(0.1, 0.0)
    assert (still.position, still.velocity) == (0.0, 0.0)
    fast = CompliantPlant(p)
    fast.advance(0.1, 1.5)  # 50 rad/s and more
    before = fast.velocity
    fast.advance(0.01, 1.5)
    assert 1.5 - 1e-3 * (fast.velocity - before) / 0.01 == pytest.approx(1 - tanh(0.2), rel=1e-3)
