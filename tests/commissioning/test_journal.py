"""The journal and what restore makes of it."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from commissioning import journal_file
from commissioning.errors import JournalError
from commissioning.journal import RESTORED, STORED, STORING, Journal
from commissioning.records import RunContext, history_of, history_tree
from commissioning.settings import Settings, put_back, settle
from drivers.drive import Drive, Value
from drivers.errors import LinkLost
from drivers.link import axis_of, open_drive
from profiles.errors import UnknownName, UsageError
from tests.command import ROOT


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal(tmp_path / "journal") as opened:
        yield opened


@pytest.fixture
def drive() -> Iterator[Drive]:
    opened = open_drive(axis_of("virtual://bench"))
    yield opened
    opened.close()


def begin(journal: Journal, serial: str = "1") -> str:
    return journal.begin(
        axis="bench", link="virtual://bench", profile="p", profile_hash="h", serial=serial,
        context=RunContext("{}"),
    )  # fmt: skip


def test_an_intent_is_there_before_the_write_and_says_how_far_it_got(
    journal: Journal, drive: Drive
) -> None:
    run = begin(journal)
    settings = Settings(journal, run, drive)
    assert settings.write("compensation", "coulomb_positive", 87)
    assert not settings.write("compensation", "coulomb_positive", 87), "it had it already"
    (intent,) = journal.intents(run)
    assert (intent.old, intent.new, intent.state) == (0, 87, "verified")


def test_a_write_that_fails_leaves_its_intent_open(journal: Journal, drive: Drive) -> None:
    run = begin(journal)
    settings = Settings(journal, run, drive)

    def dead(name: str, raw: int) -> None:
        raise LinkLost("cable")

    drive.write = dead  # type: ignore[method-assign]
    with pytest.raises(LinkLost):
        settings.write("experiment", "max_torque", 500)
    (intent,) = journal.intents(run, open_only=True)
    assert intent.state == "intended"
    assert journal.unfinished("1", lambda link: True) == [run]


def test_restore_goes_back_to_the_oldest_value(journal: Journal, drive: Drive) -> None:
    run = begin(journal)
    settings = Settings(journal, run, drive)
    for value in (50, 60, 70):
        settings.write("compensation", "coulomb_positive", value)
    outcome = put_back(drive, journal.intents(run, open_only=True))
    settle(journal, journal.intents(run), outcome)
    assert outcome.restored == ["coulomb_positive"]
    assert drive.read("coulomb_positive").raw == 0
    assert journal.intents(run, open_only=True) == []


def test_restore_leaves_somebody_else_s_value_alone(journal: Journal, drive: Drive) -> None:
    run = begin(journal)
    Settings(journal, run, drive).write("compensation", "coulomb_positive", 50)
    drive.write("coulomb_positive", 99)
    intents = journal.intents(run, open_only=True)
    outcome = put_back(drive, intents)
    assert not outcome.complete
    assert "neither the old 0 nor" in str(outcome)
    assert drive.read("coulomb_positive").raw == 99
    assert put_back(drive, intents, force=True).complete
    assert drive.read("coulomb_positive").raw == 0


def test_restore_on_a_dead_link_names_every_parameter(journal: Journal, drive: Drive) -> None:
    run = begin(journal)
    settings = Settings(journal, run, drive)
    settings.write("experiment", "max_torque", 500)
    settings.write("experiment", "watchdog_time", 20)

    def dead(name: str) -> Value:
        raise LinkLost("cable")

    drive.read = dead  # type: ignore[method-assign]
    outcome = settings.restore()
    assert set(outcome.failed) == {"max_torque", "watchdog_time"}


def test_the_last_run_and_the_last_with_anything_to_restore(journal: Journal, drive: Drive) -> None:
    with pytest.raises(UnknownName):
        journal.run("last")
    first = begin(journal)
    Settings(journal, first, drive).write("compensation", "coulomb_positive", 50)
    second = begin(journal)
    assert journal.run("last").id == second
    assert journal.open_runs() == [first]
    with pytest.raises(UnknownName, match=first):
        journal.run("nosuch")


def test_a_run_moves_to_another_machine(journal: Journal, drive: Drive, tmp_path: Path) -> None:
    run = begin(journal)
    Settings(journal, run, drive).write("compensation", "coulomb_positive", 50)
    journal.note(run, "a note")
    tree = json.loads(json.dumps(history_tree(journal.history(run))))
    with Journal(tmp_path / "other") as other:
        assert other.adopt(history_of(tree, "x")) == run
        assert other.adopt(history_of(tree, "x")) == run, "twice is once"
        intents = other.intents(run, open_only=True)
        assert [(i.parameter, i.old, i.new) for i in intents] == [("coulomb_positive", 0, 50)]


@pytest.mark.parametrize("tree", [None, [], {}, {"schema": "tworelay.journal/1"}, {"schema": 5}])
def test_what_is_no_exported_run_is_refused(tree: object) -> None:
    with pytest.raises(UsageError, match="no exported run"):
        history_of(tree, "x.json")


def test_a_journal_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(JournalError, match="cannot be written"):
        Journal(blocked / "home")


def test_a_damaged_journal_says_so(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").write_bytes(b"this is no database" * 100)
    with pytest.raises(JournalError):
        Journal(tmp_path)


def test_many_processes_may_open_a_new_journal_at_once(tmp_path: Path) -> None:
    code = "from pathlib import Path; from commissioning.journal import Journal; import sys\n"
    code += "for n in range(8): Journal(Path(sys.argv[1]) / str(n)).close()\n"
    done = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path)], stderr=subprocess.PIPE, cwd=ROOT
        )
        for _ in range(4)
    ]
    for process in done:
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors.decode()


def test_stores_are_counted_for_each_drive(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        mine, other = (
            journal.begin(
                axis="x",
                link="virtual://bench",
                profile="p",
                profile_hash="h",
                serial=serial,
                context=RunContext("{}"),
            )
            for serial in ("0x1", "0x2")
        )
        assert stored(journal, mine, other, mine, mine) == [1, 1, 2, 3]
        journal.note(mine, STORING)
        assert journal.stores(mine) == 3, "it is counted when it was done"


# -- what only shows when something is odd --------------------------------------------------------


def test_a_journal_makes_the_folders_that_it_needs(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    Journal(folder).close()
    Journal(folder).close()
    assert (folder / "journal.sqlite").exists()


def test_a_journal_of_a_newer_version_is_left_alone(tmp_path: Path) -> None:
    Journal(tmp_path).close()
    with contextlib.closing(sqlite3.connect(tmp_path / "journal.sqlite")) as other:
        other.execute("PRAGMA user_version=99")
    with pytest.raises(JournalError, match=r"written by a newer tworelay \(schema 99\)"):
        Journal(tmp_path)


def test_a_journal_is_closed_behind_its_block_and_is_durable_within(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        asked = [journal._db.execute(f"PRAGMA {name}").fetchone()[0] for name in PRAGMAS]
    assert asked == ["wal", 2, 1, 1], "2: each transaction is on the disk when it returns"
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        journal._db.execute("SELECT 1")


PRAGMAS = ("journal_mode", "synchronous", "foreign_keys", "user_version")


class _Busy:
    """A database that another process holds for so many tries."""

    def __init__(self, tries: int) -> None:
        self.left, self.asked = tries, 0

    def execute(self, text: str) -> _Busy:
        if text == "PRAGMA journal_mode":
            return self
        assert text == "PRAGMA journal_mode=WAL"
        self.asked += 1
        self.left -= 1
        if self.left >= 0:
            raise sqlite3.OperationalError("database is locked")
        return self

    def fetchone(self) -> tuple[str]:
        return ("delete",)


def test_the_switch_to_a_write_ahead_log_waits_for_another_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pauses: list[float] = []
    monkeypatch.setattr("commissioning.journal_file.time.sleep", pauses.append)
    busy = cast("Any", _Busy(3))
    journal_file._write_ahead(busy)
    assert (busy.asked, pauses) == (4, [0.05] * 3)
    busy = cast("Any", _Busy(1000))
    pauses.clear()
    with pytest.raises(sqlite3.OperationalError, match="locked"):
        journal_file._write_ahead(busy)
    assert (busy.asked, len(pauses)) == (200, 199)


def test_a_write_that_fails_half_way_leaves_nothing_and_the_journal_usable(
    journal: Journal, drive: Drive
) -> None:
    run = begin(journal)
    Settings(journal, run, drive).write("compensation", "coulomb_positive", 50)
    (intent,) = journal.intents(run)
    with pytest.raises(JournalError):
        journal.settle([intent.seq, cast("int", object())], "restored")
    assert journal.intents(run, open_only=True) == [intent], "all of them, or none"
    journal.settle([intent.seq], "restored")
    assert journal.intents(run, open_only=True) == []


def test_a_name_that_is_no_text_is_a_mistake_of_its_user(journal: Journal) -> None:
    with pytest.raises(UsageError, match="no valid text"):
        journal.run("\ud800")


def test_runs_of_one_second_have_names_of_their_own(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("commissioning.journal.time.time", lambda: 1_000_000_000.0)
    first, second, third = (begin(journal) for _ in range(3))
    assert (second, third) == (f"{first}-1", f"{first}-2")
    monkeypatch.setattr("commissioning.journal._RUNS_A_SECOND", 3)
    with pytest.raises(JournalError, match="no free run id within this second"):
        begin(journal)
    assert journal.run(second).status == "running"
    journal.finish(second, "completed")
    assert journal.run(second).status == "completed"
    assert journal.run(first).status == "running"


def test_a_run_whose_values_or_fields_are_none_is_not_taken_in(
    journal: Journal, drive: Drive, tmp_path: Path
) -> None:
    run = begin(journal)
    Settings(journal, run, drive).write("compensation", "coulomb_positive", 50)
    tree = json.loads(json.dumps(history_tree(journal.history(run))))
    with Journal(tmp_path / "other") as other:
        for change, words in (
            ({"old": 2**63}, "must be less than"), ({"new": -(2**63)}, "must be greater than"),
            ({"old": "x"}, "must be a valid integer"),
        ):  # fmt: skip
            bad = json.loads(json.dumps(tree))
            bad["intents"][0] |= change
            with pytest.raises(UsageError, match=words):
                other.adopt(history_of(bad, "x"))
        edge = json.loads(json.dumps(tree))
        edge["run"]["axis"] = 5
        with pytest.raises(UsageError, match=r"'run.axis' must be a valid string"):
            other.adopt(history_of(edge, "x"))
        with pytest.raises(UsageError, match="schema"):
            history_of({**tree, "schema": "tworelay.journal/2"}, "x")
        with pytest.raises(UnknownName):
            other.run("last")
        edge = json.loads(json.dumps(tree))
        edge["intents"][0]["old"] = 2**63 - 1
        assert other.adopt(history_of(edge, "x")) == run
        assert other.intents(run)[0].old == 2**63 - 1


def test_only_experiment_settings_that_are_not_back_make_a_run_unfinished(
    journal: Journal, drive: Drive
) -> None:
    run, other = begin(journal, "1"), begin(journal, "2")
    Settings(journal, run, drive).write("compensation", "coulomb_positive", 50)
    assert journal.unfinished("1", lambda link: True) == []
    assert journal.open_runs() == [run]
    assert journal.last_written() == run
    settings = Settings(journal, other, drive)
    settings.write("experiment", "max_torque", 500)
    assert journal.unfinished("2", lambda link: True) == [other]
    assert journal.unfinished("1", lambda link: True) == []
    assert journal.last_written() == other
    settings.restore()
    assert journal.unfinished("2", lambda link: True) == []
    assert journal.open_runs() == [run]
    assert journal.last_written() == other, "restored, and yet it wrote"


def test_a_journal_that_wrote_nothing_has_no_last_writer(journal: Journal) -> None:
    begin(journal)
    assert journal.last_written() is None
    assert journal.open_runs() == []


def test_what_a_run_did_last_to_the_memory_is_known(journal: Journal) -> None:
    run, other = begin(journal), begin(journal)
    for text, memory in (
        ("begun", ""), (STORING, STORING), ("guardian: the loop has died", STORING), (STORED,
        STORED),
        ("anything", STORED), (STORING, STORING), (RESTORED, RESTORED),
    ):  # fmt: skip
        journal.note(run, text)
        assert journal.memory(run) == memory
    assert journal.memory(other) == ""


def test_what_a_run_did_to_the_memory_moves_with_it(journal: Journal, tmp_path: Path) -> None:
    """Else `restore` on another machine would leave its values in a memory."""
    run = begin(journal)
    journal.note(run, STORING)
    journal.note(run, STORED)
    with Journal(tmp_path / "another") as other:
        other.adopt(journal.history(run))
        assert other.memory(run) == STORED
        assert other.history(run).events[:-1] == journal.history(run).events


def stored(journal: Journal, *runs: str) -> list[int]:
    """How often each drive has stored, after each store."""
    counts: list[int] = []
    for run in runs:
        journal.note(run, STORED if len(counts) % 2 else RESTORED)
        counts.append(journal.stores(run))
    return counts


@pytest.mark.parametrize("serial", ["", "0x00000000"])
def test_stores_of_drives_without_a_serial_are_counted_by_link(tmp_path: Path, serial: str) -> None:
    with Journal(tmp_path) as journal:
        mine, other = (
            journal.begin(
                axis="x",
                link=link,
                profile="p",
                profile_hash="h",
                serial=serial,
                context=RunContext("{}"),
            )
            for link in ("modbus-tcp://a", "modbus-tcp://b")
        )
        assert stored(journal, mine, mine, other) == [1, 2, 1]
