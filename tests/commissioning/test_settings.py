"""Writes with a way back: order of journal and drive, refusals, and what a restore reaches."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from commissioning.errors import JournalError
from commissioning.journal import Intent, Journal
from commissioning.records import RunContext
from commissioning.settings import Restored, Settings, put_back, settle
from drivers.described import described
from drivers.drive import DriveSays, Value
from drivers.errors import LinkLost, WriteFailed
from drivers.scaling import Scaling
from profiles.axis import Mechanics
from profiles.library import load_profile
from profiles.schema import Profile
from tests.raising import raises

PROFILE = load_profile("virtual-canopen")
SCALING = Scaling(1.0, 4096.0, Mechanics())


class Drawer:
    """A drive that is a drawer of raw values.

    It notes what is done, and fails where it is told to.
    """

    def __init__(self, journal: Journal, profile: Profile = PROFILE) -> None:
        self.describe(profile)
        self.preparation = self
        self.values = dict.fromkeys(profile.parameters, 0)
        self.done: list[str] = []
        self.journalled: list[list[tuple[str, str]]] = []
        self.broken: dict[str, Exception] = {}
        self.objects: dict[str, tuple[int, int]] = {}
        self.lock: dict[str, int] = {}
        self.run = ""
        self.energised = False
        self._journal = journal

    def describe(self, profile: Profile) -> None:
        self.profile = profile
        self.parameters = described(profile, SCALING, constant_known=True)

    def read(self, name: str) -> Value:
        self.done.append(f"read {name}")
        if f"read {name}" in self.broken:
            raise self.broken[f"read {name}"]
        return Value(self.values[name], 0.0)

    def write(self, name: str, raw: int) -> None:
        self.done.append(f"write {name}={raw}")
        if self.run:
            found = self._journal.intents(self.run)
            self.journalled.append([(i.parameter, i.state) for i in found])
        if f"write {name}" in self.broken:
            raise self.broken[f"write {name}"]
        self.values[name] = raw

    def state(self) -> DriveSays:
        return DriveSays(self.energised, False, "", "no fault", 0, "")

    def bus(self) -> dict[str, tuple[int, int]]:
        return self.objects

    def put_back_bus(self, old: dict[str, int]) -> bool:
        self.done.append(f"bus {old}")
        if "bus" in self.broken:
            raise self.broken["bus"]
        changed = {name: new for name, (_, new) in self.objects.items()} != old
        self.objects = {name: (value, value) for name, value in old.items()}
        return changed

    def exclusive_access(self) -> dict[str, int]:
        return self.lock


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal(tmp_path / "journal") as opened:
        yield opened


@pytest.fixture
def drive(journal: Journal) -> Drawer:
    drawer = Drawer(journal)
    drawer.run = journal.begin(
        axis="a",
        link="x",
        profile="p",
        profile_hash="",
        serial="1",
        context=RunContext("{}"),
    )
    return drawer


@pytest.fixture
def settings(journal: Journal, drive: Drawer) -> Settings:
    return Settings(journal, drive.run, drive)  # type: ignore[arg-type]


def state(journal: Journal, drive: Drawer) -> list[tuple[str, int, int, str]]:
    return [(i.parameter, i.old, i.new, i.state) for i in journal.intents(drive.run)]


def test_the_intent_stands_in_the_journal_before_the_write_and_is_verified_after(
    journal: Journal, drive: Drawer, settings: Settings
) -> None:
    assert settings.write("experiment", "max_torque", 700) is True
    assert drive.journalled == [[("max_torque", "intended")]]
    assert state(journal, drive) == [("max_torque", 0, 700, "verified")]
    assert settings.write("experiment", "max_torque", 700) is False
    assert drive.done.count("write max_torque=700") == 1
    assert len(state(journal, drive)) == 1


def test_only_what_the_profile_gives_for_this_is_written(
    journal: Journal, drive: Drawer, settings: Settings
) -> None:
    with raises(WriteFailed, "write.kind"):
        settings.write("compensation", "max_torque", 1)
    with raises(WriteFailed, "write.kind"):
        settings.write("experiment", "statusword", 1)
    assert state(journal, drive) == []
    assert settings.write("experiment", "mode_of_operation", 10), "a command that is put back"


def test_what_could_not_be_written_back_is_left_alone(
    journal: Journal, drive: Drawer, settings: Settings
) -> None:
    parameters = dict(PROFILE.parameters)
    narrow = parameters["max_torque"].model_copy(
        update={"minimum": 0, "maximum": 1000, "largest_step": 100}
    )
    parameters["max_torque"] = narrow
    drive.describe(PROFILE.model_copy(update={"parameters": parameters}))
    drive.values["max_torque"] = 2000
    with pytest.raises(WriteFailed, match=r"reads 2000, which is not allowed to be .*0…1000"):
        settings.write("experiment", "max_torque", 500)
    drive.values["max_torque"] = 500
    with pytest.raises(WriteFailed, match="the step from 500 to 601 is larger than the 100"):
        settings.write("experiment", "max_torque", 601)
    with pytest.raises(WriteFailed, match="the step from 500 to 399 is larger"):
        settings.write("experiment", "max_torque", 399)
    assert state(journal, drive) == []
    assert settings.write("experiment", "max_torque", 600)
    assert settings.write("experiment", "max_torque", 500)


def test_the_oldest_value_is_that_before_the_first_write_of_the_run(
    drive: Drawer, settings: Settings
) -> None:
    drive.values["max_speed"] = 5
    assert settings.oldest("max_speed") == 5
    for raw in (7, 9):
        settings.write("experiment", "max_speed", raw)
    assert settings.oldest("max_speed") == 5
    assert settings.oldest("max_torque") == 0
    settings.restore()
    drive.values["max_speed"] = 6
    assert settings.oldest("max_speed") == 6, "what is put back is history"


def test_set_points_are_remembered_as_they_are_and_nothing_else_is(
    journal: Journal, drive: Drawer, settings: Settings
) -> None:
    drive.values |= {"torque_target": 40, "max_torque": 3}
    settings.remember("torque_target")
    settings.remember("max_torque")
    assert state(journal, drive) == [("torque_target", 40, 40, "verified")]
    drive.values["torque_target"] = 55  # what the motion left
    assert settings.restore().restored == ["torque_target"]
    assert drive.values["torque_target"] == 0, "whatever stood there, nothing is to move"


def test_what_the_cycle_changes_of_the_bus_is_journalled_and_put_back_at_once(
    journal: Journal, drive: Drawer, settings: Settings
) -> None:
    drive.objects = {"1400h:01": (5, 6), "1600h:00": (2, 3)}
    settings.remember_bus()
    assert state(journal, drive) == [
        ("1400h:01", 5, 6, "intended"), ("1600h:00", 2, 3, "intended"),
    ]  # fmt: skip
    outcome = settings.restore()
    assert set(outcome.restored) == {"1400h:01", "1600h:00"}
    assert drive.objects == {"1400h:01": (5, 5), "1600h:00": (2, 2)}
    assert len(drive.done) == 1, "all at once"
    assert {row[3] for row in state(journal, drive)} == {"restored"}
    assert settings.restore() == Restored(), "nothing is left to do"


def test_a_restore_goes_backwards_to_the_oldest_value_and_settles_every_intent(
    journal: Journal, drive: Drawer, settings: Settings
) -> None:
    drive.values["max_torque"] = 11
    settings.write("experiment", "max_torque", 12)
    settings.write("experiment", "max_speed", 13)
    settings.write("experiment", "max_torque", 14)
    settings.write("compensation", "coulomb_positive", 15)
    drive.done.clear()
    outcome = settings.restore()
    written = [word for word in drive.done if word.startswith("write")]
    assert written == ["write max_torque=11", "write max_speed=0"]
    assert outcome.complete
    assert {row[0]: row[3] for row in state(journal, drive)} == {
        "max_torque": "restored", "max_speed": "restored", "coulomb_positive": "verified",
    }  # fmt: skip
    assert [row[3] for row in state(journal, drive)].count("restored") == 3


def test_what_an_experiment_set_is_put_back_whoever_changed_it_meanwhile(
    drive: Drawer, settings: Settings
) -> None:
    """A drive may round, or its firmware reset, what was set for the experiment."""
    settings.write("experiment", "max_torque", 12)
    drive.values["max_torque"] = 99
    assert settings.restore().restored == ["max_torque"]
    assert drive.values["max_torque"] == 0


def intent(parameter: str, old: int, new: int, seq: int = 1) -> Intent:
    return Intent(seq, "r", "experiment", parameter, old, new, "verified")


def restored(drive: Drawer, *intents: Intent, force: bool = False) -> Restored:
    return put_back(drive, list(intents), force=force)  # type: ignore[arg-type]


def test_a_value_of_somebody_else_is_skipped_unless_it_is_forced(drive: Drawer) -> None:
    drive.values |= {"max_torque": 42, "max_speed": 9}
    mine = (intent("max_torque", 1, 2), intent("max_speed", 3, 9))
    outcome = restored(drive, *mine)
    assert outcome.restored == ["max_speed"]
    assert list(outcome.skipped) == ["max_torque"]
    assert "it reads 42, neither the old 1 nor what was written" in outcome.skipped["max_torque"]
    assert not outcome.complete
    assert drive.values["max_torque"] == 42
    forced = restored(drive, *mine, force=True)
    assert forced.complete
    assert (forced.restored, forced.already) == (["max_torque"], ["max_speed"])
    assert drive.values["max_torque"] == 1


def test_every_value_that_we_wrote_counts_as_ours(drive: Drawer) -> None:
    drive.values["max_torque"] = 5  # the write of 7 was cut off
    assert restored(drive, intent("max_torque", 1, 5, 1), intent("max_torque", 5, 7, 2)).complete
    assert drive.values["max_torque"] == 1


def test_a_set_point_gets_its_resting_value_whatever_stood_in_it(drive: Drawer) -> None:
    drive.values |= {"torque_target": 123, "position_target": 7, "position_actual": -55}
    outcome = restored(drive, intent("torque_target", 300, 300), intent("position_target", 9, 9))
    assert outcome.restored == ["position_target", "torque_target"]
    assert drive.values["torque_target"] == 0
    assert drive.values["position_target"] == -55, "where the axis is"


def test_what_commands_the_drive_is_put_back_last_and_only_without_energy(drive: Drawer) -> None:
    drive.values |= {"mode_of_operation": 10, "max_torque": 2}
    mine = (intent("max_torque", 1, 2, 1), intent("mode_of_operation", 8, 10, 2))
    drive.energised = True
    outcome = restored(drive, *mine)
    assert outcome.failed == {"mode_of_operation": "not put back while the drive is enabled"}
    assert outcome.restored == ["max_torque"]
    drive.energised = False
    drive.values["max_torque"] = 2
    drive.done.clear()
    assert restored(drive, *mine).complete
    assert [d for d in drive.done if d.startswith("write")] == [
        "write max_torque=1", "write mode_of_operation=8",
    ]  # fmt: skip


@pytest.mark.parametrize("word", [0x06, 0x07, 0x0F, 0x16, 0x1F, 0x10F, 0x02])
def test_a_word_that_enables_is_never_put_back(drive: Drawer, word: int) -> None:
    outcome = restored(drive, intent("controlword", word, 0), force=True)
    assert "which enables the drive" in outcome.skipped["controlword"]
    assert drive.values["controlword"] == 0
    assert not outcome.complete


def test_a_refused_parameter_does_not_keep_the_others_back(drive: Drawer) -> None:
    drive.values |= {"max_torque": 2, "max_speed": 4}
    drive.broken["write max_speed"] = WriteFailed("read-only today")
    outcome = restored(drive, intent("max_torque", 1, 2), intent("max_speed", 3, 4))
    assert outcome.failed == {"max_speed": "read-only today"}
    assert outcome.restored == ["max_torque"]
    assert not outcome.complete


def test_a_dead_link_is_not_asked_again_and_everything_behind_it_is_named(drive: Drawer) -> None:
    drive.broken["read max_speed"] = LinkLost("cable")
    drive.objects = {"1400h:01": (5, 6)}
    outcome = restored(
        drive, intent("1400h:01", 5, 6), intent("max_torque", 1, 2), intent("max_speed", 3, 4)
    )
    assert drive.done == ["read max_speed"]
    assert outcome.failed == {
        "max_speed": "cable", "max_torque": "the link is gone", "1400h:01": "the link is gone",
    }  # fmt: skip
    assert outcome.restored == outcome.already == []


def test_objects_of_the_bus_that_are_as_before_are_said_to_be(drive: Drawer) -> None:
    drive.objects = {"1400h:01": (5, 5)}
    assert restored(drive, intent("1400h:01", 5, 6)).already == ["1400h:01"]
    drive.broken["bus"] = LinkLost("cable")
    assert restored(drive, intent("1400h:01", 5, 6)).failed == {"1400h:01": "cable"}


def test_a_journal_that_fails_while_it_settles_is_told_by_parameter(
    drive: Drawer, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: Any) -> None:
        raise JournalError("disk full")

    monkeypatch.setattr(journal, "settle", full)
    outcome = Restored(restored=["max_torque"], already=["max_speed"], failed={"a": "b"})
    intents = [intent("max_torque", 1, 2), intent("max_speed", 3, 4), intent("other", 3, 4)]
    settle(journal, intents, outcome)
    assert outcome.failed == {
        "a": "b",
        "max_torque": "it has its old value, but disk full",
        "max_speed": "it has its old value, but disk full",
    }
    assert not outcome.complete


def test_only_what_is_back_is_settled(journal: Journal, drive: Drawer, settings: Settings) -> None:
    settings.write("experiment", "max_torque", 2)
    settings.write("experiment", "max_speed", 4)
    drive.broken["write max_speed"] = WriteFailed("no")
    outcome = settings.restore()
    assert outcome.failed == {"max_speed": "no"}
    assert {row[0]: row[3] for row in state(journal, drive)} == {
        "max_torque": "restored", "max_speed": "verified",
    }  # fmt: skip


def test_what_was_reached_is_said_in_one_line() -> None:
    assert str(Restored()) == "nothing to restore"
    text = str(
        Restored(
            restored=["a", "1400h:01", "1600h:02"], already=["b"], skipped={"c": "why"},
            failed={"d": "x", "e": "y", "f": "x"},
        )
    )  # fmt: skip
    assert text == (
        "restored a, PDO parameters; at their old values already b; skipped c (why); "
        "failed d, f (x); failed e (y)"
    )


# -- exclusive access -----------------------------------------------------------------------------


@pytest.fixture
def locked(drive: Drawer) -> Drawer:
    drive.lock = {"max_speed": 1}
    return drive


def test_other_masters_are_locked_out_for_as_long_as_it_takes(
    locked: Drawer, settings: Settings
) -> None:
    with settings.exclusive_access():
        assert locked.values["max_speed"] == 1
    assert locked.values["max_speed"] == 0


def test_a_drive_without_a_lock_is_left_alone(drive: Drawer, settings: Settings) -> None:
    settings.write("experiment", "max_torque", 2)
    with settings.exclusive_access():
        pass
    assert drive.values["max_torque"] == 2


def test_a_lock_that_cannot_be_taken_off_is_said_with_or_without_another_error(
    locked: Drawer, settings: Settings
) -> None:
    locked_out = "other masters are still locked out of the drive: failed max_speed"
    with pytest.raises(WriteFailed, match=locked_out), settings.exclusive_access():
        locked.broken["write max_speed"] = WriteFailed("no")

    def breaks(error: Exception) -> None:
        locked.broken["write max_speed"] = WriteFailed("no")
        raise error

    locked.broken.clear()
    with pytest.raises(LinkLost, match=f"cable; {locked_out}"), settings.exclusive_access():
        breaks(LinkLost("cable"))
    locked.broken.clear()
    with pytest.raises(ZeroDivisionError) as other, settings.exclusive_access():
        breaks(ZeroDivisionError())
    assert other.value.args == ()


def test_an_error_inside_leaves_no_lock_and_is_what_it_was(
    locked: Drawer, settings: Settings
) -> None:
    with pytest.raises(LinkLost) as error, settings.exclusive_access():
        raise LinkLost("cable")
    assert str(error.value) == "cable"
    assert locked.values["max_speed"] == 0
