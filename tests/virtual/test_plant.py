"""The plant against an independent integration with events, and against itself."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.virtual.plant import Plant, PlantParameters

SCHEDULE = [0.05, 0.25, -0.3, 0.0, 0.31, -0.12, 0.08, -0.31, 0.2]


def integrate(
    p: PlantParameters, schedule: Sequence[float], hold: float, rtol: float
) -> list[tuple[float, float]]:
    """Position and velocity after each torque of the schedule: solve_ivp with velocity events.

    Written from the equations alone: at rest the axis stays while the net torque is below the
    breakaway level; else it moves, and each zero of the velocity ends a segment.
    """
    x, v, torque = 0.0, 0.0, 0.0
    found = []
    for command in schedule:
        t = 0.0
        while t < hold - 1e-13:
            lag = p.lag

            def motor(
                s: float, begin: float = t, start: float = torque, u: float = command
            ) -> float:
                return u if lag == 0 else u + (start - u) * exp(-(s - begin) / lag)

            if v == 0.0:
                up = p.load + p.breakaway * (1 + p.asymmetry)
                down = p.load - p.breakaway * (1 - p.asymmetry)

                def inside(s: float, _: object, m=motor, a=down, b=up) -> float:  # type: ignore[no-untyped-def]
                    return min(b - m(s), m(s) - a)

                if inside(t, None) >= 0:
                    inside.terminal, inside.direction = True, -1  # type: ignore[attr-defined]
                    rest = solve_ivp(
                        lambda s, y: [0.0], (t, hold), [0.0], events=inside, max_step=hold / 50,
                        rtol=rtol, atol=rtol,
                    )  # fmt: skip
                    if rest.t_events[0].size == 0:
                        torque = motor(hold)
                        t = hold
                        continue
                    torque, t = motor(rest.t_events[0][0]), rest.t_events[0][0]

                    def motor(
                        s: float, begin: float = t, start: float = torque, u: float = command
                    ) -> float:
                        return u if lag == 0 else u + (start - u) * exp(-(s - begin) / lag)

                direction = 1 if (motor(t + 1e-9) - p.load) > 0 else -1
            else:
                direction = 1 if v > 0 else -1
            friction = direction * p.coulomb * (1 + direction * p.asymmetry)

            def motion(s, y, m=motor, f=friction):  # type: ignore[no-untyped-def]
                return [y[1], (m(s) - p.load - f - p.viscous * y[1]) / p.inertia]

            def turned(s: float, y: Sequence[float]) -> float:
                return float(y[1])

            turned.terminal, turned.direction = True, -direction  # type: ignore[attr-defined]
            run = solve_ivp(
                motion, (t, hold), [x, v], events=turned, rtol=rtol, atol=rtol * 1e-3,
                max_step=hold / 20,
            )  # fmt: skip
            x, v = run.y[0][-1], run.y[1][-1]
            torque, t = motor(run.t[-1]), run.t[-1]
            if run.t_events[0].size:
                v = 0.0
        found.append((x, v))
    return found


def exact(p: PlantParameters, schedule: Sequence[float], hold: float, parts: int = 1) -> np.ndarray:
    plant = Plant(p)
    rows = []
    for command in schedule:
        for _ in range(parts):
            plant.advance(hold / parts, command)
        rows.append((plant.position, plant.velocity))
    return np.array(rows)


AXES = {
    "plain": PlantParameters(1e-3, 2e-3, 0.1, 0.1),
    "breakaway": PlantParameters(1e-3, 2e-3, 0.1, 0.13),
    "load and asymmetry": PlantParameters(1e-3, 2e-3, 0.1, 0.1, load=0.04, asymmetry=0.2),
    "no viscous friction": PlantParameters(1e-3, 0.0, 0.1, 0.11),
    "heavy viscous friction": PlantParameters(1e-3, 0.05, 0.1, 0.1),
    "torque lag": PlantParameters(1e-3, 2e-3, 0.1, 0.12, lag=3e-3),
}


@pytest.mark.parametrize("name", AXES)
def test_the_closed_form_is_what_solve_ivp_converges_to(name: str) -> None:
    p, hold = AXES[name], 0.017
    ours = exact(p, SCHEDULE, hold)
    errors = []
    for rtol in (1e-4, 1e-7, 1e-10):
        theirs = np.array(integrate(p, SCHEDULE, hold, rtol))
        errors.append(np.max(np.abs(ours - theirs) / np.maximum(np.abs(ours).max(axis=0), 1e-9)))
    assert errors[2] < 1e-7, errors
    assert errors[2] <= max(errors[0], 1e-12), errors


@pytest.mark.parametrize("seed", range(20))
def test_the_step_does_not_matter(seed: int) -> None:
    # random, not adversarial: at a torque of exactly the breakaway level either answer is right
    rng = np.random.default_rng(seed)
    for _ in range(15):
        p = PlantParameters(
            inertia=10 ** rng.uniform(-4, -1),
            viscous=rng.choice([0.0, rng.uniform(0, 0.5), 10 ** rng.uniform(-12, -1)]),
            coulomb=0.1,
            breakaway=rng.uniform(0.1, 0.2),
            load=rng.uniform(-0.3, 0.3),
            asymmetry=rng.uniform(-0.5, 0.5),
            lag=rng.choice([0.0, 2e-4, 1e-3, 5e-3]),
        )
        schedule = rng.uniform(-1, 1, rng.integers(1, 7)) * rng.choice([0, 1])
        coarse, fine = (
            exact(p, schedule, 0.02),
            exact(p, schedule, 0.02, int(rng.choice([2, 7, 50]))),
        )
        np.testing.assert_allclose(coarse, fine, rtol=1e-6, atol=1e-8)


def test_an_axis_within_its_breakaway_level_never_moves() -> None:
    plant = Plant(PlantParameters(1e-3, 2e-3, 0.1, 0.13, load=0.05))
    for torque in (0.0, 0.179, -0.079, 0.05):
        plant.advance(1.0, torque)
    assert (plant.position, plant.velocity) == (0.0, 0.0)


def test_coasting_distance_is_the_kinetic_energy_over_the_friction() -> None:
    plant = Plant(PlantParameters(2e-3, 0.0, 0.1, 0.1))
    plant.velocity = 5.0
    plant.advance(10.0, 0.0)
    assert plant.velocity == 0.0
    assert plant.position == pytest.approx(2e-3 * 5.0**2 / (2 * 0.1), rel=1e-12)


def test_constant_torque_ends_at_the_speed_that_viscous_friction_allows() -> None:
    plant = Plant(PlantParameters(1e-3, 0.02, 0.1, 0.1))
    plant.advance(5.0, 0.5)
    assert plant.velocity == pytest.approx((0.5 - 0.1) / 0.02, rel=1e-9)


def test_a_torque_lag_reaches_63_percent_after_its_time_constant() -> None:
    plant = Plant(PlantParameters(1e-3, 0.0, 0.1, 0.1, lag=4e-3))
    plant.advance(4e-3, 0.05)
    assert plant.torque == pytest.approx(0.05 * (1 - exp(-1)))


def test_a_closed_brake_holds_whatever_the_torque() -> None:
    plant = Plant(PlantParameters(1e-3, 0.0, 0.1, 0.1, load=0.5))
    plant.locked = True
    plant.advance(1.0, 3.0)
    assert (plant.position, plant.velocity) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inertia": 0.0}, "inertia"),
        ({"viscous": -1.0}, "viscous"),
        ({"breakaway": 0.05}, "breakaway"),
        ({"asymmetry": 1.0}, "asymmetry"),
    ],
)
def test_impossible_mechanics_are_refused(change: dict[str, float], message: str) -> None:
    base = {"inertia": 1e-3, "viscous": 0.0, "coulomb": 0.1, "breakaway": 0.1}
    with pytest.raises(ValueError, match=message):
        PlantParameters(**{**base, **change})


def test_an_axis_without_friction_that_is_exactly_balanced_stays_where_it_is() -> None:
    axis = Plant(PlantParameters(1e-3, 2e-3, 0.0, 0.0, load=0.2))
    axis.advance(0.001, 0.2)
    assert (axis.position, axis.velocity) == (0.0, 0.0)
    axis.advance(0.001, 0.21)
    assert axis.velocity > 0
