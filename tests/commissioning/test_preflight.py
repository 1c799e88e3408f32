"""Before energy: what is refused, which limits hold, and how the drive's watchdog is proved."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from commissioning.desk import Options
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.records import RunContext
from commissioning.rig import preflight
from commissioning.rig.preflight import Limits, choose_limits, look, prove_watchdog, writes
from commissioning.settings import Settings
from drivers.drive import DriveSays, Value
from drivers.errors import DriveFault, LinkError, PreflightRefused
from drivers.link import axis_of, open_drive
from drivers.modbus.bus import ModbusBus
from drivers.profiled import ProfiledDrive
from drivers.sample import Sample
from drivers.twinned import Twinned, open_twin
from profiles.axis import Axis, AxisLimits
from profiles.errors import UsageError
from profiles.library import load_profile, read_profile
from profiles.procedures import Mode
from profiles.schema import Profile
from tests.raising import raises

AXIS = axis_of("virtual://bench")
EVERYTHING = Path(__file__).parents[1] / "performance" / "everything.toml"
COUNT = 6.283185307179586 / 131072  # rad


@pytest.fixture
def drive() -> Iterator[ProfiledDrive]:
    opened = open_drive(AXIS, cycle=0.002)
    yield opened
    opened.close()


def changed(drive: ProfiledDrive, **update: object) -> Profile:
    """The same drive, as a profile that is other in this describes it."""
    profile, cycle = drive.profile.model_copy(update=update), drive.cycle
    drive.__init__(drive._bus, profile, AXIS, drive.link)  # type: ignore[misc]
    drive.cycle = cycle
    return profile


def says(drive: ProfiledDrive, **what: bool) -> Callable[[], DriveSays]:
    """What it says, other in this."""
    said = drive.state()._replace(**what)
    return lambda: said


# -- a look that writes nothing -------------------------------------------------------------------


def test_a_drive_that_is_fit_is_let_through(drive: ProfiledDrive) -> None:
    look(drive, AXIS)


def test_a_drive_in_fault_or_with_energy_or_without_torque_mode_is_refused(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(drive, "state", says(drive, in_fault=True))
        with raises(PreflightRefused, "preflight.fault"):
            look(drive, AXIS)
    with monkeypatch.context() as patch:
        patch.setattr(drive, "state", says(drive, is_energised=True))
        with pytest.raises(PreflightRefused, match="already enabled"):
            look(drive, AXIS)
    changed(drive, modes={})
    with raises(PreflightRefused, "mode.no-torque"):
        look(drive, AXIS)


def test_a_cycle_must_fit_into_the_watchdog_three_times(drive: ProfiledDrive) -> None:
    drive.cycle = 0.05 / 3
    look(drive, AXIS)
    drive.cycle = 0.0167
    with pytest.raises(PreflightRefused, match=r"a cycle of 16\.7 ms is too slow .* of 50 ms"):
        look(drive, AXIS)
    without = drive.profile.watchdog.model_copy(update={"kind": "none"})
    changed(drive, watchdog=without)
    look(drive, AXIS)


def everything() -> Twinned:
    """A drive with limits of each direction."""
    return open_twin(read_profile(str(EVERYTHING)), Axis(name="x", travel=3.0))


def test_each_direction_has_its_limit_and_the_lower_one_counts() -> None:
    """The twin's are 3 N.m up and down, the latter counted below zero, and 2865 rpm."""
    drive = everything().drive
    limits = choose_limits(drive, AXIS, Options(travel=3.0, max_torque=0.5, max_speed=20.0))
    set_ = writes(drive, limits)
    assert (set_["torque_up"], set_["torque_down"]) == (500, -500)
    assert set_["speed_up"] == set_["speed_down"] > 0
    drive.write("torque_down", -400)
    with raises(PreflightRefused, "preflight.torque"):  # 0.5 N.m is above 0.4 N.m
        choose_limits(drive, AXIS, Options(travel=3.0, max_torque=0.5, max_speed=20.0))
    assert choose_limits(drive, AXIS, Options(travel=3.0, max_speed=20.0)).torque == 0.4


@pytest.mark.parametrize(
    ("range_", "there", "wanted"),
    [
        # by the sign of what is there, whatever the range says; never above what it had
        ((-4000, 4000), -300, -300), ((-4000, 4000), -3000, -500), ((-4000, 4000), 300, 300),
        ((-4000, 0), -300, -300), ((-4000, 0), 0, -500), ((0, 4000), 0, 500),
    ],
)  # fmt: skip
def test_a_limit_of_the_negative_direction_keeps_its_sign_and_its_size(
    range_: tuple[int, int], there: int, wanted: int
) -> None:
    drive = everything().drive
    name = "torque_down"
    parameter = drive.parameters[name].parameter.model_copy(
        update={"minimum": range_[0], "maximum": range_[1]}
    )
    drive.parameters[name] = replace(drive.parameters[name], parameter=parameter)
    assert preflight._limited(drive, name, 0.5, there) == wanted


def test_a_drive_that_swaps_words_for_this_computer_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Lexium 32: registers 17568, 17570, 17572, 17574 hold the address of that master."""
    twinned = open_twin(load_profile("lexium-32-modbus"), Axis(name="x", travel=3.0, encoder=16384))
    drive, names = twinned.drive, [f"swapped_for_{n}" for n in (1, 2, 3, 4)]
    monkeypatch.setattr(ModbusBus, "own_address", lambda self: "192.168.1.20")
    drive.preparation.check_requirements()
    for values, refused in (
        ((192, 168, 1, 20), True), ((192, 168, 1, 21), False),
        (tuple(n << 16 for n in (192, 168, 1, 20)), True),  # it has swapped these already
    ):  # fmt: skip
        twinned.witness.forced |= dict(zip(names, values, strict=True))
        if refused:
            with raises(PreflightRefused, "preflight.word-order"):
                drive.preparation.check_requirements()
        else:
            drive.preparation.check_requirements()


def test_another_master_is_named(drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive.line, "other_master", lambda: "a frame with COB-ID 205h")
    with pytest.raises(PreflightRefused, match=r"another master .* COB-ID 205h was heard"):
        look(drive, AXIS)


def test_a_compensation_that_acts_in_torque_mode_must_be_zero(drive: ProfiledDrive) -> None:
    law = drive.profile.compensation
    changed(drive, compensation=law.model_copy(update={"acts_in": (Mode.TORQUE, Mode.POSITION)}))
    look(drive, AXIS)
    drive.write("coulomb_positive", 1)
    with raises(PreflightRefused, "preflight.compensation"):
        look(drive, AXIS)
    changed(drive, compensation=law)
    look(drive, AXIS)


def moving(drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch, steps: list[int]) -> list[float]:
    """The axis is so many counts further at each second reading of its position.

    Returns the waits.
    """
    position, waits = [0.0], []
    monkeypatch.setattr(drive, "read", lambda name: Value(0, position[0]))

    def wait(seconds: float) -> None:
        waits.append(seconds)
        position[0] += COUNT * (steps.pop(0) if len(steps) > 1 else steps[0])

    monkeypatch.setattr(drive, "wait", wait)
    return waits


@pytest.mark.parametrize(
    ("steps", "waits", "counts"),
    [([3], 1, 0), ([-3], 1, 0), ([4, 4, 2], 3, 0), ([4], 20, 4), ([-5], 20, 5)],
)
def test_an_axis_is_at_rest_within_three_counts_in_one_of_twenty_looks(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch, steps: list[int], waits: int, counts: int
) -> None:
    done = moving(drive, monkeypatch, steps)
    assert preflight.still_moving(drive) == pytest.approx(counts * COUNT, rel=1e-6, abs=1e-12)
    assert done == [0.05] * waits


def test_an_axis_that_moves_by_itself_is_refused(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(preflight, "still_moving", lambda drive: 0.25)
    with pytest.raises(PreflightRefused, match=r"moves by itself: 0\.25 rad in 0\.05 s"):
        look(drive, AXIS)


# -- limits ---------------------------------------------------------------------------------------


def test_limits_are_the_user_s_else_the_axis_else_the_drive_s(drive: ProfiledDrive) -> None:
    free = AXIS.model_copy(update={"travel": None, "limits": AxisLimits()})
    with pytest.raises(UsageError, match="how far may the axis move"):
        choose_limits(drive, free, Options())
    mine = free.model_copy(
        update={"travel": 2.0, "limits": AxisLimits(torque=0.5, speed=20.0, duration=30.0)}
    )
    found = choose_limits(drive, mine, Options())
    assert (found.travel, found.torque, found.speed, found.duration) == (2.0, 0.5, 20.0, 30.0)
    asked = Options(travel=1.0, max_torque=0.25, max_speed=10.0, duration=15.0)
    found = choose_limits(drive, mine, asked)
    assert (found.travel, found.torque, found.speed, found.duration) == (1.0, 0.25, 10.0, 15.0)
    own = choose_limits(drive, free, Options(travel=1.0))
    assert own.torque == own.rated == pytest.approx(1.0), "the smaller of rated and allowed torque"
    assert own.speed == pytest.approx(drive.read("max_speed").si)
    fast = choose_limits(drive, free, Options(travel=1.0, max_speed=1e6))
    assert fast.speed == own.speed, "never more than the drive allows itself"


def test_a_travel_of_five_hundred_counts_is_the_least(drive: ProfiledDrive) -> None:
    choose_limits(drive, AXIS, Options(travel=500 * COUNT))
    with pytest.raises(PreflightRefused, match="it is 499 encoder counts"):
        choose_limits(drive, AXIS, Options(travel=499 * COUNT))


def test_a_torque_above_the_drive_s_own_limit_is_refused(drive: ProfiledDrive) -> None:
    most = drive.read("max_torque").si
    assert choose_limits(drive, AXIS, Options(max_torque=most)).torque == most
    with pytest.raises(PreflightRefused, match=r"max torque of 3\.1 N\.m is above .* of 3 N\.m"):
        choose_limits(drive, AXIS, Options(max_torque=3.1))
    drive.write("max_torque", 0)
    with pytest.raises(PreflightRefused, match=r"own torque limit \('max_torque'\) reads 0 N\.m"):
        choose_limits(drive, AXIS, Options())
    # 0 is how some say "none": who says how much is taken at their word, and it is written
    limits = choose_limits(drive, AXIS, Options(max_torque=0.5))
    assert limits.torque == 0.5
    assert writes(drive, limits)["max_torque"] == 500  # per mille of 1 N.m


def test_a_drive_without_a_speed_limit_wants_one_from_the_user(drive: ProfiledDrive) -> None:
    drive.write("max_speed", 0)
    with pytest.raises(UsageError, match="give --max-speed in rad/s"):
        choose_limits(drive, AXIS, Options())
    assert choose_limits(drive, AXIS, Options(max_speed=7.0)).speed == 7.0
    limits = {k: v for k, v in drive.profile.limits.items() if k != "speed"}
    changed(drive, limits=limits)
    assert choose_limits(drive, AXIS, Options(max_speed=7.0)).speed == 7.0


LIMITS = Limits(start=0.0, travel=1.0, torque=0.5, speed=50.0, rated=1.0, duration=60.0)


def test_first_motions_are_slow_enough_to_stop_within_half_of_the_travel(
    drive: ProfiledDrive,
) -> None:
    # half of 1 rad within 30 ms and six cycles of 2 ms; a dead time that is known, and three cycles
    assert preflight.cautious_speed(drive, LIMITS) == pytest.approx(0.5 / 0.042)
    assert preflight.cautious_speed(drive, LIMITS, 0.004) == pytest.approx(0.5 / 0.010)
    slow = replace(LIMITS, speed=3.0)
    assert preflight.cautious_speed(drive, slow) == 3.0


def test_what_is_written_never_raises_a_limit_of_the_drive(drive: ProfiledDrive) -> None:
    found = preflight.writes(drive, LIMITS)
    assert found["max_torque"] == 500
    assert found["max_speed"] == drive.parameters["max_speed"].raw(1.2 * 0.5 / 0.042)
    assert found["watchdog_time"] == drive.preparation.watchdog()["watchdog_time"]
    drive.write("max_torque", 400)
    drive.write("max_speed", 1)
    found = preflight.writes(drive, LIMITS)
    assert (found["max_torque"], found["max_speed"]) == (400, 1)
    tiny = preflight.writes(drive, replace(LIMITS, torque=1e-9))
    assert tiny["max_torque"] == 1, "0 would be no limit in some drives"
    drive.write("max_torque", 0)
    assert preflight.writes(drive, LIMITS)["max_torque"] == 500
    changed(drive, limits={})
    assert "max_torque" not in preflight.writes(drive, LIMITS)


@pytest.fixture
def settings(drive: ProfiledDrive, tmp_path: Path) -> Iterator[Settings]:
    with Journal(tmp_path / "journal") as journal:
        run = journal.begin(
            axis="a",
            link="x",
            profile="p",
            profile_hash="",
            serial="1",
            context=RunContext("{}"),
        )
        yield Settings(journal, run, drive)


def test_the_drive_s_speed_limit_is_widened_at_most_to_what_it_was(
    drive: ProfiledDrive, settings: Settings
) -> None:
    before = drive.read("max_speed").raw
    preflight.set_limits(drive, settings, LIMITS, lambda text: None)
    assert drive.read("max_speed").raw < before
    preflight.widen_speed(drive, settings, 20.0)
    assert drive.read("max_speed").si == pytest.approx(24.0, rel=0.01)
    preflight.widen_speed(drive, settings, 1e6)
    assert drive.read("max_speed").raw == before
    preflight.widen_speed(drive, settings, 1e-9)
    assert drive.read("max_speed").raw == 1
    assert settings.restore().complete
    assert drive.read("max_speed").raw == before
    changed(drive, limits={})
    preflight.widen_speed(drive, settings, 5.0)
    assert drive.read("max_speed").raw == before


def test_a_drive_whose_speed_limit_was_none_gets_ours(
    drive: ProfiledDrive, settings: Settings
) -> None:
    drive.write("max_speed", 0)
    preflight.widen_speed(drive, settings, 20.0)
    assert drive.read("max_speed").si == pytest.approx(24.0, rel=0.01)


def test_everything_that_a_job_leaves_as_found_is_journalled_before_it_moves(
    drive: ProfiledDrive, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drive.preparation, "bus", lambda: {"1400h:01": (5, 6)})
    preflight.set_limits(drive, settings, LIMITS, lambda text: None)
    named = {i.parameter for i in settings._journal.intents(settings.run, open_only=True)}
    assert {
        "max_torque", "max_speed", "torque_target", "position_target", "1400h:01",
        "mode_of_operation",
    } <= named  # fmt: skip
    assert all(drive.read(name).raw == raw for name, raw in drive.preparation.watchdog().items()), (
        "armed"
    )


def test_a_drive_that_is_enabled_by_being_prepared_is_stopped_and_refused(
    drive: ProfiledDrive, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[bool] = []
    stop, write, state = drive.stop, drive.write, drive.state

    def written(name: str, raw: int) -> None:
        write(name, raw)
        if name == "mode_of_operation":
            monkeypatch.setattr(drive, "state", lambda: state()._replace(is_energised=not stops))

    monkeypatch.setattr(drive, "write", written)
    monkeypatch.setattr(drive.preparation, "mode_codes", lambda: [8])

    def stopped() -> object:
        stops.append(True)
        return stop()

    monkeypatch.setattr(drive, "stop", stopped)
    with raises(PreflightRefused, "preflight.enabled-itself"):
        preflight.set_limits(drive, settings, LIMITS, lambda text: None)
    assert stops == [True]


# -- the watchdog ---------------------------------------------------------------------------------


@pytest.fixture
def armed(drive: ProfiledDrive) -> ProfiledDrive:
    for name, raw in drive.preparation.watchdog().items():
        drive.write(name, raw)
    return drive


def proved(drive: ProfiledDrive, *, without: bool = False, before: str | None = None) -> str:
    told.clear()
    return prove_watchdog(
        drive, 0.02, 1.0, Interruption(), told.append, without=without, before=before
    )


told: list[str] = []


def test_a_drive_without_a_watchdog_wants_the_user_s_word(drive: ProfiledDrive) -> None:
    changed(drive, watchdog=drive.profile.watchdog.model_copy(update={"kind": "none"}))
    with raises(PreflightRefused, "preflight.no-watchdog"):
        proved(drive)
    assert proved(drive, without=True) == ""
    assert "no watchdog of the drive is proved" in told[0]
    assert not drive.state().is_energised


def test_silence_stops_a_drive_with_a_watchdog_and_leaves_it_without_fault(
    armed: ProfiledDrive,
) -> None:
    found = proved(armed)
    assert told == [
        "the drive noticed it, by itself: switch on disabled, error code 8100h (communication)",
    ]
    assert not armed.state().is_energised
    assert not armed.state().in_fault
    assert proved(armed, before=found) == found


def test_the_silence_lasts_three_times_as_long_as_the_watchdog_bears(
    armed: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []
    wait = armed.wait

    def noted(seconds: float) -> None:
        waits.append(seconds)
        wait(seconds)

    monkeypatch.setattr(armed, "wait", noted)
    proved(armed)
    assert waits == pytest.approx([0.15])


def test_a_drive_that_goes_on_in_silence_is_stopped_and_refused(drive: ProfiledDrive) -> None:
    drive.write("watchdog_time", 0)
    before = drive._bus.device.firmware.now  # type: ignore[attr-defined]
    with pytest.raises(PreflightRefused, match=r"did not stop after 150 ms of silence"):
        proved(drive)
    assert not drive.state().is_energised
    passed = drive._bus.device.firmware.now - before  # type: ignore[attr-defined]
    assert passed >= 1e9 * drive.profile.stop_time, "a brake would have had its time"


def test_a_drive_that_stops_before_it_was_silent_is_no_proof(
    armed: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchange, count = armed.exchange, [0]

    def stops(set_point: float) -> Sample:
        count[0] += 1
        sample = exchange(set_point)
        enabled = count[0] < 5
        return sample._replace(status=replace(sample.status, enabled=enabled))

    monkeypatch.setattr(armed, "exchange", stops)
    with raises(DriveFault, "watchdog.stopped-before"):
        proved(armed)
    assert count == [5]
    assert not armed.state().is_energised


def test_another_fault_than_the_watchdog_s_stays_in_the_drive(armed: ProfiledDrive) -> None:
    armed.write("abort_connection_option", 1)
    found = proved(armed)
    assert "8100h" in found
    with raises(DriveFault, "watchdog.another-fault"):
        proved(armed, before="fault, error code 4310h")
    assert armed.state().in_fault, "it is not reset: somebody has to look it up"


def test_an_axis_that_moves_in_the_silence_is_refused(
    armed: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, moved = armed.read, [0.0]

    def shifted(name: str) -> Value:
        raw, value = read(name)
        if name == "position_actual":
            value, moved[0] = value + moved[0], 0.0626
        return Value(raw, value)

    monkeypatch.setattr(armed, "read", shifted)
    with pytest.raises(PreflightRefused, match=r"moved by \+0\.0626 \(of ±1 that are allowed\)"):
        proved(armed)
    moved[0] = 0.0

    def little(name: str) -> Value:
        raw, value = read(name)
        if name == "position_actual":
            value, moved[0] = value + moved[0], -0.049
        return Value(raw, value)

    monkeypatch.setattr(armed, "read", little)
    proved(armed)


def test_the_axis_rests_on_its_torque_while_the_watchdog_is_proved(
    armed: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands = []
    exchange = armed.exchange

    def noted(set_point: float) -> Sample:
        commands.append(set_point)
        return exchange(set_point)

    monkeypatch.setattr(armed, "exchange", noted)
    proved(armed)
    assert commands == [0.02] * 5


def test_an_axis_with_a_name_is_asked_for_travel_in_its_unit(drive: ProfiledDrive) -> None:
    linear = Axis(name="z", link="virtual://emps")
    with pytest.raises(UsageError, match="in rad about"):
        choose_limits(drive, linear, Options())


def test_a_drive_that_does_not_tell_its_error_code_is_not_accused(
    armed: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two proofs, in one of which the code was lost: nobody knows whether the faults differ."""
    before, state = proved(armed), armed.state
    monkeypatch.setattr(armed, "state", lambda: state()._replace(code=None, fault="fault"))
    with raises(LinkError, "watchdog.not-told"):
        proved(armed, before=before)
