"""Homes of several computers become one: runs, names and notes, each on the axis that it is of."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.home import home
from tests.conftest import Tworelay
from tests.history.test_commands import names, story


def test_merging_two_homes_loses_nothing(
    tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both measured an axis of one name in one second, on computers of one name."""
    now = float(int(time.time())) + 0.5  # both within one second
    monkeypatch.setattr("commissioning.journal.time.time", lambda: now)
    other = {"TWORELAY_HOME": str(tmp_path / "other")}
    for where in ({}, other):
        done = tworelay("identify", "virtual://bench", "--yes", environment=where)
        assert done.returncode == 0, done.stderr
        now += 0.01
    monkeypatch.undo()
    monkeypatch.setenv("TWORELAY_HOME", str(tmp_path / "home"))
    tworelay("identify", "virtual://bench?seed=2", "--yes", environment=other)
    note = tworelay("history", "note", "bench", "regreased", environment=other)
    assert note.returncode == 0, note.stderr
    theirs = story(tworelay, "bench", environment=other)
    ids = {one["run"] for one in theirs["runs"]}
    assert ids & {one["run"] for one in story(tworelay, "bench")["runs"]}, "of one id"
    done = tworelay("export", "--all", str(tmp_path / "sent"), environment=other)
    assert done.returncode == 0, done.stderr
    for _ in range(2):
        done = tworelay("adopt", str(tmp_path / "sent"), "--yes")
        assert done.returncode == 0, done.stderr
        merged = story(tworelay, "bench")
        assert len(merged["runs"]) == 3
        assert len({one["run"] for one in merged["runs"]}) == 3
        assert [one["text"] for one in merged["notes"]] == ["regreased"]
        wanted = [one["quantities"] for one in theirs["runs"]]
        there = [one["quantities"] for one in merged["runs"]]
        assert all(numbers in there for numbers in wanted)
    for one in merged["runs"]:
        assert tworelay("report", one["run"]).returncode == 0


def sent(tworelay: Tworelay, tmp_path: Path, host: str = "plc7") -> Path:
    """All runs of this home, as of another computer, and no run here any more."""
    folder = tmp_path / "sent"
    done = tworelay("export", "--all", str(folder))
    assert done.returncode == 0, done.stderr
    for path in folder.glob("*/run.json"):
        tree = json.loads(path.read_text())
        path.write_text(json.dumps({**tree, "host": host}))
        journal = path.with_name("journal.json")
        tree = json.loads(journal.read_text())
        tree["notes"] = [{**note, "host": host} for note in tree["notes"]]
        journal.write_text(json.dumps(tree))
    shutil.rmtree(home())
    return folder


def test_name_and_notes_go_along(tworelay: Tworelay, tmp_path: Path) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    tworelay("history", "rename", "bench", "press")
    tworelay("history", "note", "press", "new belt")
    folder = sent(tworelay, tmp_path)
    assert tworelay("adopt", str(folder), "--yes").returncode == 0
    there = story(tworelay, "press")
    assert len(there["runs"]) == 1
    assert [one["text"] for one in there["notes"]] == ["new belt"]
    (run,) = (home() / "runs").iterdir()
    assert json.loads((run / "run.json").read_text())["axis"] == "press"
    assert tworelay("apply", run.name, "--yes").returncode == 0


def test_an_axis_of_another_computer_has_notes_of_ours(tworelay: Tworelay, tmp_path: Path) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    folder = sent(tworelay, tmp_path)
    tworelay("adopt", str(folder), "--yes")
    for asked in ("bench", "bench@plc7"):
        assert tworelay("history", "note", asked, f"by {asked}").returncode == 0
    texts = [one["text"] for one in story(tworelay, "bench@plc7")["notes"]]
    assert texts == ["by bench", "by bench@plc7"]
    tworelay("identify", "virtual://bench?seed=3", "--yes")
    assert story(tworelay, "bench")["notes"] == [], "which is ours now"
    assert tworelay("history", "note", "bench@plc7", "by bench", "--remove").returncode == 0
    assert len(story(tworelay, "bench@plc7")["notes"]) == 1


@pytest.fixture
def at_host(
    tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., str]:
    """A command on another computer, with a home of its own."""

    def run(host: str, *words: str) -> str:
        monkeypatch.setattr("platform.node", lambda: host)
        done = tworelay(*words, environment={"TWORELAY_HOME": str(tmp_path / host)})
        monkeypatch.undo()
        monkeypatch.setenv("TWORELAY_HOME", str(tmp_path / "home"))
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def moved(at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path, host: str) -> None:
    """All runs of another computer are taken in here."""
    folder = tmp_path / f"from-{host}"
    shutil.rmtree(folder, ignore_errors=True)
    at_host(host, "export", "--all", str(folder))
    assert tworelay("adopt", str(folder), "--yes").returncode == 0


def test_our_names_are_not_theirs(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    """We rename our axis; theirs of that name, measured before and after, stays one axis."""
    tworelay("identify", "virtual://bench", "--yes")
    at_host("plc", "identify", "virtual://bench?seed=5", "--yes")
    moved(at_host, tworelay, tmp_path, "plc")
    tworelay("history", "rename", "bench", "press")
    at_host("plc", "identify", "virtual://bench?seed=5", "--yes")
    at_host("plc", "history", "note", "bench", "their note")
    moved(at_host, tworelay, tmp_path, "plc")
    theirs = story(tworelay, "bench@plc")
    assert len(theirs["runs"]) == 2
    assert [one["text"] for one in theirs["notes"]] == ["their note"]
    assert len(names(tworelay, "press")) == 1
    assert "press" in tworelay("history").stdout


def test_their_names_and_notes_are_ours_when_the_run_comes_again(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    at_host("plc", "identify", "virtual://bench?seed=5", "--yes")
    at_host("plc", "history", "note", "bench", "greased")
    moved(at_host, tworelay, tmp_path, "plc")
    at_host("plc", "history", "rename", "bench", "press")
    at_host("plc", "history", "note", "press", "belt")
    for _ in range(2):
        moved(at_host, tworelay, tmp_path, "plc")
        assert names(tworelay, "bench") == []
        there = story(tworelay, "press")
        assert len(there["runs"]) == 1
        assert [one["text"] for one in there["notes"]] == ["greased", "belt"]
    assert tworelay("report", there["runs"][0]["run"]).returncode == 0
    assert tworelay("apply", there["runs"][0]["run"], "--yes").returncode == 0


def test_all_runs_of_an_axis_that_was_renamed_there_follow(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    for _ in range(2):
        at_host("plc", "identify", "virtual://bench?seed=5", "--yes")
    at_host("plc", "history", "note", "bench", "greased")
    moved(at_host, tworelay, tmp_path, "plc")
    before = tmp_path / "before"
    shutil.copytree(tmp_path / "from-plc", before)
    at_host("plc", "history", "rename", "bench", "press")
    at_host("plc", "export", "last", str(tmp_path / "one"))
    assert tworelay("adopt", str(tmp_path / "one"), "--yes").returncode == 0
    assert tworelay("adopt", str(before), "--yes").returncode == 0, "an older export"
    there = story(tworelay, "press")
    assert len(there["runs"]) == 2
    assert [one["text"] for one in there["notes"]] == ["greased"]


def test_notes_of_one_day_on_two_axes_are_two(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    for axis in ("bench", "hsm150"):
        at_host("plc", "identify", f"virtual://{axis}", "--yes")
        at_host("plc", "history", "note", axis, "regreased", "--at", "2026-01-01")
    moved(at_host, tworelay, tmp_path, "plc")
    for axis in ("bench", "hsm150"):
        assert [one["text"] for one in story(tworelay, axis)["notes"]] == ["regreased"]


def test_a_home_that_was_restored_is_one_s_own(tworelay: Tworelay, tmp_path: Path) -> None:
    """Export, a new home on the same computer, adopt: names and notes are ours still."""
    tworelay("identify", "virtual://bench", "--yes")
    tworelay("history", "note", "bench", "greased")
    tworelay("export", "--all", str(tmp_path / "sent"))
    shutil.rmtree(home())
    tworelay("adopt", str(tmp_path / "sent"), "--yes")
    tworelay("history", "rename", "bench", "press")
    there = story(tworelay, "press")
    assert len(there["runs"]) == 1
    assert [one["text"] for one in there["notes"]] == ["greased"]


def test_what_others_noted_comes_back_to_the_present_name(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    tworelay("export", "last", str(tmp_path / "out"))
    at_host("plc", "adopt", str(tmp_path / "out"), "--yes")
    at_host("plc", "history", "note", "bench", "new belt")
    tworelay("history", "rename", "bench", "press")
    run = json.loads(at_host("plc", "history", "bench", "--json"))["runs"][0]["run"]
    at_host("plc", "export", run, str(tmp_path / "back"))
    done = tworelay("adopt", str(tmp_path / "back"))
    assert "on axis 'press' will be TAKEN IN" in done.stdout
    assert tworelay("adopt", str(tmp_path / "back"), "--yes").returncode == 0
    assert [one["text"] for one in story(tworelay, "press")["notes"]] == ["new belt"]


def test_one_drive_is_one_history_also_when_ours_is_renamed(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    at_host("plc", "identify", "virtual://bench", "--yes")
    moved(at_host, tworelay, tmp_path, "plc")
    assert len(names(tworelay, "bench")) == 2
    tworelay("history", "rename", "bench", "press")
    assert len(names(tworelay, "press")) == 2


def test_drift_looks_at_the_axes_of_all_computers(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    at_host("plc", "identify", "virtual://bench?seed=5", "--yes")
    moved(at_host, tworelay, tmp_path, "plc")
    rows = json.loads(tworelay("history", "drift", "--json").stdout)
    assert {one["axis"] for one in rows} == {"bench", "bench@plc"}


def test_one_s_own_runs_taken_in_again_add_no_note(tworelay: Tworelay, tmp_path: Path) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    tworelay("history", "note", "bench", "greased")
    tworelay("history", "rename", "bench", "press")
    tworelay("history", "note", "press", "belt")
    tworelay("export", "--all", str(tmp_path / "sent"))
    assert tworelay("adopt", str(tmp_path / "sent"), "--yes").returncode == 0
    assert [one["text"] for one in story(tworelay, "press")["notes"]] == ["greased", "belt"]


def test_a_run_goes_on_with_the_notes_of_its_own_axis(
    at_host: Callable[..., str], tworelay: Tworelay, tmp_path: Path
) -> None:
    """Ours and theirs have one name; what we noted on theirs goes back to them, and acts there."""
    tworelay("identify", "virtual://bench", "--yes")
    at_host("plc", "identify", "virtual://bench?seed=5", "--yes")
    moved(at_host, tworelay, tmp_path, "plc")
    tworelay("history", "note", "bench", "ours")
    tworelay("history", "note", "bench@plc", "on theirs")
    run = story(tworelay, "bench@plc")["runs"][0]["run"]
    folder = tmp_path / "back"
    assert tworelay("export", run, str(folder)).returncode == 0
    sent_notes = json.loads((folder / "journal.json").read_text())["notes"]
    assert [one["text"] for one in sent_notes] == ["on theirs"]
    at_host("plc", "adopt", str(folder), "--yes")
    found = json.loads(at_host("plc", "history", "bench", "--json"))
    assert [one["text"] for one in found["notes"]] == ["on theirs"]


def test_one_run_that_is_damaged_keeps_no_other_back(tworelay: Tworelay, tmp_path: Path) -> None:
    for _ in range(3):
        tworelay("identify", "virtual://bench", "--yes")
    broken = sorted((home() / "runs").iterdir())[1]
    (broken / "run.json").write_text("{")
    done = tworelay("export", "--all", str(tmp_path / "sent"))
    assert done.returncode == 2
    assert broken.name in done.stderr
    assert "2 run(s) exported" in done.stdout
    assert len(list((tmp_path / "sent").glob("*/journal.json"))) >= 2


def test_notes_on_a_run_that_is_known_are_asked_for(tworelay: Tworelay, tmp_path: Path) -> None:
    tworelay("identify", "virtual://bench", "--yes")
    folder = tmp_path / "sent"
    tworelay("export", "last", str(folder))
    tree = json.loads((folder / "journal.json").read_text())
    tree["notes"] = [{"at": 253402300799.0, "text": "hostile", "who": None, "host": None}]
    (folder / "journal.json").write_text(json.dumps(tree))
    done = tworelay("adopt", str(folder))
    assert done.returncode == 3
    assert story(tworelay, "bench")["notes"] == []
    assert tworelay("adopt", str(folder), "--yes").returncode == 0
    (note,) = story(tworelay, "bench")["notes"]
    assert note["at"][:2] == "20", "not of the year 9999"
