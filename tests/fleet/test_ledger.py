"""The ledger: an axis is started at most once a grant, whoever comes when."""

from __future__ import annotations

import itertools
import sqlite3
import threading
from pathlib import Path
from typing import NoReturn

import pytest

from commissioning.errors import JournalError
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.loading import load_fleet
from commissioning.fleet.plan import Fleet
from commissioning.fleet.rows import FleetRecord
from commissioning.fleet.taking_up import none_under_way
from commissioning.journal import Journal
from commissioning.result.fleet import ENDED, Confirmed, FleetAxis, JobState, Outcome, Room
from profiles.errors import Refused, UnknownName, UsageError
from tests.raising import raises

CONFIRMED = Confirmed("me", "2026-11-26T12:00:00+00:00", "typed", Room(1.0, 2.0, 3.0))
S = JobState


def begun(folder: Path, *names: str) -> tuple[Ledger, str]:
    ledger = Ledger(folder)
    run = ledger.begin(
        "line", (folder / "line.toml").resolve(), "identify", '{"axes": {}}', "me", names
    )
    return ledger, run


def nobody(record: FleetRecord) -> NoReturn:
    raise AssertionError("no axis of it is on a gateway")


def test_one_of_many_starts_and_the_others_must_not(tmp_path: Path) -> None:
    ledger, run = begun(tmp_path, "x")
    assert ledger.grant(run, "x", 1, CONFIRMED, "0x1")
    won: list[int] = []
    gate = threading.Barrier(8)

    def come(number: int) -> None:
        with Ledger(tmp_path) as mine:
            gate.wait()
            if number % 2:
                changed = mine.revoke(run, "x", 1, "taken over")
            else:
                changed = mine.start(run, "x", 1)
            if changed:
                won.append(number)

    with ledger:
        threads = [threading.Thread(target=come, args=(n,)) for n in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(won) == 1
        state = ledger.rows(run)["x"].state
        assert state is (S.STARTED if won[0] % 2 == 0 else S.REVOKED)


def of(folder: Path) -> Fleet:
    path = folder / "line.toml"
    path.write_text('job = "identify"\n[[axes]]\nname = "x"\nlink = "virtual://bench"\n', "utf-8")
    return load_fleet(path)


@pytest.mark.parametrize("state", [s for s in S if s is not S.GRANTED])
def test_only_what_is_granted_is_started(state: JobState, tmp_path: Path) -> None:
    ledger, run = begun(tmp_path, "x")
    with ledger:
        ledger.move(run, "x", 1, state)
        assert not ledger.start(run, "x", 1)
        assert ledger.rows(run)["x"].state is state


@pytest.mark.parametrize("state", sorted(ENDED | {S.GRANTED, S.STARTED}))
def test_what_has_ended_or_is_under_way_is_not_granted(state: JobState, tmp_path: Path) -> None:
    ledger, run = begun(tmp_path, "x")
    with ledger:
        ledger.move(run, "x", 1, state)
        assert not ledger.grant(run, "x", 1, CONFIRMED, "0x1")


def test_a_late_process_of_an_attempt_before_finds_it_revoked(tmp_path: Path) -> None:
    ledger, run = begun(tmp_path, "x")
    with ledger:
        ledger.grant(run, "x", 1, CONFIRMED, "0x1")
        none_under_way(of(tmp_path), ledger, nobody)
        ledger.again(run, {"x": 1})
        assert ledger.grant(run, "x", 2, CONFIRMED, "0x1")
        assert not ledger.start(run, "x", 1)
        assert ledger.start(run, "x", 2)


def test_what_was_started_and_has_no_process_is_unknown(tmp_path: Path) -> None:
    ledger, run = begun(tmp_path, "x", "y")
    with ledger:
        for name in "xy":
            ledger.grant(run, name, 1, CONFIRMED, "0x1")
            ledger.start(run, name, 1)
        with raises(Refused, "run.in-progress"):
            none_under_way(of(tmp_path), ledger, nobody)  # it is this very process
        with sqlite3.connect(tmp_path / "journal.sqlite") as db:
            db.execute("UPDATE fleet_axes SET boot='another' WHERE axis='x'")
            db.execute("UPDATE fleet_axes SET started=started+100 WHERE axis='y'")
        db.close()
        none_under_way(of(tmp_path), ledger, nobody)
        assert {row.state for row in ledger.rows(run).values()} == {S.UNKNOWN}


def test_each_transition_is_an_event_with_its_reason(tmp_path: Path) -> None:
    ledger, run = begun(tmp_path, "x")
    with ledger:
        ledger.move(run, "x", 1, S.WAITING)
        ledger.grant(run, "x", 1, CONFIRMED, "0x1")
        ledger.start(run, "x", 1)
        ledger.end(run, "x", 1, S.FAULT, Outcome(run="r"), "it tripped")
        told = [text for _, _, _, text in ledger.events(run)]
        assert told == ["waiting", "granted", "started", "fault: it tripped"]
        row = ledger.rows(run)["x"]
        assert (row.run, row.confirmed, row.why) == ("r", CONFIRMED, "it tripped")


def test_ids_are_told_apart_within_a_second(tmp_path: Path) -> None:
    with Ledger(tmp_path) as ledger:
        runs = [ledger.begin("line", tmp_path, "identify", "{}", "me", ["x"]) for _ in range(4)]
        assert len(set(runs)) == 4
        assert ledger.record("last").id == runs[-1]
        with pytest.raises(UnknownName):
            ledger.record("another")


@pytest.mark.parametrize("column", ["confirmed", "outcome", "state"])
def test_a_damaged_row_is_said_and_not_guessed(column: str, tmp_path: Path) -> None:
    ledger, run = begun(tmp_path, "x")
    with ledger:
        with sqlite3.connect(tmp_path / "journal.sqlite") as db:
            db.execute(f"UPDATE fleet_axes SET {column}='[1'")
        db.close()
        with pytest.raises(JournalError):
            ledger.rows(run)


def test_a_journal_of_before_is_read_and_extended(tmp_path: Path) -> None:
    with Journal(tmp_path):
        pass
    with sqlite3.connect(tmp_path / "journal.sqlite") as db:
        for name in ("fleet_events", "fleet_axes", "fleet_runs"):
            db.execute(f"DROP TABLE {name}")
    db.close()
    with Ledger(tmp_path, reading=True) as ledger, pytest.raises(UsageError, match="no fleet run"):
        ledger.record("last")
    ledger, run = begun(tmp_path, "x")
    ledger.close()
    with Ledger(tmp_path, reading=True) as ledger:
        assert ledger.rows(run)["x"].state is S.PLANNED


def test_the_way_of_an_axis_by_every_pair_of_states(tmp_path: Path) -> None:
    """`end` ends what was started, and nothing else."""
    ledger, run = begun(tmp_path, *(str(s) for s in S))
    with ledger:
        for state, end in itertools.product(S, (S.DONE, S.FAULT)):
            ledger.again(run, {str(state): ledger.rows(run)[str(state)].attempt})
            attempt = ledger.rows(run)[str(state)].attempt
            ledger.move(run, str(state), attempt, state)
            changed = ledger.end(run, str(state), attempt, end, Outcome(), "")
            assert changed == (state is S.STARTED)


def test_how_an_axis_stands_comes_before_why_it_is_not_done() -> None:
    outcome = Outcome(run="r", ending="axis at rest and off; settings put back", at_rest=True)
    stopped = FleetAxis("a", S.STOPPED, 1, "", why="interrupted", outcome=outcome)
    assert stopped.what == "axis at rest and off; interrupted"
    assert FleetAxis("a", S.REFUSED, 1, "", why="no", outcome=Outcome()).what == "no"
    assert FleetAxis("a", S.STARTED, 1, "", doing="measuring", why="x").what == "measuring"
