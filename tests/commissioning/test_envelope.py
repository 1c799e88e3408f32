"""The envelope: what trips it, and its stopping distance by hand."""

from __future__ import annotations

import pytest

from commissioning.envelope import Envelope, Watch
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context
from commissioning.experiments.stopping import Stopping, run_up
from drivers.sample import Sample, Status
from profiles.errors import EnvelopeTripped

OK = Status(enabled=True, fault=False, stopping=False, limit=False, word=0x27)


def sample(time: float, position: float, command: float = 0.0, torque: float = 0.0) -> Sample:
    return Sample(time, position, torque, command, time, OK, 0.0, 0)


def watch(at: float = 1.0, **changes: object) -> Watch:
    base = {"centre": 1.0, "travel": 0.5, "speed": 10.0, "torque": 0.8, "duration": 60.0}
    return Envelope(**{**base, **changes}).watch(at)


def test_stopping_distance_by_the_formula_with_numbers() -> None:
    # a = (0.4 - 0.1)/1e-3 = 300; t = 10 ms: v' = 5 + 3 = 8
    # (5 + 8)/2 * 0.01 + 8^2 * 1e-3 / (2 * 0.2) = 0.065 + 0.16
    stopping = Stopping(inertia=1e-3, friction=0.1, braking=0.2, reaction=0.01)
    assert stopping.distance(5.0, 0.4) == pytest.approx(0.225)


def test_the_stopping_distance_counts_towards_the_travel() -> None:
    stopping = Stopping(1e-3, 0.1, 0.2, 0.01)
    w = watch(stopping=stopping, relay_torque=0.4, travel=0.3)
    w.check(sample(0.00, 1.0))
    w.check(sample(0.01, 1.05))  # 5 rad/s: 0.05 + 0.225 < 0.3
    with pytest.raises(EnvelopeTripped, match=r"travel: the axis is \+0.1 rad"):
        w.check(sample(0.02, 1.10))  # 0.1 + 0.225 > 0.3


def test_the_first_motions_have_less_room() -> None:
    for instant, position, text in (
        (1.0, 1.31, r"beyond ±0.3 rad for the first motions \(60 % of 0.5\)"),
        (0.01, 1.04, r"above the limit of 3.5 rad/s for the first motions \(35 % of 10\)"),
    ):
        w = watch(cautious=True)
        w.check(sample(0.0, 1.0))
        with pytest.raises(EnvelopeTripped, match=text):
            w.check(sample(instant, position))


def test_moving_back_counts_from_the_other_end() -> None:
    w = watch(1.25, stopping=Stopping(1e-3, 0.1, 0.2, 0.01), relay_torque=0.4, travel=0.3)
    w.check(sample(0.00, 1.25))
    w.check(sample(0.01, 1.20))  # 5 rad/s inwards: stops 0.025 beyond the centre
    with pytest.raises(EnvelopeTripped, match="travel"):
        w.check(sample(0.02, 1.10))  # 10 rad/s inwards: 0.115 + 0.4225 − 0.1 > 0.3


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (sample(0.01, 1.2), "speed: 20 rad/s is above the limit of 10 rad/s"),
        (sample(1.0, 0.4), "travel"),
        (sample(61.0, 1.0), "duration: the experiments take longer than 60 s"),
    ],
)
def test_each_limit_trips_with_numbers_and_units(second: Sample, message: str) -> None:
    w = watch()
    w.check(sample(0.0, 1.0))
    with pytest.raises(EnvelopeTripped, match=message):
        w.check(second)


def test_an_axis_that_is_elsewhere_after_it_was_enabled_is_stopped() -> None:
    with pytest.raises(EnvelopeTripped, match=r"moved by \+0\.03 rad while the drive was enabled"):
        watch().check(sample(0.0, 1.03))  # more than 5 % of 0.5


def test_a_torque_command_above_the_limit_is_not_sent() -> None:
    w = watch()
    w.admit(0.8)
    with pytest.raises(EnvelopeTripped, match=r"0\.81 N\.m is above the limit of 0\.8 N\.m"):
        w.admit(0.81)
    with pytest.raises(EnvelopeTripped):
        w.admit(float("nan"))


def test_measured_torque_trips_when_it_stays_and_not_on_a_spike() -> None:
    w = watch()
    w.check(sample(0.0, 1.0, torque=5.0))
    w.check(sample(0.001, 1.0, torque=0.1))
    for n in range(2, 11):
        w.check(sample(n / 1000, 1.0, torque=5.0))
    with pytest.raises(EnvelopeTripped, match="measures a torque"):
        w.check(sample(0.011, 1.0, torque=5.0))


def test_the_thermal_budget_counts_what_is_above_the_rated_torque() -> None:
    w = watch(rated=0.5, thermal=0.1)
    # 0.8² − 0.5² = 0.39 (N.m)²: 0.1 is spent after 0.26 s
    for n in range(26):
        w.check(sample(n * 0.01, 1.0, command=0.8))
    with pytest.raises(EnvelopeTripped, match="i2t"):
        w.check(sample(0.27, 1.0, command=0.8))


@pytest.mark.parametrize(("offset", "way"), [(0.05, -1), (-0.05, +1), (0.0, +1)])
def test_the_stop_is_proved_the_way_in_which_the_load_moves_the_axis(
    offset: float, way: int
) -> None:
    known = FirstLook(0.1, offset, 0.1, 0.0, 1e-3, 0.004)
    context = Context(cycle=0.004, resolution=1e-4, start=1.0, travel=0.5, torque=0.8, speed=10.0)
    plan, time, commands = run_up(context, known), 0.0, []
    set_point = next(plan)
    for _ in range(40):  # the axis stands at its start
        time += 0.004
        commands.append(set_point)
        set_point = plan.send(sample(time, 1.0))
    pushes = [command - offset for command in commands if command != offset]
    assert pushes
    assert all(push * way > 0.1 for push in pushes)
