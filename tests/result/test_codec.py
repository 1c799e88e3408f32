"""Results as JSON: what version 0.1.0 wrote is read, and what is written is read back as it was."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from commissioning.records import History, history_of
from commissioning.result.codec import decode, encode, schema, text_of
from commissioning.result.document import RunResult
from commissioning.result.endings import CompensationState
from commissioning.result.found import QUANTITIES
from commissioning.runs import RunFolder, as_of, drive_state
from profiles.errors import UsageError
from tests.command import ROOT

RECORDED = ROOT / "tests" / "recordings" / "runs_0_1"
NAMES = sorted(path.name for path in RECORDED.iterdir())
SCHEMA = json.loads((ROOT / "docs" / "run.schema.json").read_text("utf-8"))
PACKAGES = ("commissioning", "drivers", "profiles")
# to TOML, SQLite, JSON of the journal and of the schema, and foreign libraries
DOORS = {
    "commissioning/result/codec.py", "commissioning/records.py", "profiles/json_schema.py",
    "profiles/library.py", "profiles/table.py", "profiles/toml_files.py",
    "drivers/canopen/adapters.py",
    "drivers/modbus/answers.py", "drivers/modbus/client.py", "drivers/virtual/serve.py",
    "commissioning/fleet/file.py", "commissioning/fleet/rows.py",
    "commissioning/fleet/loading.py", "commissioning/fleet/plan.py",
    "commissioning/result/fleet_codec.py", "commissioning/panel/feed.py",
    "commissioning/panel/process.py", "commissioning/recordings/arrays.py",
    "commissioning/report/interactive.py",
}  # fmt: skip


def tree_of(name: str) -> Any:
    return json.loads((RECORDED / name / "run.json").read_text())


def recorded(name: str) -> tuple[RunResult, History]:
    """A run with what its journal says of it."""
    origin = RECORDED / name / "journal.json"
    history = history_of(json.loads(origin.read_text()), str(origin))
    found, _ = decode(tree_of(name), name)
    return as_of(found, history), history


@pytest.mark.parametrize("name", NAMES)
def test_every_number_of_an_older_run_is_there_and_comes_back(name: str) -> None:
    old = tree_of(name)
    found, curves = decode(old, name)
    again, none = decode(json.loads(text_of(found)), name)
    assert again == found
    assert not none, "no picture's columns in what is written"
    for quantity in QUANTITIES:
        number, before = found.friction.quantity(quantity), old["friction"][quantity]
        assert (number.value if number else None) == before["value"]
        assert (number.low if number else None) == before["low"]
    assert [c.new_raw for c in found.compensation] == [c["new_raw"] for c in old["compensation"]]
    assert [r.text for r in found.quality.reasons] == old["quality"]["reasons"]
    if (verification := old.get("verification")) is not None:
        traces = [step["trace"] for step in verification["steps"]]
        assert [list(curves[f"verify.{n}"][2]) for n in range(len(traces))] == [
            trace["error"] for trace in traces
        ]


@pytest.mark.parametrize("name", NAMES)
def test_what_is_written_keeps_to_the_schema(name: str) -> None:
    jsonschema.validate(encode(recorded(name)[0]), SCHEMA)


def test_the_schema_in_the_docs_is_that_of_the_types() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert schema() == SCHEMA  # else: python -m commissioning.result.codec > docs/run.schema.json


def test_a_file_of_a_run_stays_small() -> None:
    """Traces and steps of the loops lie with the samples."""
    assert len(text_of(recorded("good")[0])) < 40_000 < len(json.dumps(tree_of("good")))


@pytest.mark.parametrize(
    ("name", "verdict"),
    [
        ("good", "good"), ("usable", "usable"), ("rejected", "rejected"), ("immobile", "rejected"),
        ("refused", None), ("limited", None), ("interrupted", None), ("lost", None),
    ],
)  # fmt: skip
def test_interrupted_and_failed_are_apart_from_rejected(name: str, verdict: str | None) -> None:
    found, _ = recorded(name)
    assert found.quality.verdict == verdict
    assert found.measured == (verdict in ("good", "usable"))
    assert (found.friction.coulomb is not None) == found.measured


@pytest.mark.parametrize(
    ("name", "compensation", "stored"),
    [
        ("good", CompensationState.OF_RUN, True), ("written", CompensationState.OF_RUN, True),
        ("restored", CompensationState.AS_FOUND, None), ("repeated", CompensationState.AS_FOUND,
        None),
        ("unproved", CompensationState.OF_RUN, True),
    ],
)  # fmt: skip
def test_what_is_in_the_drive_is_what_the_journal_says(
    name: str, compensation: CompensationState, stored: bool | None
) -> None:
    """The file of `restored` says 'written' of what was put back."""
    found, history = recorded(name)
    state = drive_state(found, history)
    assert (state.compensation, state.stored) == (compensation, stored)
    assert bool(found.written) == (compensation is CompensationState.OF_RUN)


def without(*way: str | int) -> Callable[[Any], None]:
    def change(tree: Any) -> None:
        for key in way[:-1]:
            tree = tree[key]
        del tree[way[-1]]

    return change


def put(value: object, *way: str | int) -> Callable[[Any], None]:
    def change(tree: Any) -> None:
        for key in way[:-1]:
            tree = tree[key]
        tree[way[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("axis"), "'axis' must be there"),
        (put("1", "friction", "coulomb", "value"),
        "'friction.coulomb.value' must be a valid number"),
        (put(0.0, "critical_point", "naive", "gain"), "must be greater than 0"),
        (put("perhaps", "status"), "'status' must be 'completed', 'stopped'"),
        (put(2**63, "compensation", 0, "new_raw"), "must be less than 9223372036854775808"),
        (put([], "verification", "steps"),
        "'verification.steps' Tuple should have at least 1 item"),
        (put(None, "tuning", 0, "ms"), "'tuning.0' lacks what the gains are worth"),
        (put([1.0], "friction", "curve", "speed"), "'friction.curve' lacks columns of one length"),
        (put("tworelay.run/3", "schema"), "is no result of tworelay"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_place(change: Callable[[Any], None], words: str) -> None:
    tree = encode(recorded("good")[0])
    change(tree)
    with pytest.raises(UsageError) as caught:
        decode(tree, "run.json")
    assert words in str(caught.value)
    assert str(caught.value).startswith("run.json: is")


def test_what_a_later_version_adds_is_passed_over() -> None:
    tree = encode(recorded("good")[0])
    tree["new"] = tree["quality"]["new"] = {"a": 1}
    assert decode(tree, "run.json")[0] == recorded("good")[0]


def test_one_stretch_that_was_analysed_is_a_list_of_one() -> None:
    """As it was written until November 2026."""
    tree = json.loads(json.dumps(encode(recorded("good")[0])))
    for before, now in (([2.5, 3.8], ((2.5, 3.8),)), (None, ())):
        tree["experiment"]["analysed"] = before
        read, _ = decode(tree, "run.json")
        assert read.experiment is not None
        assert read.experiment.analysed == now


def test_an_older_run_that_is_saved_again_loses_no_curve(tmp_path: Path) -> None:
    for name in ("run.json", "journal.json", "samples.npz"):
        (tmp_path / name).write_bytes((RECORDED / "good" / name).read_bytes())
    folder = RunFolder(tmp_path)
    before = folder.samples()
    assert before is not None
    assert len(before.curves) == 4 + 27
    folder.save(folder.result())
    assert json.loads((tmp_path / "run.json").read_text())["schema"] == "tworelay.run/2"
    after = folder.samples()
    assert after is not None
    assert after.curves.keys() == before.curves.keys()
    assert (after.curves["verify.3"] == before.curves["verify.3"]).all()
    assert (after["position"] == before["position"]).all()


def test_trees_of_anything_stand_at_the_doors_only() -> None:
    found = {
        str(path.relative_to(ROOT)).replace("\\", "/")
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if re.search(r"dict\[str, Any\]|Dict\[str, Any\]|dict\[Any, Any\]", path.read_text("utf-8"))
    }
    assert found <= DOORS
