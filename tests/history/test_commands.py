"""history, note, rename, compare, export and adopt, as a user types them."""

from __future__ import annotations

import csv
import io
import json
import sqlite3
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from commissioning.journal import Journal
from commissioning.result.found import Quantity
from commissioning.runs import RunFolder
from drivers.home import home
from tests.conftest import Tworelay
from tests.history.test_index import OF_0_1, begun, saved
from tests.result.test_codec import recorded


def story(tworelay: Tworelay, axis: str, *words: str, **where: Any) -> Any:
    done = tworelay("history", axis, "--json", *words, **where)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def made(values: list[float], axis: str = "x") -> list[str]:
    """Runs that measured these frictions."""
    result, _ = recorded(OF_0_1[0])
    found = []
    with Journal(home()) as journal:
        for value in values:
            number = Quantity(value, 0.98 * value, 1.02 * value, "N.m")
            friction = replace(result.friction, coulomb=number)
            found.append(saved(journal, replace(result, friction=friction), axis))
    return found


def test_the_history_of_an_axis_has_numbers_notes_and_drives(tworelay: Tworelay) -> None:
    made([0.1, 0.101])
    assert tworelay("history", "note", "x", "new belt").returncode == 0
    with Journal(home()) as journal:
        run = begun(journal, serial="0x2")
        result, _ = recorded(OF_0_1[0])
        RunFolder.of(journal, run).save(replace(result, run=run, axis="x"))
    shown = story(tworelay, "x")
    assert [one["quantities"]["coulomb"]["value"] for one in shown["runs"][:2]] == [0.1, 0.101]
    assert [one["serial"] for one in shown["drives"]] == ["0x1", "0x2"]
    assert shown["drives"][0]["until_run"] == shown["runs"][1]["run"]
    assert [one["text"] for one in shown["notes"]] == ["new belt"]
    text = tworelay("history", "x").stdout
    assert "drive exchanged:" in text
    assert f"after {shown['runs'][1]['run']}: note: new belt" in text
    assert "\\n" not in text
    assert run in text


def test_a_picture_and_lines_for_a_spreadsheet(tworelay: Tworelay, tmp_path: Path) -> None:
    made([0.1, 0.1, 0.13])
    assert tworelay("history", "note", "x", "=cmd|calc").returncode == 0
    for name in ("a.svg", "a.png", "a.pdf"):
        done = tworelay("history", "x", "--picture", str(tmp_path / name))
        assert done.returncode == 0, done.stderr
        assert (tmp_path / name).stat().st_size > 5000
    svg = (tmp_path / "a.svg").read_text("utf-8")
    assert "Coulomb friction" in svg
    assert "note: =cmd|calc" in svg
    done = tworelay("history", "x", "--csv", "-")
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    assert [row["kind"] for row in rows] == ["run", "run", "run", "note"]
    assert float(rows[2]["coulomb [N.m]"]) == 0.13
    assert not any(cell.startswith(("=", "+", "@")) for row in rows for cell in row.values())
    assert tworelay("history", "x", "--picture", "a.txt").returncode == 2
    assert tworelay("history", "--picture", "a.svg").returncode == 2
    assert tworelay("history", "x", "--csv", str(tmp_path / "no" / "a.csv")).returncode == 2


def test_drift_of_all_axes(tworelay: Tworelay) -> None:
    made([0.1] * 3, "a")
    made([0.1] * 26 + [0.13] * 8, "b")
    done = tworelay("history", "drift")
    assert done.returncode == 0, done.stderr
    first, last = done.stdout.splitlines()
    assert first.startswith("friction of b: +30 % ± ")
    assert "seen first on" in first
    assert last == (
        "axes with an alarm: 1; without: 0; with too few runs under like conditions to tell: 1"
    )
    rows = json.loads(tworelay("history", "drift", "--json").stdout)
    assert {(one["axis"], one["state"]) for one in rows if one["quantity"] == "coulomb"} == {
        ("a", "not enough runs"), ("b", "drifting"),
    }  # fmt: skip
    calm = json.loads(tworelay("history", "drift", "--json", "--gate", "40").stdout)
    assert "drifting" not in {one["state"] for one in calm}


# -- names and notes ------------------------------------------------------------------------------


def test_an_axis_that_is_renamed_keeps_its_history(tworelay: Tworelay) -> None:
    first = made([0.1, 0.1], "press-7-x")
    last = made([0.1], "press-8-x")
    asked = story(tworelay, "press-8-x")
    assert [one["run"] for one in asked["runs"]] == last
    (remark,) = asked["remarks"]
    assert 'history rename "press-7-x" "press-8-x"' in remark
    done = tworelay("history", "rename", "press-7-x", "press-8-x")
    assert done.returncode == 0, done.stderr
    for name in ("press-7-x", "press-8-x"):
        together = story(tworelay, name)
        assert together["axis"] == "press-8-x"
        assert [one["run"] for one in together["runs"]] == first + last
    new = made([0.1], "press-7-x")
    assert [one["run"] for one in story(tworelay, "press-7-x")["runs"]] == new
    assert len(story(tworelay, "press-8-x")["runs"]) == 3


def names(tworelay: Tworelay, axis: str) -> list[str]:
    return [one["run"] for one in story(tworelay, axis)["runs"]]


def test_a_renaming_is_taken_back(tworelay: Tworelay) -> None:
    (run,) = made([0.1], "A")
    assert tworelay("history", "rename", "A", "B").returncode == 0
    assert names(tworelay, "B") == [run]
    assert tworelay("history", "rename", "--undo").returncode == 0
    assert names(tworelay, "A") == [run]
    assert names(tworelay, "B") == []
    done = tworelay("history", "rename", "--undo")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


def test_names_go_in_a_circle_and_every_run_is_found(tworelay: Tworelay) -> None:
    """A becomes B, another axis is called A, and both change names by a third."""
    (first,) = made([0.1], "A")
    tworelay("history", "rename", "A", "B")
    (second,) = made([0.2], "A")
    for pair in (("A", "t"), ("B", "A"), ("t", "B")):
        assert tworelay("history", "rename", *pair).returncode == 0
    assert names(tworelay, "A") == [first]
    assert names(tworelay, "B") == [second]
    drifts = json.loads(tworelay("history", "drift", "--json").stdout)
    assert {one["axis"] for one in drifts} == {"A", "B"}
    assert tworelay("history", "rename", "A", "A").returncode == 2


def test_a_note_stays_with_its_axis_when_the_name_is_given_again(tworelay: Tworelay) -> None:
    made([0.1], "A")
    tworelay("history", "note", "A", "old belt")
    tworelay("history", "rename", "A", "B")
    made([0.1], "A")
    assert [one["text"] for one in story(tworelay, "B")["notes"]] == ["old belt"]
    assert story(tworelay, "A")["notes"] == []


def test_a_note_is_taken_back(tworelay: Tworelay) -> None:
    made([0.1], "A")
    tworelay("history", "note", "A", "new  belt")
    assert tworelay("history", "note", "A", "new belt", "--remove").returncode == 0
    assert story(tworelay, "A")["notes"] == []
    done = tworelay("history", "note", "A", "new belt", "--remove")
    assert done.returncode == 2
    assert "no note on axis 'A' named 'new belt'" in done.stderr


def test_a_name_with_an_at_sign_is_a_name(tworelay: Tworelay) -> None:
    (run,) = made([0.1], "A")
    tworelay("history", "rename", "A", "x@y")
    assert names(tworelay, "x@y") == [run]


@pytest.mark.parametrize(
    "harm",
    [
        "UPDATE axis_notes SET at = 'abc'", "UPDATE axis_notes SET at = 1e300",
        "UPDATE axis_notes SET number = 'x'", "UPDATE renamed_axes SET number = 'x'",
        "UPDATE renamed_axes SET new = CAST(x'ff41' AS TEXT)",
        "UPDATE axis_notes SET text = CAST(x'ff41' AS TEXT)",
    ],
)  # fmt: skip
def test_damaged_words_of_people_end_nothing(harm: str, tworelay: Tworelay) -> None:
    made([0.1, 0.1], "A")
    tworelay("history", "note", "A", "new belt")
    tworelay("history", "rename", "A", "B")
    with sqlite3.connect(home() / "journal.sqlite") as db:
        db.execute(harm)
    db.close()
    done = tworelay("history", "drift")
    assert done.returncode == 0, done.stderr
    for name in ("A", "B"):
        done = tworelay("history", name, "--csv", "-")
        assert done.returncode in (0, 2), done.stderr
        assert "internal" not in done.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("note", "x", "later", "--at", "9999-12-31"), "lies in the future"),
        (("rename", "x"), "give OLD and NEW, or --undo"),
        (("rename", "x", "y", "--undo"), "it takes no names"),
        (("x", "--json", "--csv", "-"), "both want standard output"),
        (("note", "y", "regreased"), "no axis with runs named 'y'; there are: x"),
        (("note", "x", ""), "a note has 1 to 1000 printable characters"),
        (("note", "x", "n" * 1001), "a note has 1 to 1000 printable characters"),
        (("note", "x", "a\x1b[2Jb"), "a note has 1 to 1000 printable characters"),
        (("note", "x", "a", "--at", "spring"), "--at spring: must be a date as 2026-01-31"),
        (("rename", "y", "z"), "no axis with runs named 'y'; there are: x"),
        (("rename", "x", "x"), "'x' is called 'x' already"),
        (("rename", "x", ""), "must not be empty"),
        (("x", "--csv", "/nowhere/a.csv"), "--csv"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(
    words: tuple[str, ...], says: str, tworelay: Tworelay
) -> None:
    made([0.1])
    done = tworelay("history", *words)
    assert done.returncode == 2, done.stdout
    assert says in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_note_of_an_earlier_day_stands_at_its_day(tworelay: Tworelay) -> None:
    made([0.1, 0.1])
    with sqlite3.connect(home() / "journal.sqlite") as db:
        db.execute("UPDATE runs SET created = created - 864000 WHERE rowid = 1")
    db.close()
    day = time.strftime("%Y-%m-%d", time.localtime(time.time() - 5 * 86400))
    assert tworelay("history", "note", "x", "regreased", "--at", day).returncode == 0
    shown = story(tworelay, "x")
    (drift,) = [one for one in shown["drift"] if one["quantity"] == "coulomb"]
    assert drift["since_text"] == "the note 'regreased'"
    assert len(drift["points"]) == 1
    text = tworelay("history", "x").stdout
    places = [text.index(part) for part in (shown["runs"][0]["run"], "regreased")]
    assert places == sorted(places)


def test_two_axes_are_joined_when_that_is_said(tworelay: Tworelay) -> None:
    for serial in ("0x1", "0x2"):
        with Journal(home()) as journal:
            result, _ = recorded(OF_0_1[0])
            name = f"axis-{serial}"
            run = begun(journal, name, serial)
            RunFolder.of(journal, run).save(replace(result, run=run, axis=name))
    refused = tworelay("history", "rename", "axis-0x1", "axis-0x2")
    assert refused.returncode == 2
    assert "with another drive: with --join" in refused.stderr
    assert tworelay("history", "rename", "axis-0x1", "axis-0x2", "--join").returncode == 0
    assert len(names(tworelay, "axis-0x2")) == 2


def test_a_note_follows_when_a_renaming_is_taken_back(tworelay: Tworelay) -> None:
    made([0.1], "A")
    tworelay("history", "rename", "A", "B")
    tworelay("history", "note", "B", "since then")
    tworelay("history", "rename", "--undo")
    assert [one["text"] for one in story(tworelay, "A")["notes"]] == ["since then"]


# -- side by side ---------------------------------------------------------------------------------


def test_two_runs_side_by_side(tworelay: Tworelay) -> None:
    first, second = made([0.1, 0.13])
    found = json.loads(tworelay("compare", first, second, "--json").stdout)
    by_name = {one["quantity"]: one for one in found["quantities"]}
    assert by_name["coulomb"]["change"] == pytest.approx(30)
    assert by_name["coulomb"]["excluded"] is True
    assert by_name["inertia"]["excluded"] is False
    assert found["parameters"]
    for one in found["parameters"]:
        assert one["first"] == one["second"]
    text = tworelay("compare", first, second).stdout
    assert "exclude each other" in text
    assert "temperature is not known in both runs" in text


def test_a_run_that_measured_nothing_is_compared_too(tworelay: Tworelay) -> None:
    (first,) = made([0.1])
    tworelay("identify", "virtual://bench?coulomb=2.5", "--yes")
    done = tworelay("compare", first, "last")
    assert done.returncode == 0, done.stderr
    assert "not measured" in done.stdout
    assert "verdicts: good and rejected" in done.stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("last", "nosuch"), "no run named 'nosuch'"), (("nosuch", "last"), "no run named"),
        (("last", "linear"), "a rotary and a linear axis have nothing to compare"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared(
    words: tuple[str, str], says: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    if "linear" in words:
        tworelay("identify", "virtual://emps", "--yes")
        assert tworelay("export", "last", str(tmp_path / "linear")).returncode == 0
        words = ("last", str(tmp_path / "linear"))
    made([0.1])
    done = tworelay("compare", *words)
    assert done.returncode == 2
    assert says in done.stderr


def test_the_report_says_under_which_conditions(tworelay: Tworelay, tmp_path: Path) -> None:
    axis = tmp_path / "press.toml"
    axis.write_text(
        'link = "virtual://bench"\nprofile = "virtual-modbus"\ntravel = 3\n'
        "[limits]\nends = [-20, 4]\n"
    )
    done = tworelay("identify", str(axis), "--yes", "--motor-temperature", "41")
    assert done.returncode == 0, done.stderr
    page = Path(tworelay("report", "last").stdout.strip()).read_text("utf-8")
    assert "motor at 41 °C, upper third of the travel" in page
    axis.write_text(axis.read_text().replace("[-20, 4]", "[-20, 2]"))
    refused = tworelay("identify", str(axis), "--yes")
    assert refused.returncode == 3
    assert "2 rad from the ends of its travel (-20…2 rad)" in refused.stderr


def test_a_run_says_on_which_computer_it_was(tworelay: Tworelay) -> None:
    import platform

    tworelay("identify", "virtual://bench", "--yes")
    shown = story(tworelay, "bench")["runs"][0]
    assert shown["host"] == platform.node()
    host = platform.node().partition(".")[0].lower()[:10]
    assert host in shown["run"].lower()
