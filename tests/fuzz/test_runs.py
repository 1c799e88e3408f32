"""A run folder or a journal with something in it that we do not write: read, or one plain line."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import sqlite3
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from commissioning.cli import show
from commissioning.cli.terminal import Screen
from commissioning.errors import JournalError
from commissioning.journal import Journal
from commissioning.records import history_of
from commissioning.report.html import render
from commissioning.result.codec import decode
from commissioning.runs import RunFolder, as_of, resolve
from commissioning.session.named import axis_of_run
from commissioning.session.tune import DriveLoop, tune
from profiles.errors import TwoRelayError
from profiles.library import load_profile
from tests.command import ROOT, in_this_process
from tests.fuzz.mutation import fuzzed, mutated, slowly_fuzzed

PROFILE = load_profile("virtual-modbus")
WRONG: tuple[Any, ...] = (
    None, True, -1, 0, 0.0, 1e200, -1e-300, 10**18, 10**400, float("nan"), float("inf"), "",
    "x\x1b[2J", "9" * 99, [], {}, [1], {"a": 1}, "\ud800", [[[[]]]],
)  # fmt: skip


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, Any]]:
    """Result and journal of a commissioned and tuned run, its long rows cut short."""
    home, folder = tmp_path_factory.mktemp("home"), tmp_path_factory.mktemp("sent")
    for words in (
        ("commission", "virtual://bench", "--yes", "--points"), ("tune", "last"),
        ("export", "last", str(folder)),
    ):  # fmt: skip
        done = in_this_process(*words, environment={"TWORELAY_HOME": str(home)})
        assert done.returncode == 0, done.stderr
    result, journal = (
        json.loads((folder / f"{name}.json").read_text()) for name in ("run", "journal")
    )
    result["tuning"] = [result["tuning"][k] for k in (0, -1)]
    result["verification"]["steps"] = result["verification"]["steps"][:2]
    return result, journal


@pytest.fixture(scope="module")
def older() -> tuple[dict[str, Any], dict[str, Any]]:
    """The same, as version 0.1.0 wrote it."""
    folder = ROOT / "tests" / "recordings" / "runs_0_1" / "good"
    result, journal = (
        json.loads((folder / f"{name}.json").read_text()) for name in ("run", "journal")
    )
    result["tuning"] = [result["tuning"][k] for k in (0, -1)]
    result["verification"]["steps"] = result["verification"]["steps"][:2]
    for step in result["verification"]["steps"]:
        step["trace"] = {key: row[:9] for key, row in step["trace"].items()}
    return result, journal


def places(tree: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where there is anything in a tree: of a list, its two ends."""
    if way:
        yield way
    if isinstance(tree, dict):
        for key in tree:
            yield from places(tree[key], (*way, key))
    elif isinstance(tree, list):
        for k in sorted({0, len(tree) - 1}) if tree else ():
            yield from places(tree[k], (*way, k))


def put(tree: Any, way: tuple[Any, ...], value: Any) -> Any:
    changed = copy.deepcopy(tree)
    place = changed
    for key in way[:-1]:
        place = place[key]
    place[way[-1]] = value
    return changed


def read_by_all(result: dict[str, Any], journal: dict[str, Any]) -> None:
    """What reads a run; raises TwoRelayError."""
    found, _ = decode(result, "run.json")
    history = history_of(journal, "journal.json")
    found = as_of(found, history)
    folder = RunFolder(Path("nowhere"), history)
    with suppress(TwoRelayError):
        render(found, None, history)
    with contextlib.redirect_stderr(io.StringIO()):
        for tell in (show.summary, show.tuning, show.verification, show.outcome, show.ending):
            tell(found, Screen("-", yes=True))
    with suppress(TwoRelayError):
        axis = axis_of_run(history.run, folder, None)
        tune(found, axis, PROFILE, DriveLoop(None, None))


@given(st.data())
@slowly_fuzzed
def test_a_run_with_something_else_in_it(
    sent: tuple[dict[str, Any], dict[str, Any]],
    older: tuple[dict[str, Any], dict[str, Any]],
    data: st.DataObject,
) -> None:
    result, journal = data.draw(st.sampled_from((sent, older)))
    of_result = data.draw(st.booleans())
    tree = result if of_result else journal
    way = data.draw(st.sampled_from(list(places(tree))))
    changed = put(tree, way, data.draw(st.sampled_from(WRONG)))
    with suppress(TwoRelayError):
        read_by_all(changed if of_result else result, journal if of_result else changed)


def test_every_place_of_a_run_is_looked_at(
    sent: tuple[dict[str, Any], dict[str, Any]], older: tuple[dict[str, Any], dict[str, Any]]
) -> None:
    """NaN, infinity, what is no text and numbers without an end are refused wherever they stand."""
    for result, journal in (sent, older):
        for tree, check in ((result, decode), (journal, history_of)):
            for way in places(tree):
                for value in (float("nan"), float("-inf"), 10**400, "\ud800"):
                    if way[-1] == "written" and result is older[0]:
                        continue  # what the journal knows better
                    with pytest.raises(TwoRelayError) as caught:
                        check(put(tree, way, value), f"{way}")
                    assert len(str(caught.value).splitlines()) == 1, way


@given(mutated(b'{"schema": "tworelay.run/1", "a": [1.5, null], "b": {"c": "d"}}'))
@fuzzed
def test_what_is_hardly_json(tmp_path: Path, data: bytes) -> None:
    for name in ("run.json", "journal.json"):
        (tmp_path / name).write_bytes(data)
    with pytest.raises(TwoRelayError):
        RunFolder(tmp_path).result()
    with Journal(tmp_path / "home") as journal, pytest.raises(TwoRelayError):
        resolve(journal, str(tmp_path))


@given(st.data())
@slowly_fuzzed
def test_a_run_folder_whose_bytes_were_changed(
    sent: tuple[dict[str, Any], dict[str, Any]], tmp_path: Path, data: st.DataObject
) -> None:
    for name, tree in zip(("run.json", "journal.json"), sent, strict=True):
        text = json.dumps(tree).encode()
        (tmp_path / name).write_bytes(data.draw(mutated(text)))
    with Journal(tmp_path / "home") as journal, suppress(TwoRelayError):
        _, folder = resolve(journal, str(tmp_path))
        folder.result(folder.exported)


COLUMNS = {
    "runs": ("created", "axis", "link", "profile", "serial", "status", "context"),
    "intents": ("kind", "parameter", "old", "new", "state"),
}


@pytest.mark.parametrize("table", COLUMNS)
def test_a_damaged_journal_is_exit_7(table: str, tmp_path: Path) -> None:
    home = {"TWORELAY_HOME": str(tmp_path)}
    assert in_this_process("identify", "virtual://bench", "--yes", environment=home).returncode == 0
    assert in_this_process("apply", "last", "--yes", environment=home).returncode == 0
    for column in COLUMNS[table]:
        with contextlib.closing(sqlite3.connect(tmp_path / "journal.sqlite")) as db:
            old = db.execute(f"SELECT rowid, {column} FROM {table}").fetchall()
        for value in (b"\xff", -1.5, "x", "{", "[1]", 1e300, float("inf"), 1 << 62):
            with contextlib.closing(sqlite3.connect(tmp_path / "journal.sqlite")) as db:
                db.execute(f"UPDATE {table} SET {column}=?", (value,))
                db.commit()
            with suppress(TwoRelayError), Journal(tmp_path) as journal:
                journal.open_runs()
                journal.history("last")
        done = in_this_process("restore", "--dry-run", environment=home)
        damaged = column not in (
            "axis",
            "link",
            "status",
            "profile",
            "serial",
            "parameter",
            "old",
            "new",
        )
        assert done.returncode == (7 if damaged else done.returncode), (column, done.stderr)
        assert "internal error" not in done.stderr, (column, done.stderr)
        with contextlib.closing(sqlite3.connect(tmp_path / "journal.sqlite")) as db:
            db.executemany(f"UPDATE {table} SET {column}=? WHERE rowid=?", [(v, r) for r, v in old])
            db.commit()


@pytest.mark.parametrize(
    "now", [0.0, 4_300_000_000.0, 253_402_200_000.0], ids=["1970", "2106", "9999"]
)
def test_whatever_the_clock_says_the_job_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, now: float
) -> None:
    """A battery that is empty, or a year that no zip file knows."""
    monkeypatch.setattr("time.time", lambda: now + time.monotonic() % 1000)
    home = {"TWORELAY_HOME": str(tmp_path)}
    for words in (
        ("commission", "virtual://bench", "--yes"), ("report", "last"), ("tune", "last"),
        ("export", "last", str(tmp_path / "x")), ("plot", "loci", "last"), ("restore", "--yes"),
    ):  # fmt: skip
        done = in_this_process(*words, environment=home)
        assert done.returncode == 0, (words, done.stderr)


@pytest.mark.parametrize("now", [-1.0, 253_402_300_800.0, 9e15])
def test_a_clock_beyond_all_years_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, now: float
) -> None:
    monkeypatch.setattr("time.time", lambda: now)
    done = in_this_process(
        "identify", "virtual://bench", "--yes", environment={"TWORELAY_HOME": str(tmp_path)}
    )
    assert done.returncode == 3
    assert "clock stands at" in done.stderr


@given(mutated(b"SQLite format 3\x00" + bytes(200), b"", bytes(5000)))
@fuzzed
def test_a_journal_that_is_no_database(tmp_path: Path, data: bytes) -> None:
    for path in tmp_path.glob("journal.sqlite*"):
        path.unlink()
    (tmp_path / "journal.sqlite").write_bytes(data)
    with suppress(JournalError), Journal(tmp_path) as journal:
        journal.open_runs()
