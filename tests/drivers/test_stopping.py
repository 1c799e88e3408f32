"""The stop path against a drive of a few lines.

What is sent, in which order, how long is waited.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import pytest

from drivers.drive import StopReport
from drivers.errors import AccessDenied, LinkLost
from drivers.serial_port import SerialPort
from drivers.stopping import Rest, StopPath
from profiles.address import Address
from profiles.library import load_profile
from profiles.procedures import Step
from profiles.schema import Profile
from profiles.toml_files import parse_model
from tests.command import ROOT

CANOPEN, MODBUS = load_profile("virtual-canopen"), load_profile("virtual-modbus")
REVOLUTION = 1000.0  # increments


class Motor:
    """A drive that decelerates, coasts or runs away, and loses its energy when it is told to.

    Parameters
    ----------
    motion : increments from each look to the next; 0 after the last
    rests_after : looks until the quick stop has de-energised the drive; None: never
    obeys : loses its energy on 'disable voltage'
    """

    def __init__(
        self, profile: Profile, motion: list[float] = [], rests_after: int | None = None, *,  # noqa: B006
        obeys: bool = True,
    ) -> None:  # fmt: skip
        self.profile = profile
        known = profile.parameters
        self.control = known["controlword" if "controlword" in known else "key_2"].address
        self.position_at = profile.parameters["position_actual"].address
        self.energised = True
        self.posts: list[tuple[str, int]] = []
        self.waits = 0
        self.looks = 0
        self.broken: set[str] = set()
        self.refuses: list[tuple[Address, int]] = []
        self._names = {str(p.address): name for name, p in profile.parameters.items()}
        self._motion, self._position = list(motion), 0.0
        self._rests_after, self._obeys = rests_after, obeys
        self.lent: int | None = 7
        self.halted: Callable[[int], int] = lambda waits: 0  # what 'until' looks at
        self.reads = 0
        self.busy: set[str] = set()  # what it has no time for, as it says
        self.slow = 0.0  # s that a read takes

    # -- the bus ---------------------------------------------------------------------------------

    def refused_posts(self) -> list[tuple[Address, int]]:
        """Those that were refused once their answer came."""
        refused, self.refuses = self.refuses, []
        return refused

    def post(self, address: Address, raw: int) -> None:
        self._has_time("post")
        self.posts.append((self._names[str(address)], raw))
        if "post" in self.broken:
            raise LinkLost("cable")
        if (address, raw) == (self.control, 0) and self._obeys:
            self.energised = False

    def read(self, address: Address) -> int:
        self.reads += 1
        self._has_time("read")
        if address != self.position_at:
            return self.halted(self.waits)
        if "read" in self.broken:
            raise AccessDenied("no")
        return round(self._position)

    def wait(self, seconds: float) -> None:
        assert seconds == 0.005
        self.waits += 1
        if "wait" in self.broken:
            raise LinkLost("no time")
        self._position += self._motion.pop(0) if self._motion else 0.0
        if self._rests_after is not None and self.waits >= self._rests_after:
            self.energised = False

    def _has_time(self, what: str) -> None:
        if what in self.busy:
            raise AccessDenied("exception 6", busy=True)

    def now(self) -> float:
        return 7.0 + 0.005 * self.waits + self.slow * (self.reads + self.looks)

    def descriptor(self) -> int | None:
        return self.lent

    def port(self) -> SerialPort | None:
        return None

    def frame(self, address: Address, raw: int) -> bytes:
        return f"{self._names[str(address)]}={raw}".encode()

    # -- and what asks it ------------------------------------------------------------------------

    def is_energised(self) -> bool:
        self.looks += 1
        self._has_time("look")
        if "look" in self.broken:
            raise LinkLost("silent")
        return self.energised

    def path(self, revolution: float = REVOLUTION) -> StopPath:
        return StopPath(self, self.profile, self.is_energised, revolution)  # type: ignore[arg-type]

    def rest(self) -> Rest:
        return Rest(self.profile.parameters["torque_target"].address, 5)

    def stop(
        self, *, hurry: Callable[[], bool] = lambda: False, revolution: float = REVOLUTION
    ) -> tuple[StopReport, list[str]]:
        done: list[str] = []
        report = self.path(revolution).stop(self.rest(), hurry, lambda: done.append("rested"))
        return report, done


QUICK, REST, DISABLE = ("controlword", 2), ("torque_target", 5), ("controlword", 0)


@pytest.mark.parametrize(
    ("profile", "order"),
    [(CANOPEN, [QUICK, REST, DISABLE]), (MODBUS, [REST, QUICK, DISABLE])],
    ids=lambda value: getattr(value, "name", ""),
)
def test_rest_and_quick_stop_go_before_the_energy_does(
    profile: Profile, order: list[tuple[str, int]]
) -> None:
    """Where both travel in one frame the controlword is first, so that none enables once more."""
    motor = Motor(profile, rests_after=3)
    report, done = motor.stop()
    assert motor.posts == order
    assert motor.waits == 3, "the drive is waited for, and not longer"
    assert report == StopReport(True)
    assert done == ["rested"]


def test_a_drive_that_brakes_for_long_is_waited_for_as_long_as_its_profile_says() -> None:
    motor = Motor(CANOPEN, motion=[9.0] * 500)
    report, _ = motor.stop()
    assert motor.waits == round(CANOPEN.stop_time / 0.005)
    assert report.deenergised
    short = Motor(CANOPEN.model_copy(update={"stop_time": 0.001}))
    short.stop()
    assert short.waits == 3, "three looks at least"


def test_in_a_hurry_nothing_is_waited_for() -> None:
    motor = Motor(CANOPEN)
    report, _ = motor.stop(hurry=lambda: True)
    assert motor.waits == 0
    assert motor.posts == [QUICK, REST, DISABLE]
    assert report.deenergised


def test_a_second_signal_ends_the_waiting() -> None:
    motor = Motor(CANOPEN)
    motor.stop(hurry=lambda: motor.waits >= 4)
    assert motor.waits == 4


@pytest.mark.parametrize(
    ("motion", "waits"),
    [
        # noise: 0.3 revolutions/s of 1000 increments are 1.5 in 5 ms; the first looks at 30 allow
        # 37.5
        ([30, 30, 38, 38, 38], 4),
        ([30, 30, 37, 37, 37, 37], 200),
        ([30, 30, 38, 37, 38, 37, 38, 38], 8),
        ([-30, -30, -38, -38, -38], 4),
        ([10, 30, 37, 38, 38, 38], 5),
        ([100, 30, 121, 121, 121], 200),
        ([100, 30, 122, 122, 122], 4),
    ],
)
def test_an_axis_that_becomes_faster_loses_its_energy_at_once(
    motion: list[float], waits: int
) -> None:
    motor = Motor(CANOPEN, motion)
    motor.stop()
    assert motor.waits == waits


def test_speeds_are_not_judged_where_a_revolution_is_not_known_or_no_position_is_told() -> None:
    runaway = [10, 10, *([9000.0] * 300)]
    unknown = Motor(CANOPEN, runaway)
    unknown.broken.add("read")
    unknown.stop(revolution=inf)
    silent = Motor(CANOPEN, runaway)
    silent.broken.add("read")
    report, _ = silent.stop()
    assert unknown.waits == silent.waits == 200
    assert report.failures == ()


def test_a_drive_that_keeps_its_energy_is_looked_at_for_as_long_and_said_to() -> None:
    motor = Motor(CANOPEN, obeys=False)
    report, done = motor.stop(hurry=lambda: True)
    assert report == StopReport(False)
    assert "STILL ENERGISED" in str(report)
    assert motor.looks == motor.waits == 200
    assert done == []


def test_what_fails_is_told_once_and_keeps_nothing_back() -> None:
    motor = Motor(CANOPEN)
    motor.broken |= {"post", "look", "wait"}
    report, done = motor.stop()
    assert motor.posts == [QUICK, REST, DISABLE]
    assert report.deenergised is None
    assert report.failures == ("cable", "silent")
    assert "NOT verified" in str(report)
    assert motor.looks == 2, "once while it brakes, once after"
    assert done == []


def test_a_drive_that_does_not_answer_after_the_stop_is_asked_once() -> None:
    motor = Motor(CANOPEN)
    motor.broken.add("look")
    report, done = motor.stop(hurry=lambda: True)
    assert report == StopReport(None, ("silent",))
    assert (motor.looks, done) == (1, [])


def test_a_wait_that_fails_does_not_end_the_looking() -> None:
    motor = Motor(CANOPEN, obeys=False)
    motor.broken.add("wait")
    report, _ = motor.stop(hurry=lambda: True)
    assert motor.looks == 200
    assert report == StopReport(False, ("no time",))


def test_an_error_without_words_is_told_by_its_kind() -> None:
    motor = Motor(CANOPEN, rests_after=1)

    def fails() -> None:
        raise ZeroDivisionError

    report = motor.path().stop(motor.rest(), lambda: False, fails)
    assert report == StopReport(True, ("ZeroDivisionError",))


def test_the_frames_for_another_process_are_written_three_times_with_their_pauses() -> None:
    frames = Motor(MODBUS).path().frames(Motor(MODBUS).rest())
    assert frames is not None
    assert frames.descriptor == 7
    halt = [(b"torque_target=5", 0.03), (b"controlword=2", 0.03)]
    assert frames.frames == (
        *halt, *halt, halt[0], (b"controlword=2", MODBUS.stop_time),
        *[(b"controlword=0", 0.03)] * 3,
    )  # fmt: skip


def test_a_bus_that_others_connect_to_needs_no_frames() -> None:
    motor = Motor(MODBUS)
    motor.lent = None
    assert motor.path().frames(motor.rest()) is None


# -- by a procedure -------------------------------------------------------------------------------

TWO_KEY = parse_model((ROOT / "tests/faults/two_key.toml").read_text(), Profile, "two-key")
HALT = ("halt", 1)


def mute(profile: Profile) -> Profile:
    """The same drive without a word for braking."""
    assert profile.power is not None
    return profile.model_copy(update={"power": profile.power.model_copy(update={"stopping": None})})


def test_leaving_enabled_is_no_standstill_where_a_drive_has_no_word_for_braking() -> None:
    """It brakes for 20 looks and says 'not enabled' from the first one on."""
    motor = Motor(mute(TWO_KEY), motion=[20.0] * 20, rests_after=1)
    report, _ = motor.stop()
    assert motor.posts[:2] == [REST, HALT]
    assert motor.posts[2:] == [("key_2", 0), ("halt", 0)]
    assert motor.waits == 20 + 3, "three looks without motion are rest"
    assert report.deenergised


def test_one_that_says_when_it_brakes_is_believed() -> None:
    motor = Motor(TWO_KEY, motion=[20.0] * 20, rests_after=12)
    motor.stop()
    assert motor.waits == 12


@pytest.mark.parametrize(("counts", "waits"), [(3.0, 3), (4.0, 200)])
def test_three_counts_are_no_motion(counts: float, waits: int) -> None:
    motor = Motor(mute(TWO_KEY), motion=[counts] * 500, rests_after=0)
    motor.stop()
    assert motor.waits == waits


def test_a_ten_thousandth_of_a_revolution_is_none_either() -> None:
    fine = Motor(mute(TWO_KEY), motion=[100.0] * 500, rests_after=0)
    fine.stop(revolution=1e6)
    assert fine.waits == 3
    faster = Motor(mute(TWO_KEY), motion=[101.0] * 500, rests_after=0)
    faster.stop(revolution=1e6)
    assert faster.waits == 200


def test_a_stop_by_a_stranger_sees_rest_without_the_encoders_resolution() -> None:
    motor = Motor(mute(TWO_KEY), motion=[9000.0] * 7, rests_after=1)
    motor.stop(revolution=inf)
    assert motor.waits == 7 + 3


WAITING = TWO_KEY.model_copy(
    update={
        "stop": (
            *TWO_KEY.stop,
            Step(until="store_state", mask=0xFF, equals=6, within=0.1),
            Step(write="key_1", raw=3),
        )
    }
)


def test_a_step_that_waits_is_waited_for_before_the_next_one() -> None:
    motor = Motor(WAITING, rests_after=0)
    motor.halted = lambda waits: 0x0106 if waits == 8 else 0
    report, _ = motor.stop()
    assert motor.posts == [REST, HALT, ("key_1", 3), ("key_2", 0), ("halt", 0)]
    assert motor.waits == 8
    assert report == StopReport(True)


def test_a_wait_in_vain_is_told_and_the_energy_goes_all_the_same() -> None:
    motor = Motor(WAITING, rests_after=0)
    report, _ = motor.stop()
    assert motor.posts[-2:] == [("key_2", 0), ("halt", 0)]
    assert motor.waits == 20
    assert report == StopReport(True, ("stop: 'store_state' reads 0 for 0.1 s instead of 6",))


def test_in_a_hurry_no_step_is_waited_for() -> None:
    motor = Motor(WAITING, rests_after=0)
    motor.stop(hurry=lambda: True)
    assert (motor.waits, motor.reads) == (0, 0), "a read takes its time-out where nobody answers"


def test_frames_wait_the_longest_that_a_step_may_take_before_the_next_one() -> None:
    motor = Motor(WAITING)
    frames = motor.path().frames(motor.rest())
    assert frames is not None
    first, halt, key = b"torque_target=5", b"halt=1", b"key_1=3"
    assert frames.frames == (
        *[(first, 0.03), (halt, 0.03)] * 2, (first, 0.03), (halt, 0.1),
        *[(key, 0.03)] * 2, (key, WAITING.stop_time),
        *[(b"key_2=0", 0.03), (b"halt=0", 0.03)] * 3,
    )  # fmt: skip


def test_a_step_that_waits_may_be_the_last_one() -> None:
    profile = TWO_KEY.model_copy(
        update={"disable": (*TWO_KEY.disable, Step(until="store_state", equals=0, within=0.2))}
    )
    motor = Motor(profile)
    frames = motor.path().frames(motor.rest())
    assert frames is not None
    assert frames.frames[-2:] == ((b"key_2=0", 0.03), (b"halt=0", 0.2))


# -- a drive that has no time, or takes it --------------------------------------------------------


class Hectic(Motor):
    """Busy until it was asked so often."""

    def __init__(self, what: str, times: int) -> None:
        super().__init__(TWO_KEY, motion=[20.0] * 20, rests_after=12)
        self.busy.add(what)
        self.left = times

    def _has_time(self, what: str) -> None:
        if what in self.busy and self.left > 0:
            self.left -= 1
            super()._has_time(what)


@pytest.mark.parametrize("times", [1, 3])
def test_a_busy_answer_to_a_look_tells_nothing(times: int) -> None:
    motor = Hectic("look", times)
    report, done = motor.stop()
    assert motor.waits == 12, "it brakes to its end"
    assert report == StopReport(True)
    assert done == ["rested"]


def test_a_drive_that_is_busy_after_the_stop_is_asked_again() -> None:
    motor = Hectic("look", 3)
    report, _ = motor.stop(hurry=lambda: True)
    assert report == StopReport(True)
    assert motor.waits == 3


def test_a_stop_that_a_busy_drive_refuses_is_said_again() -> None:
    motor = Hectic("post", 2)
    report, _ = motor.stop()
    assert motor.posts == [REST, HALT, ("key_2", 0), ("halt", 0)]
    assert report == StopReport(True)


def test_energy_that_a_busy_drive_keeps_is_taken_as_soon_as_it_has_time() -> None:
    motor = Hectic("post", 10)
    report, _ = motor.stop(hurry=lambda: True)
    assert motor.posts == [("key_2", 0), ("halt", 0)], "and no quick stop after it"
    assert report == StopReport(True)
    assert motor.waits == 4


def test_a_wait_for_a_busy_drive_goes_on() -> None:
    motor = Hectic("read", 4)
    motor.profile = WAITING
    motor.halted = lambda waits: 6
    motor.stop()
    assert motor.posts[:3] == [REST, HALT, ("key_1", 3)]


def test_time_is_counted_and_not_looks() -> None:
    """Reads of 20 ms each: a stop of 1 s is one of 1 s, and not of 200 looks."""
    motor = Motor(CANOPEN, motion=[9.0] * 500)
    motor.slow = 0.02
    motor.stop()
    assert motor.now() - 7.0 == pytest.approx(CANOPEN.stop_time, abs=0.1)
    waiting = Motor(WAITING, rests_after=0)
    waiting.slow = 0.02
    waiting.stop()
    assert waiting.now() - 7.0 == pytest.approx(0.1, abs=0.1)


def test_what_is_refused_by_an_answer_that_comes_later_is_said_again() -> None:
    """On CANopen a post is an SDO download whose answer nobody waits for.

    0800 0022h is seen afterwards.
    """
    motor = Motor(CANOPEN, motion=[20.0] * 20, rests_after=12)
    control = CANOPEN.parameters["controlword"].address
    motor.refuses = [(control, 0x0002)]
    report, _ = motor.stop()
    assert report == StopReport(True)
    assert [raw for name, raw in motor.posts if name == "controlword"][:2] == [0x0002, 0x0002]
