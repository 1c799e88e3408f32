"""The envelope: what trips it, and its stopping distance by hand."""

from __future__ import annotations

import pytest

from commissioning.envelope import Envelope, Watch
from commissioning.errors import EnvelopeTripped, FeedbackReversed
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context
from commissioning.experiments.stopping import Stopping, run_up
from drivers.sample import Sample, Status
from tests.raising import raises

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
    with raises(EnvelopeTripped, "limit.travel"):
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
    with raises(EnvelopeTripped, "limit.torque"):
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


# -- at the limits: numbers that are exact in binary, so that "at" and "beyond" are what they say -

TICK = 1 / 128  # s


def exact(**changes: object) -> Watch:
    base = {"centre": 0.0, "travel": 0.5, "speed": 8.0, "torque": 1.0, "duration": 64.0}
    return Envelope(**{**base, **changes}).watch(0.0)


def beyond(value: float) -> float:
    """A little further from zero."""
    return value * (1 + 2**-20)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_torque_limit_itself_may_be_commanded_and_no_more(sign: float) -> None:
    w = exact()
    w.admit(sign * (1 + 1e-9))
    with pytest.raises(EnvelopeTripped, match=r"is above the limit of 1 N\.m"):
        w.admit(sign * beyond(1.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_speed_limit_itself_is_no_trip(sign: float) -> None:
    w = exact()
    w.check(sample(0.0, 0.0))
    w.check(sample(TICK, sign * 8.0 * TICK))
    with pytest.raises(EnvelopeTripped, match="speed: 8 rad/s is above the limit of 8 rad/s"):
        w.check(sample(2 * TICK, sign * (8.0 * TICK + beyond(8.0) * TICK)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_end_of_the_travel_itself_is_no_trip(sign: float) -> None:
    w = exact()
    w.check(sample(0.0, 0.0))
    w.check(sample(1.0, sign * 0.5))
    w.check(sample(2.0, sign * 0.5))
    with raises(EnvelopeTripped, "limit.travel"):
        w.check(sample(3.0, sign * beyond(0.5)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_axis_that_rests_stops_within_what_the_torque_may_still_do(sign: float) -> None:
    """At rest the stopping distance counts outwards: c0 = a·t²/2 + (a·t)²·J/(2·b)."""
    # a = (0.3 - 0.1)/1e-3 = 200, t = 0.02: 0.04 + 16e-3/0.4 = 0.08
    stopping = Stopping(inertia=1e-3, friction=0.1, braking=0.2, reaction=0.02)
    assert stopping.distance(0.0, 0.3) == pytest.approx(0.08)
    w = exact(stopping=stopping, relay_torque=0.3)
    w.check(sample(0.0, 0.0))
    w.check(sample(1000.0 * TICK, sign * 0.415))
    w.check(sample(2000.0 * TICK, sign * 0.415))  # 0.415 + 0.08 < 0.5
    slowly = sample(9000.0 * TICK, sign * 0.4249)
    with pytest.raises(EnvelopeTripped, match=r"would stop within 0\.5049 rad, beyond ±0\.5 rad"):
        w.check(slowly)
    still = exact(stopping=stopping, relay_torque=0.3, travel=0.49)
    still.check(sample(0.0, 0.0))
    still.check(sample(0.0, sign * 0.415))
    with pytest.raises(EnvelopeTripped, match=r"at 0 rad/s and would stop within 0\.495 rad"):
        still.check(sample(1.0, sign * 0.415))


def test_two_samples_of_one_instant_are_no_speed() -> None:
    w = exact()
    w.check(sample(0.0, 0.0))
    w.check(sample(0.0, 0.25))
    w.check(sample(1.0, 0.25))
    with raises(EnvelopeTripped, "limit.speed"):
        w.check(sample(1.0 + TICK, 0.375))


def test_the_time_that_is_spent_counts_from_the_first_sample() -> None:
    w = exact(spent=32.0)
    w.check(sample(100.0, 0.0))
    w.check(sample(132.0, 0.0))
    with pytest.raises(EnvelopeTripped, match="duration: the experiments take longer than 64 s"):
        w.check(sample(132.0 + TICK, 0.0))
    all_of_it = exact()
    all_of_it.check(sample(0.0, 0.0))
    all_of_it.check(sample(64.0, 0.0))
    gone = exact(spent=65.0)
    gone.check(sample(0.0, 0.0))
    with raises(EnvelopeTripped, "limit.duration"):
        gone.check(sample(TICK, 0.0))


def test_heat_is_carried_over_and_the_budget_itself_is_no_trip() -> None:
    # 1.5² − 0.5² = 2 (N.m)²: a budget of 4 is spent after 2 s, of which 1 s was before
    w = exact(rated=0.5, thermal=4.0, heat=2.0, torque=2.0)
    w.check(sample(0.0, 0.0))
    w.check(sample(1.0, 0.0, command=1.5))
    with pytest.raises(EnvelopeTripped, match=r"i2t budget of 4 \(N.m\)2.s above 0.5 N.m"):
        w.check(sample(1.0 + TICK, 0.0, command=1.5))


def test_heat_goes_while_the_torque_is_low_and_never_below_none() -> None:
    w = exact(rated=1.5, thermal=1.0, torque=4.0)
    w.check(sample(0.0, 0.0))
    w.check(sample(10.0, 0.0, command=0.0))  # −22.5: none is left, and none is owed
    w.check(sample(10.5, 0.0, command=-2.0))  # (4 − 2.25)·0.5 = 0.875
    with pytest.raises(EnvelopeTripped, match="i2t"):
        w.check(sample(10.75, 0.0, command=2.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_measured_torque_trips_in_the_tenth_cycle_above_one_and_a_half_times_the_limit(
    sign: float,
) -> None:
    w = exact()
    limit = 1.5 * (1 + 1e-9)
    for n in range(20):
        w.check(sample(n * TICK, 0.0, torque=sign * limit))
    for n in range(20, 29):
        w.check(sample(n * TICK, 0.0, torque=sign * beyond(1.5)))
    with pytest.raises(
        EnvelopeTripped, match=r"measures a torque of -?1\.5 N\.m against a limit of 1 N\.m"
    ):
        w.check(sample(29 * TICK, 0.0, torque=sign * beyond(1.5)))


def test_nine_cycles_of_too_much_torque_are_none_too_many_from_the_first_sample_on() -> None:
    w = exact()
    for n in range(9):
        w.check(sample(n * TICK, 0.0, torque=2.0))
    w.check(sample(9 * TICK, 0.0, torque=0.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_twentieth_of_the_travel_itself_is_no_motion_while_the_drive_takes_over(
    sign: float,
) -> None:
    exact(travel=20.0).check(sample(0.0, sign * 1.0))
    with raises(EnvelopeTripped, "limit.jump"):
        exact(travel=20.0).check(sample(0.0, sign * beyond(1.0)))


def test_what_is_said_is_what_is_beyond_its_limit_and_not_what_is_at_it() -> None:
    at_travel = exact()
    at_travel.check(sample(0.0, 0.0))
    at_travel.check(sample(1.0, 0.375))
    with raises(EnvelopeTripped, "limit.speed"):
        at_travel.check(sample(1.0 + TICK, 0.5))
    at_speed = exact(rated=0.5, thermal=2.0, heat=2.0)
    at_speed.check(sample(0.0, 0.0))
    with pytest.raises(EnvelopeTripped, match="i2t"):
        at_speed.check(sample(TICK, 8.0 * TICK, command=1.0))
    at_heat = exact(duration=1.0, rated=0.5, thermal=1.5, torque=2.0)
    at_heat.check(sample(0.0, 0.0))
    with raises(EnvelopeTripped, "limit.duration"):
        at_heat.check(sample(2.0, 0.0, command=1.0))
    plain = exact()
    plain.check(sample(0.0, 0.0))
    with pytest.raises(EnvelopeTripped) as tripped:
        plain.check(sample(TICK, 0.25))
    assert "for the first motions" not in str(tripped.value)


# -- positions that are commanded -----------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_position_command_beyond_the_travel_is_not_sent(sign: float) -> None:
    w = exact(cycle=1.0, resolution=2**-10)
    w.admit_position(sign * 0.25)
    w.admit_position(sign * (0.5 + 2**-10))
    with pytest.raises(
        EnvelopeTripped, match=r"position command: [+-]0\.502 rad .* beyond ±0\.5 rad"
    ):
        w.admit_position(sign * (0.5 + 2**-9))


def test_a_position_command_that_is_no_number_is_not_sent() -> None:
    with raises(EnvelopeTripped, "limit.position-command"):
        exact().admit_position(float("nan"))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_of_the_position_command_is_no_more_than_the_speed_goes_in_a_cycle(
    sign: float,
) -> None:
    w = exact(cycle=TICK, resolution=0.0)  # 8 rad/s for 1/128 s
    w.admit_position(sign / 16)
    w.admit_position(sign / 8)
    with pytest.raises(EnvelopeTripped, match=r"a step of [+-]0\.0625 rad is more than 8 rad/s"):
        w.admit_position(sign * beyond(3 / 16))


# -- the position answers against the torque ------------------------------------------------------

LIGHT = Stopping(inertia=1e-3, friction=0.1, braking=0.2, reaction=0.01)


def seen(w: Watch, positions: list[float], command: float = 0.0) -> None:
    for n, position in enumerate(positions):
        w.check(sample(n * TICK, position, command))


def judged(**changes: object) -> Watch:
    """0.2 N.m and 0.1 N.m of friction on 1e-3 kg.m2.

    Six times 300 rad/s² is 14 rad/s in 1/128 s.
    """
    fixed = {"travel": 1e3, "speed": 1e3, "stopping": LIGHT, "relay_torque": 0.2}
    return exact(**{**fixed, **changes})


def test_a_speed_that_turns_within_a_cycle_is_the_encoder() -> None:
    there = [n * 8 * TICK for n in range(5)]
    with pytest.raises(FeedbackReversed, match=r"the speed turned to -8 rad/s within one cycle"):
        seen(judged(), [*there, there[3], there[2]])


@pytest.mark.parametrize(
    ("positions", "why"),
    [
        ([n * 8.0 * TICK for n in (0, 1, 2, 9, 4, 5, 6)], "one disturbed sample"),
        ([n * 8.0 * TICK for n in (0, 1, 2, -5, 4, 5, 6)], "the same, the other way"),
        ([n * 7.0 * TICK for n in (0, 1, 2, 1, 0, -1)], "the torque can do as much"),
        ([n * 8.0 * TICK for n in (0, 1, 2, 1, 1, 1)], "it hit something and stays"),
    ],
)
def test_no_other_change_of_speed_is(positions: list[float], why: str) -> None:
    seen(judged(), positions)


def test_counts_of_a_coarse_encoder_are_no_speeds() -> None:
    """Four counts of 1/16 rad a cycle are 32 rad/s, and so much may the speed seem to change."""
    seen(judged(resolution=1 / 16), [0.0, 1 / 16, 0.0, -1 / 16, -2 / 16])


def test_nothing_is_judged_before_the_inertia_is_known() -> None:
    there = [n * 8 * TICK for n in range(5)]
    seen(judged(stopping=None), [*there, there[3], there[2]])


def gaining(command: float, **changes: object) -> None:
    """From 1 rad/s by 256 rad/s² to beyond the speed limit of 8 rad/s,
    in 3.5 to 4 cycles of 1/128 s."""
    w, position = exact(travel=1e3, **changes), 0.0
    for n in range(12):
        w.check(sample(n * TICK, position, command))
        position += (1 + 2 * n) * TICK


def test_an_axis_that_gains_speed_against_its_torque_is_said_to() -> None:
    with pytest.raises(
        FeedbackReversed, match=r"gained speed against its torque for 31 ms, from 1 to"
    ):
        gaining(-0.1, bias=0.05)


@pytest.mark.parametrize(
    ("command", "bias"),
    [(0.1, 0.05), (-0.1, -0.2), (-0.1, float("nan"))],
    ids=["with its torque", "less than what holds the load", "nothing known"],
)
def test_any_other_that_is_too_fast_is_told_the_limit(command: float, bias: float) -> None:
    with pytest.raises(EnvelopeTripped, match="is above the limit of 8 rad/s") as caught:
        gaining(command, bias=bias)
    assert not isinstance(caught.value, FeedbackReversed)
