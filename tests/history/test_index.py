"""The index says what the runs say, and is made anew where it is lost."""

from __future__ import annotations

import json
import random
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest

from commissioning.history.catching_up import catch_up
from commissioning.history.story import story_of
from commissioning.index import Index
from commissioning.journal import Journal
from commissioning.records import RunContext
from commissioning.result.document import RunResult
from commissioning.result.experiment import Conditions
from commissioning.result.found import Quantity
from commissioning.runs import RunFolder
from drivers.home import home
from tests.conftest import Tworelay
from tests.result.test_codec import NAMES, recorded

OF_0_1 = [name for name in NAMES if recorded(name)[0].quality.verdict in ("good", "usable")]


def begun(journal: Journal, axis: str = "x", serial: str = "0x1") -> str:
    return journal.begin(
        axis=axis, link="modbus-tcp://127.0.0.1:502", profile="p", profile_hash="h", serial=serial,
        context=RunContext("{}"),
    )  # fmt: skip


def saved(journal: Journal, result: RunResult, axis: str = "x") -> str:
    run = begun(journal, axis)
    RunFolder.of(journal, run).save(replace(result, run=run, axis=axis))
    return run


def forget(journal: Journal) -> None:
    """As an older version left it."""
    for table in ("indexed", "results", "conditions"):
        journal._db.execute(f"DELETE FROM {table}")


@pytest.mark.parametrize("name", OF_0_1)
def test_what_a_run_measured_is_in_the_index(name: str) -> None:
    result, _ = recorded(name)
    with Journal(home()) as journal:
        run = saved(journal, result)
        (entry,), damaged = journal.entries(["x"])
    assert not damaged
    assert entry.run == run
    assert entry.method == result.friction.method
    assert entry.verdict == result.quality.verdict
    for quantity, found in entry.quantities.items():
        there: Quantity = getattr(result.friction, quantity)
        assert (found.value, found.low, found.high, found.unit) == (
            there.value, there.low, there.high, there.unit,
        )  # fmt: skip
    assert entry.conditions.cycle == result.experiment.cycle


def test_conditions_come_back() -> None:
    seen = Conditions(41.5, 50.0, 12.0, -0.25, 2, 0.001)
    with Journal(home()) as journal:
        saved(journal, replace(recorded(OF_0_1[0])[0], conditions=seen))
        (entry,), _ = journal.entries(["x"])
    assert entry.conditions == seen


HARM = {
    "a value": "UPDATE results SET value = value * 1.1",
    "a text for a value": "UPDATE results SET value = 'much'",
    "a blob": "UPDATE results SET low = x'00ff'",
    "a number gone": "DELETE FROM results WHERE quantity = 'coulomb'",
    "the numbers gone": "DELETE FROM results",
    "conditions gone": "DELETE FROM conditions",
    "a verdict": "UPDATE indexed SET verdict = 'good ' || 1",
    "a digest": "UPDATE indexed SET digest = NULL",
    "rows gone": "DELETE FROM indexed",
    "a table gone": "DROP TABLE results",
    "no text": "UPDATE results SET quantity = CAST(x'ff' AS TEXT) WHERE quantity = 'coulomb' "
    "AND run = (SELECT MAX(run) FROM results)",
    "another table": "DROP TABLE results; CREATE TABLE results (a, b)",
    "conditions of another shape": "DROP TABLE conditions; CREATE TABLE conditions (run)",
}


@pytest.mark.parametrize("readable", [False, True], ids=["made anew", "not to be written"])
@pytest.mark.parametrize("harm", HARM)
def test_a_damaged_index_is_made_anew_from_the_runs(
    harm: str, readable: bool, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Journal(home()) as journal:
        for name in OF_0_1[:3]:
            saved(journal, recorded(name)[0])
        before = journal.entries(["x"])[0]
    with sqlite3.connect(home() / "journal.sqlite") as db:
        db.executescript(HARM[harm])
    db.close()
    if readable:  # as where the disk is read-only
        monkeypatch.setattr("commissioning.history.story.catch_up", lambda runs: None)
    with Journal(home(), reading=True) as journal:
        story = story_of(journal, "x")
    assert [one.quantities for one in story.entries] == [one.quantities for one in before]
    if not readable:
        with Journal(home(), reading=True) as journal:
            entries, damaged = journal.entries(["x"])
        assert (entries, damaged) == (before, [])
    assert tworelay("history", "x", "--json").returncode == 0


def test_runs_of_an_older_version_are_indexed_once(tworelay: Tworelay) -> None:
    with Journal(home()) as journal:
        run = saved(journal, recorded(OF_0_1[0])[0])
        forget(journal)
        assert journal.not_indexed() == [run]
    shown = json.loads(tworelay("history", "x", "--json").stdout)
    assert shown["runs"][0]["quantities"]["coulomb"]["value"]
    with Journal(home(), reading=True) as journal:
        assert journal.not_indexed() == []


def test_a_run_that_was_just_measured_is_sound_in_the_index(tworelay: Tworelay) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    with Journal(home(), reading=True) as journal:
        (entry,), damaged = journal.entries(["bench"])
    assert not damaged
    assert entry.method == "output-error"
    assert entry.conditions.motor_temperature == 25.0
    assert entry.host


@pytest.mark.parametrize(
    "before", ["sound", "of an older version", "conditions lost", "mark lost", "minus zero"]
)
def test_numbers_outlive_the_files(before: str, tworelay: Tworelay) -> None:
    warm = "-0.0" if before == "minus zero" else "31"
    tworelay("identify", "virtual://bench", "--yes", "--motor-temperature", warm)
    with Journal(home()) as journal:
        if before == "of an older version":
            forget(journal)
    assert tworelay("history", "prune", "--before", "0d", "--yes").returncode == 0
    assert not list((home() / "runs").iterdir())
    if before == "conditions lost":
        with Journal(home()) as journal:
            journal._db.execute("DROP TABLE conditions")
    if before == "mark lost":
        with Journal(home()) as journal:
            journal._db.execute("DELETE FROM indexed")
    for words in (("history", "bench"), ("history", "reindex"), ("history", "bench", "--json")):
        done = tworelay(*words)
        assert done.returncode == 0, done.stderr
    (run,) = json.loads(done.stdout)["runs"]
    if before == "mark lost":  # what cannot be vouched for is not shown, and not deleted
        with Journal(home(), reading=True) as journal:
            assert journal._db.execute("SELECT COUNT(*) FROM results").fetchone()[0] >= 5
        return
    assert run["quantities"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    known = None if before == "conditions lost" else float(warm)
    assert run["conditions"]["motor_temperature"] == known
    assert "0.1" in tworelay("history").stdout


def test_a_run_whose_file_is_damaged_keeps_its_numbers(tworelay: Tworelay) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    (folder,) = (home() / "runs").iterdir()
    (folder / "run.json").write_text("{")
    done = tworelay("history", "reindex")
    assert "0 runs indexed; 1 have no files that can be read" in done.stdout
    (run,) = json.loads(tworelay("history", "bench", "--json").stdout)["runs"]
    assert run["verdict"] == "files damaged"
    assert run["quantities"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)


def test_files_that_are_missing_are_told_and_end_nothing(tworelay: Tworelay) -> None:
    with Journal(home()) as journal:
        run = saved(journal, recorded(OF_0_1[0])[0])
        saved(journal, recorded(OF_0_1[1])[0])
        forget(journal)
    shutil.rmtree(home() / "runs" / run)
    shown = json.loads(tworelay("history", "x", "--json").stdout)["runs"]
    assert shown[0]["verdict"] == "files missing"
    assert not shown[0]["quantities"]
    assert shown[1]["quantities"]


def test_notes_are_kept_when_the_index_is_made_anew(tworelay: Tworelay) -> None:
    with Journal(home()) as journal:
        saved(journal, recorded(OF_0_1[0])[0])
    assert tworelay("history", "note", "x", "regreased").returncode == 0
    assert tworelay("history", "reindex").returncode == 0
    (note,) = json.loads(tworelay("history", "x", "--json").stdout)["notes"]
    assert note["text"] == "regreased"


def test_two_processes_open_an_old_journal_at_once(tmp_path: Path) -> None:
    """The index that one of them has made is not dropped by the other."""
    first = Index(tmp_path)
    first.index("r", recorded(OF_0_1[0])[0])
    with Index(tmp_path) as second:
        assert second._db.execute("SELECT COUNT(*) FROM indexed").fetchone()[0] == 1
    first.close()


@pytest.mark.parametrize("seed", range(4))
def test_any_order_of_indexing_gives_the_same(seed: int) -> None:
    shuffled = random.Random(seed)
    with Journal(home()) as journal:
        made = [saved(journal, recorded(name)[0]) for name in OF_0_1]
        before = journal.entries(["x"])
        forget(journal)
        runs = list(made)
        shuffled.shuffle(runs)
    assert catch_up(runs) == len(runs)
    with Journal(home(), reading=True) as journal:
        assert journal.entries(["x"]) == before
