"""Motions of many axes at once against an integrator that knows nothing of events or series."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate

from commissioning.identification.trajectory import PARAMETERS, Lanes, Torque, positions

Array = NDArray[np.float64]

BENCH = {
    "inertia": 1e-3, "viscous": 2e-3, "coulomb": 0.1, "offset": 0.01, "delay": 3.3e-3, "lag": 3e-4,
    "drag": 0.0, "load": 0.0, "drift": 0.0, "spring": 0.0,
}  # fmt: skip
AXES: dict[str, dict[str, float]] = {
    "rigid": {},
    "lag": {"lag": 2e-3},
    "drag": {"drag": 1e-4},
    "load": {"load": 0.2},
    "drift": {"drift": 0.05},
    "spring": {"spring": 0.2},
    "a little unstable": {"spring": -0.03},
    "all of them": {"lag": 1e-3, "drag": 1e-5, "load": 0.1, "drift": 0.03, "spring": 0.1},
}
solve_ivp: Any = integrate.solve_ivp
BEGIN, MIDDLE, CENTRE = 0.06, 0.5, 0.2
TIMES = np.arange(BEGIN, 0.9, 1.7e-3)


def square(amplitude: float = 0.2, half: float = 0.05) -> Torque:
    time = np.arange(0, 1.2, half)
    sign = np.where(np.arange(len(time)) % 2 == 0, 1.0, -1.0)
    return Torque(time, amplitude * sign * np.where(time > 0.5, 1.5, 1.0) + 0.01)


def integrated(axis: Mapping[str, float], torque: Torque, position: float, speed: float) -> Array:
    """Positions at TIMES by DOP853 from event to event, tolerances of rounding."""
    j, b, f, offset, delay, lag, drag, load, drift, spring = (axis[name] for name in PARAMETERS)
    edges: Array = torque.time + delay - lag

    def command(at: float) -> float:
        return float(torque.value[max(int(np.searchsorted(edges, at, side="right")) - 1, 0)])

    def moves(t: float, y: Array, u: float, sign: float) -> list[float]:
        x, v, m = y
        level = f * (1 + drift * (t - MIDDLE)) + load * abs(m - offset)
        pushed = m - offset - spring * x - b * v - drag * v * abs(v) - sign * level
        return [v, pushed / j, (u - m) / lag]

    def reversal(t: float, y: Array, u: float, sign: float) -> float:
        return float(y[1])

    reversal.terminal = True  # type: ignore[attr-defined]
    m = float(torque.value[0])
    for at, until, value in zip(edges, edges[1:], torque.value, strict=False):
        if at < BEGIN:
            m = value + (m - value) * np.exp(-(min(until, BEGIN) - at) / lag)
    state, now, sign = np.array([position - CENTRE, speed, m]), BEGIN, float(np.sign(speed))
    found = np.full(len(TIMES), np.nan)
    stops: Array = np.append(edges[(edges > BEGIN) & (edges < TIMES[-1])], TIMES[-1])
    for stop in stops.tolist():
        while now < stop - 1e-15:
            reversal.direction = -sign  # type: ignore[attr-defined]
            run = solve_ivp(
                moves, (now, stop), state, "DOP853", rtol=1e-12, atol=1e-14, events=reversal,
                dense_output=True, max_step=5e-3, args=(command(now + 1e-13), sign),
            )  # fmt: skip
            inside = (now <= TIMES) & (run.t[-1] >= TIMES)
            found[inside] = run.sol(TIMES[inside])[0]
            now, state = float(run.t[-1]), run.y[:, -1].copy()
            if run.status == 1:
                sign = -sign
                state[1] = 1e-12 * sign
    return found + CENTRE


def lanes(*axes: Mapping[str, float], position: float = 0.3, speed: float = 5.0) -> Lanes:
    rows = np.array([[axis[name] for name in PARAMETERS] for axis in axes])
    count = len(rows)
    return Lanes(
        rows, np.full(count, BEGIN), np.full(count, position), np.full(count, speed), MIDDLE, CENTRE
    )


@pytest.mark.parametrize("kind", AXES)
def test_it_is_the_motion_of_the_equation(kind: str) -> None:
    axis = BENCH | AXES[kind]
    expected = integrated(axis, square(), 0.3, 5.0)
    found = positions(lanes(axis), square(), TIMES[None], 0.055)[0]
    assert np.ptp(expected) > 0.1
    assert found == pytest.approx(expected, abs=3e-8 if axis["drag"] else 2e-9)


def test_lanes_are_independent_and_steps_of_any_length_are_the_same() -> None:
    axes = [BENCH | options for options in AXES.values()]
    together = positions(lanes(*axes), square(), np.tile(TIMES, (len(axes), 1)), 0.055)
    for axis, row in zip(axes, together, strict=True):
        alone = positions(lanes(axis), square(), TIMES[None], 0.003)[0]
        assert row == pytest.approx(alone, abs=1e-7 if axis["drag"] else 1e-9)


def test_an_axis_that_its_friction_holds_stays_until_the_torque_exceeds_it() -> None:
    axis = BENCH | {"viscous": 0.0, "offset": 0.0, "lag": 1e-7, "delay": 1e-7}
    torque = Torque(np.array([0.0, 0.1]), np.array([0.09, 0.15]))
    held = lanes(axis, position=CENTRE, speed=0.0)
    times = np.array([[BEGIN, 0.08, 0.0999, 0.15, 0.2]])
    found = positions(held, torque, times, 0.05)[0] - CENTRE
    assert found[:3] == pytest.approx(0, abs=1e-12)
    pushed = (0.15 - 0.1) / 1e-3 / 2
    assert found[3:] == pytest.approx([pushed * 0.05**2, pushed * 0.1**2], rel=1e-4)


def test_a_thrown_axis_comes_to_rest_by_its_friction_and_stays() -> None:
    axis = BENCH | {"viscous": 0.0, "offset": 0.0}
    torque = Torque(np.array([0.0]), np.array([0.0]))
    times = np.array([[BEGIN, BEGIN + 0.05, BEGIN + 0.2, BEGIN + 0.7]])
    found = positions(lanes(axis, position=0.0, speed=5.0), torque, times, 0.5)[0]
    # v²/(2f/J) after v/(f/J) = 50 ms
    assert found[1:] == pytest.approx(0.125, abs=1e-9)
