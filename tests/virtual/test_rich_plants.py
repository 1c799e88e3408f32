"""Every kind of axis against an integration of its own equations, written anew here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import cos, exp, pi, sin
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.virtual import compliant_plant
from drivers.virtual.axes import VirtualAxis, configured
from drivers.virtual.compliant_plant import CompliantPlant, accelerate
from drivers.virtual.electronics import Electronics, Imperfections
from drivers.virtual.plant import Plant, PlantParameters
from profiles.errors import UsageError

J, B, F, D, HALF = 1e-3, 2e-3, 0.1, 0.35, 0.04
SWITCHINGS = 6

# torque against the motion in one direction, and the one that goes with the position
Friction = Callable[[float, float, float, int, float], float]  # t, x, v, direction, torque
Pull = Callable[[float], float]


def axis(**options: object) -> VirtualAxis:
    return configured("bench", {key: str(value) for key, value in options.items()})


def square(plant: Any, step: float = 2e-3) -> list[tuple[float, float]]:
    """Position and velocity at the end of each half period of a square wave."""
    found = []
    for n in range(SWITCHINGS):
        for _ in range(round(HALF / step)):
            plant.advance(step, D if n % 2 == 0 else -D)
        found.append((plant.position, plant.velocity))
    return found


def integrated(
    friction: Friction,
    pull: Pull = lambda x: 0.0,
    shaft: Callable[[float, float], float] = lambda u, x: u,
) -> list[tuple[float, float]]:
    """solve_ivp from one reversal to the next; the torque is large enough that none is a rest."""
    x, v, found = 0.0, 0.0, []
    for n in range(SWITCHINGS):
        u, t, end = D if n % 2 == 0 else -D, n * HALF, (n + 1) * HALF
        while t < end - 1e-12:
            way = (1 if v > 0 else -1) if abs(v) > 1e-12 else (1 if u > 0 else -1)

            def moves(t: float, s: Any, way: int = way, u: float = u) -> tuple[float, float]:
                torque = shaft(u, s[0])
                resists = way * friction(t, s[0], abs(s[1]), way, torque)
                return s[1], (torque - B * s[1] - resists - pull(s[0])) / J

            def turns(t: float, s: Any, way: int = way) -> float:
                return float(s[1]) * way

            turns.terminal, turns.direction = True, -1  # type: ignore[attr-defined]
            part = solve_ivp(
                moves, (t, end), (x, v), events=turns, rtol=1e-10, atol=1e-13, max_step=2e-3
            )
            t, x, v = part.t[-1], part.y[0, -1], part.y[1, -1]
            v = 0.0 if part.status == 1 else v
        found.append((x, v))
    return found


def level(*_: float) -> float:
    return F


DRY: dict[str, tuple[dict[str, float], Friction, Pull]] = {
    "drag": ({"drag": 2e-4}, lambda t, x, v, w, u: F + 2e-4 * v * v, lambda x: 0.0),
    "drift": ({"drift": 0.1}, lambda t, x, v, w, u: F * (1 + 0.1 * t), lambda x: 0.0),
    "slope": ({"position_slope": 0.5}, lambda t, x, v, w, u: F * (1 + 0.5 * x), lambda x: 0.0),
    "wave": (
        {"position_wave": 0.4, "position_pitch": 0.3},
        lambda t, x, v, w, u: F * (1 + 0.4 * sin(2 * pi * x / 0.3)),
        lambda x: 0.0,
    ),
    "spring": ({"spring": 0.2}, level, lambda x: 0.2 * x),
    "gravity": (
        {"gravity": 0.1, "gravity_angle": 0.7, "load": 0.02},
        level,
        lambda x: 0.02 + 0.1 * cos(x + 0.7),
    ),
    "two cogging waves": (
        {"cogging": 0.03, "pitch": 0.1, "cogging_2": 0.02, "pitch_2": 0.05, "angle_2": 1.0},
        level,
        lambda x: 0.03 * cos(2 * pi * x / 0.1) + 0.02 * cos(2 * pi * x / 0.05 + 1.0),
    ),
    "stribeck, exponent 1": (
        {"breakaway": 0.15, "stribeck": 1.5, "stribeck_exponent": 1},
        lambda t, x, v, w, u: F + 0.05 * exp(-v / 1.5),
        lambda x: 0.0,
    ),
    "stribeck, exponent 2": (
        {"breakaway": 0.16, "stribeck": 2.5},
        lambda t, x, v, w, u: F + 0.06 * exp(-((v / 2.5) ** 2)),
        lambda x: 0.0,
    ),
    "direction and load": (
        {"asymmetry": 0.2, "load_friction": 0.15, "load": 0.03},
        lambda t, x, v, w, u: F * (1 + 0.2 * w) + 0.15 * abs(u - 0.03),
        lambda x: 0.03,
    ),
}


@pytest.mark.parametrize("kind", DRY)
def test_a_dry_axis_moves_as_its_equation_says(kind: str) -> None:
    options, friction, pull = DRY[kind]
    plant = axis(**options).build()
    assert isinstance(plant, CompliantPlant)
    np.testing.assert_allclose(square(plant), integrated(friction, pull), rtol=2e-5, atol=2e-5)


def test_a_stribeck_curve_with_a_cusp_moves_as_its_equation_says() -> None:
    """Exponent ½: infinitely steep at rest, and the two integrations differ by what that makes."""
    plant = axis(breakaway=0.15, stribeck=2.0, stribeck_exponent=0.5).build()
    expected = integrated(lambda t, x, v, w, u: F + 0.05 * exp(-((v / 2.0) ** 0.5)))
    np.testing.assert_allclose(square(plant), expected, rtol=1e-3, atol=1e-3)


def test_a_torque_that_ripples_with_the_position() -> None:
    plant = axis(torque_gain=0.9, torque_ripple=0.08, ripple_waves=20).build()
    expected = integrated(level, shaft=lambda u, x: 0.9 * u * (1 + 0.08 * sin(20 * x)))
    np.testing.assert_allclose(square(plant), expected, rtol=2e-5, atol=2e-5)
    assert isinstance(plant, CompliantPlant)
    assert plant.torque == -D
    assert plant.shaft_torque == pytest.approx(
        -0.9 * D * (1 + 0.08 * sin(20 * plant.position)), rel=1e-12
    )


def test_dahls_bristles_against_an_implicit_integration() -> None:
    z0, x = 0.01, np.zeros(3)
    expected = []
    for n in range(SWITCHINGS):
        u = D if n % 2 == 0 else -D

        def moves(_t: float, s: Any, u: float = u) -> tuple[float, float, float]:
            return s[1], (u - B * s[1] - F * s[2]) / J, s[1] * (1 - s[2] * np.sign(s[1])) / z0

        x = solve_ivp(moves, (0, HALF), x, method="Radau", rtol=1e-9, atol=1e-11).y[:, -1]
        expected.append((x[0], x[1]))
    np.testing.assert_allclose(square(axis(dahl=z0).build()), expected, rtol=2e-4, atol=2e-4)


def elements(reach: float, attraction: float, fs: float, vs: float) -> list[tuple[float, float]]:
    """Six elements in tiny steps of equal length: the plain definition."""
    part, reaches = F / 6, reach * (np.arange(1, 7) / 6) ** 1.5
    stiff, force, slips = part / reaches, np.zeros(6), np.zeros(6, bool)
    x, v, step, found, way = 0.0, 0.0, 2e-6, [], 1
    for n in range(SWITCHINGS):
        u = D if n % 2 == 0 else -D
        for _ in range(round(HALF / step)):
            g = F + (fs - F) * exp(-((v / vs) ** 2)) if vs else F
            if v * way < 0:
                way, slips = -way, np.zeros(6, bool)
            v += step * (u - B * v - force.sum()) / J
            x += step * v
            stuck = np.clip(force + stiff * v * step, -part * g / F, part * g / F)
            if attraction:
                slipping = force + step * attraction * (way / 6 - force / g)
                reached = (np.abs(stuck) >= part * g / F) & (stuck * way > 0)
                force, slips = np.where(slips, slipping, stuck), slips | reached
            else:
                force = stuck
        found.append((x, v))
    return found


def test_maxwells_elements_against_tiny_steps() -> None:
    found = square(axis(maxwell=0.02).build())
    np.testing.assert_allclose(found, elements(0.02, 0.0, F, 0.0), rtol=1e-3, atol=1e-3)


def test_maxwells_elements_follow_masings_rule() -> None:
    """Torque against deflection on the way back is the virgin curve, twice as large (Masing 1926).

    At rest between slow pushes: J·a and B·v are nothing.
    """

    def settled(plant: Any, torque: float) -> float:
        for _ in range(400):
            plant.advance(1e-3, torque)
        return float(plant.position)

    plant = axis(maxwell=0.02, inertia=1e-5, viscous=0.02).build()
    virgin, back, again = settled(plant, 0.04), settled(plant, -0.04), settled(plant, 0.04)
    assert back == pytest.approx(-virgin, rel=2e-3)
    assert again == pytest.approx(virgin, rel=2e-3)
    assert 0 < settled(plant, 0.0) < virgin, "and keeps a part of its way"
    first = 0.02 * (1 / 6) ** 1.5  # where the first element slips; until then it is a spring
    stiff = sum((i / 6) ** -1.5 for i in range(1, 7)) * F / 6 / 0.02
    fresh = axis(maxwell=0.02, inertia=1e-5, viscous=0.02).build()
    assert settled(fresh, 0.9 * stiff * first) == pytest.approx(0.9 * first, rel=1e-3)


def test_gms_elements_against_tiny_steps() -> None:
    found = square(axis(maxwell=0.02, gms=30.0, breakaway=0.13, stribeck=2.0).build())
    np.testing.assert_allclose(found, elements(0.02, 30.0, 0.13, 2.0), rtol=3e-3, atol=3e-3)


# -- compiled --------------------------------------------------------------------------------


@pytest.fixture
def compiled() -> Iterator[None]:
    assert accelerate()
    try:
        yield
    finally:
        compliant_plant._COMPILED.clear()


KINDS: dict[str, dict[str, float]] = {
    "stribeck, lag": {"breakaway": 0.15, "stribeck": 2.0, "lag": 5e-4},
    "soft": {"soft": 0.5},
    "lugre": {"lugre": 50.0, "lugre_damping": 0.1, "stribeck": 1.0, "breakaway": 0.12},
    "gms": {"maxwell": 0.02, "gms": 30.0, "breakaway": 0.13, "stribeck": 2.0},
    "play": {"resonance": 15.0, "ratio": 0.5, "backlash": 0.02, "load_coulomb": 0.02},
    "all": {
        "drag": 1e-4, "drift": 0.05, "cogging": 0.01, "gravity": 0.03, "torque_ripple": 0.05,
        "position_wave": 0.1, "asymmetry": 0.1, "load_friction": 0.05, "output_filter": 50.0,
    },
}  # fmt: skip


def test_the_compiled_integration_is_the_same_motion(compiled: None) -> None:
    for name, options in KINDS.items():
        with_numba = axis(**options).build()
        before = compliant_plant._COMPILED[:]
        compliant_plant._COMPILED.clear()
        plain = axis(**options).build()
        compliant_plant._COMPILED.extend(before)
        np.testing.assert_allclose(
            square(with_numba), square(plain), rtol=1e-9, atol=1e-9, err_msg=name
        )


# -- electronics -----------------------------------------------------------------------------


def rigid() -> Plant:
    return Plant(PlantParameters(J, B, F, F))


def test_a_clipped_torque_moves_the_axis_as_the_smaller_torque_does() -> None:
    drive, plain = Electronics(rigid(), Imperfections(clip=0.2)), rigid()
    for _ in range(50):
        drive.advance(1e-3, 0.5)
        plain.advance(1e-3, 0.2)
    assert drive.position == plain.position
    assert drive.torque == 0.5, "and says nothing of it"
    seen = Electronics(rigid(), Imperfections(clip=0.2, shows_shaft=True))
    seen.advance(1e-3, 0.5)
    assert seen.torque == 0.2


def test_torque_noise_is_a_random_walk_of_the_speed() -> None:
    """Var v(t) = σ²·h·t/J² for a white torque held for h, without friction."""
    speeds = []
    for seed in range(400):
        drive = Electronics(
            Plant(PlantParameters(J, 0.0, 0.0, 0.0)), Imperfections(torque_noise=0.05, seed=seed)
        )
        drive.advance(0.05, 0.0)
        speeds.append(drive.velocity)
    expected = 0.05 * (250e-6 * 0.05) ** 0.5 / J
    assert np.std(speeds) == pytest.approx(expected, rel=0.12)  # 400 draws: ±3.5 %
    assert abs(np.mean(speeds)) < 4 * expected / 20


def test_position_noise_is_white_and_of_its_size() -> None:
    drive = Electronics(rigid(), Imperfections(noise=1e-3, seed=4))
    found = []
    for _ in range(4000):
        drive.advance(1e-3, 0.0)
        found.append(drive.position)
        assert drive.position == found[-1], "one position, however often it is read"
    y = np.array(found)
    assert y.std() == pytest.approx(1e-3, rel=0.05)
    assert abs(np.corrcoef(y[1:], y[:-1])[0, 1]) < 0.06


def test_an_eccentric_encoder() -> None:
    drive, plain = Electronics(rigid(), Imperfections(eccentricity=0.02)), rigid()
    for _ in range(300):
        drive.advance(1e-3, 0.4)
        plain.advance(1e-3, 0.4)
        x = plain.position
        assert drive.position == pytest.approx(x + 0.02 * sin(x), abs=1e-12)


def test_a_drive_with_its_own_tick_acts_and_latches_at_it() -> None:
    """Asynchronous: a command waits for half a tick in the mean, a position is as old."""
    waits, ages = [], []
    for seed in range(300):
        drive = Electronics(
            Plant(PlantParameters(J, 0.0, 0.0, 0.0)), Imperfections(tick=4e-3, seed=seed)
        )
        drive.advance(0.05, 0.4)  # v = 400·(t − wait)
        waits.append(0.05 - drive.velocity / 400)
        moved = (2 * drive.position / 400) ** 0.5
        ages.append(drive.velocity / 400 - moved)
    assert 0 <= min(waits) < max(waits) <= 4e-3 + 1e-9
    assert np.mean(waits) == pytest.approx(2e-3, abs=3e-4)
    assert 0 <= min(ages) < max(ages) <= 4e-3 + 1e-9
    assert np.mean(ages) == pytest.approx(2e-3, abs=3e-4)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dahl": "0.1", "maxwell": "0.1"}, "dahl and maxwell exclude each other"),
        ({"dahl": "0.1", "stribeck": "1"}, "stribeck and dahl exclude each other"),
        ({"gms": "10"}, "gms needs maxwell"),
        ({"maxwell": "0.1", "coulomb": "0", "breakaway": "0"}, "needs coulomb > 0"),
        ({"tick": "-1"}, "tick is -1: must be 0…1"),
    ],
)
def test_options_that_make_no_axis_are_refused(options: dict[str, str], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        configured("bench", options)


def test_an_axis_of_older_versions_stays_the_same_drive() -> None:
    assert configured("bench", {}).serial == 2906337711
    assert configured("bench", {"jitter": "0.1"}).serial == 910744443
    assert configured("bench", {"drag": "0.1"}).serial != configured("bench", {}).serial
