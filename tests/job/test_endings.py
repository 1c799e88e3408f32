"""Every act ends with one line of truth, and the same in its JSON and in its run."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import statistics
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import jsonschema
import pytest

from commissioning.journal import Journal
from commissioning.runs import RunFolder
from drivers.errors import LinkLost, WriteDenied
from drivers.home import home
from drivers.profiled import ProfiledDrive
from drivers.sample import Sample
from tests.command import ROOT
from tests.conftest import Serve, Tworelay
from tests.interrupting import signalled
from tests.serving import WIRES

SCHEMA = json.loads((ROOT / "docs" / "run.schema.json").read_text("utf-8"))
BACK = {"state": "put back", "names": []}
AS_FOUND = {"compensation": "as it was found", "stored": None}


class Case(NamedTuple):
    """A job and how it ends."""

    words: tuple[str, ...]
    code: int
    status: str
    verdict: str | None
    axis: str
    said_by: str | None
    drive: dict[str, Any] = AS_FOUND
    cut: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext


CASES = {
    "done": Case(("identify", "virtual://bench"), 0, "completed", "good", "at rest and off", None),
    "done, held by a brake": Case(
        ("identify", "virtual://vertical"), 0, "completed", "good", "held by its brake", None
    ),
    "at a limit": Case(
        ("identify", "virtual://bench", "--duration", "2.5"), 5, "stopped", None, "at rest and off",
        "tworelay, at a limit of the experiment",
    ),
    "rejected": Case(
        ("identify", "virtual://bench?coulomb=2.5"), 6, "rejected", "rejected", "at rest and off",
        None
    ),
    "refused": Case(
        ("identify", "virtual://bench?load=0.2"), 3, "refused", None, "not moved", None
    ),
    "no link": Case(
        ("identify", "modbus-tcp://127.0.0.1:1?unit=1", "--travel", "1"), 4, "failed", None,
        "not moved",
        "the link",
    ),
    "Ctrl-C": Case(
        ("identify", "virtual://bench"), 130, "stopped", None, "at rest and off",
        "the operator (SIGINT)", cut=lambda: signalled(signal.SIGINT, 1500),
    ),
    "the system": Case(
        ("identify", "virtual://bench"), 143, "stopped", None, "at rest and off",
        "the system (SIGTERM)", cut=lambda: signalled(signal.SIGTERM, 1500),
    ),
    "proved": Case(
        ("commission", "virtual://bench"), 0, "completed", "good", "at rest and off", None,
        {"compensation": "of this run", "stored": True},
    ),
    "does not help": Case(
        ("commission", "virtual://mx106", "--cycle", "0.008"), 8, "failed", "good",
        "at rest and off",
        None,
    ),
}  # fmt: skip


def told(stdout: str) -> str:
    """The line of truth."""
    (line,) = (line for line in stdout.splitlines() if line.startswith(("axis ", "it is NOT")))
    return line


def kept() -> Any:
    """The latest run as its file has it."""
    with Journal(home()) as journal:
        return json.loads(
            (RunFolder.of(journal, journal.run("last").id).path / "run.json").read_text()
        )


@pytest.mark.parametrize("name", CASES)
def test_a_job_ends_with_what_is_true(name: str, tworelay: Tworelay, tmp_path: Path) -> None:
    case, target = CASES[name], tmp_path / "run.json"
    with case.cut():
        done = tworelay(*case.words, "--yes", "--json", str(target))
    assert done.returncode == case.code, done.stderr
    result = json.loads(target.read_text())
    jsonschema.validate(result, SCHEMA)
    assert (result["status"], result["quality"]["verdict"]) == (case.status, case.verdict)
    begun = result["run"] is not None
    assert result["ending"] == {
        "axis": case.axis, "settings": BACK if begun else None,
        "drive": case.drive if begun else None,
        "said_by": case.said_by,
    }  # fmt: skip
    line = told(done.stdout)
    assert (case.said_by or "axis") in line
    assert ("ended by" in line) is (case.said_by is not None)
    if case.code:
        said = result["error"]
        whole = "; ".join(filter(None, (said["text"], said["hint"])))
        assert done.stderr.strip() == f"tworelay: {whole}"
        assert result["error"]["code"]
        assert (result["friction"]["coulomb"]["value"] is None) is (case.verdict != "good")
    else:
        assert result["error"] is None
    if result["run"] is not None:
        assert kept() == result
        assert f"run {result['run']}" in done.stdout.splitlines()
        assert case.drive["compensation"].split(" ")[-1] in line
    began, ended = (datetime.fromisoformat(result[key]) for key in ("began", "ended"))
    assert began.tzinfo is not None
    assert began <= ended
    assert result["tool"]["name"] == "tworelay"
    assert result["host"]


def test_a_link_that_is_lost_in_motion_leaves_nothing_certain_until_it_is_put_right(
    serve: Serve, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    (link,) = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")
    exchange, gone = ProfiledDrive.exchange, []

    def cut(drive: ProfiledDrive, set_point: float) -> Sample:
        gone.append(1)
        if len(gone) > 500:
            drive._bus.close()
            raise LinkLost("the cable was pulled")
        return exchange(drive, set_point)

    with monkeypatch.context() as broken:
        broken.setattr(ProfiledDrive, "exchange", cut)
        done = tworelay("identify", link, "--travel", "3", "--cycle", "0.004", "--yes")
    assert done.returncode == 4, done.stderr
    ending = kept()["ending"]
    assert ending["axis"] == "NOT VERIFIED"
    assert ending["said_by"] == "the link"
    assert ending["settings"]["state"] == "not put back"
    assert {"max_torque", "max_speed"} <= set(ending["settings"]["names"])
    assert "NOT VERIFIED" in told(done.stdout)
    assert "emergency stop" in told(done.stdout)
    assert "settings NOT put back: " in told(done.stdout)
    stopped = tworelay("stop", link)
    assert stopped.returncode == 0, stopped.stderr
    run = kept()["run"]
    assert f"run {run} left settings changed" in stopped.stdout
    assert tworelay("restore", "--yes").returncode == 0
    assert kept()["ending"] == {
        "axis": "at rest and off", "settings": BACK, "drive": AS_FOUND, "said_by": None,
    }  # fmt: skip
    assert kept()["status"] == "failed", "it has measured nothing, still"
    assert "left settings" not in tworelay("stop", link).stdout


def test_a_write_that_is_refused_half_way_is_said_to_be_half_done(
    serve: Serve, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (link,) = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")
    assert tworelay("identify", link, "--travel", "3", "--yes").returncode == 0
    write = ProfiledDrive.write

    def refuses(drive: ProfiledDrive, name: str, raw: int) -> None:
        if name == "coulomb_negative" and raw:
            raise WriteDenied("no")
        write(drive, name, raw)

    with monkeypatch.context() as broken:
        broken.setattr(ProfiledDrive, "write", refuses)
        done = tworelay("apply", "last", "--yes", "--json", str(tmp_path / "run.json"))
    assert done.returncode == 7
    result = json.loads((tmp_path / "run.json").read_text())
    assert kept() == result
    certain = {one["parameter"]: one["certain"] for one in result["written"]}
    assert certain == {"coulomb_positive": True, "coulomb_negative": False}
    assert result["ending"]["drive"] == {"compensation": "not known", "stored": False}
    assert "NOT KNOWN what compensation" in told(done.stdout)
    assert result["friction"]["coulomb"]["value"], "what was measured is measured"
    (page,) = (Path(tworelay("report", "last").stdout.strip()),)
    assert "was cut off" in page.read_text("utf-8")
    assert tworelay("restore", "--yes").returncode == 0
    assert kept()["ending"]["drive"] == AS_FOUND
    again = tworelay("apply", "last", "--yes")
    assert again.returncode == 0, again.stderr
    assert "the drive's compensation is of this run, stored" in told(again.stdout)
    assert (kept()["status"], kept()["error"]) == ("completed", None)


def test_a_refused_act_leaves_its_run_as_it_was(tworelay: Tworelay, after: Tworelay) -> None:
    after("identify", "virtual://bench", "--yes")
    before = kept()
    done = tworelay("apply", "last", "--json", "-")
    assert done.returncode == 3
    result = json.loads(done.stdout)
    assert (result["status"], result["error"]["code"]) == ("refused", "refused.no-terminal")
    assert result["ending"]["axis"] == "not moved"
    assert kept() == before


def test_the_mean_of_the_repeats_is_what_is_shown_and_proposed(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    """Figures of one run from one source: with a noisy link each repeat finds another number."""
    target = tmp_path / "run.json"
    done = tworelay(
        "identify", "virtual://bench?stamp=0.00002&encoder=8000", "--repeat", "4", "--fraction",
        "1", "--yes",
        "--json", str(target),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(target.read_text())
    repeats = result["experiment"]["repeats"]
    mean = sum(repeats) / 4
    assert len(set(repeats)) == 4
    assert result["experiment"]["spread"] == pytest.approx(statistics.stdev(repeats))
    slope, low, high = result["experiment"]["drift"]
    assert low < slope < high
    shown = tworelay("report", "last")
    page = Path(shown.stdout.strip()).read_text("utf-8")
    assert "4 repeats: spread ±" in page
    assert "% a minute" in page
    coulomb = result["friction"]["coulomb"]
    assert coulomb["value"] == pytest.approx(mean, rel=1e-12)
    assert abs(mean / repeats[-1] - 1) > 1e-5, "else this shows nothing"
    assert coulomb["low"] <= min(repeats) <= max(repeats) <= coulomb["high"]
    change = next(c for c in result["compensation"] if c["parameter"] == "coulomb_positive")
    assert change["new"] - change["rounded_by"] == pytest.approx(mean, rel=1e-9)
    viscous = next(c for c in result["compensation"] if c["parameter"] == "viscous_gain")
    assert viscous["new"] - viscous["rounded_by"] == pytest.approx(
        result["friction"]["viscous"]["value"], rel=1e-9
    )
    offset = next(c for c in result["compensation"] if c["parameter"] == "torque_offset")
    assert offset["new"] - offset["rounded_by"] == pytest.approx(
        result["friction"]["offset"]["value"], abs=1e-9
    )


RECORDED = ROOT / "tests" / "recordings" / "runs_0_1"
REPORTED = {
    "good": ("written, read back", "% less error after reversals", "good"),
    "usable": ("proposed", "usable", "Friction against speed"),
    "repeated": ("proposed", "Repeated: "),
    "rejected": ("rejected", "% of the torque unexplained", "no friction was measured"),
    "immobile": ("rejected", "no motion up to", "no friction was measured"),
    "refused": ("refused", "not measured", "no friction was measured"),
    "limited": ("stopped", "not measured", "no friction was measured"),
    "interrupted": (
        "stopped",
        "not measured",
        "not recorded by that version; by the journal, settings put back",
    ),
    "lost": ("failed", "not measured", "settings NOT put back: max_torque"),
    "unproved": ("written, read back",),
    "restored": ("proposed",),
    "written": ("written, read back",),
}
# of a run that says so is not true
NEVER = {
    "interrupted": ("has no friction compensation", ">rejected<"),
    "lost": ("has no friction compensation", ">rejected<"),
    "limited": ("has no friction compensation", ">rejected<"),
    "refused": ("has no friction compensation", ">rejected<"),
    "rejected": ("has no friction compensation", "written, read back"),
    "immobile": ("has no friction compensation", "written, read back"),
    "restored": ("written, read back",),
    "usable": ("written, read back",),
}


@pytest.mark.parametrize("name", sorted(path.name for path in RECORDED.iterdir()))
def test_each_run_of_an_older_version_has_its_report(
    name: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    target = tmp_path / "report.html"
    done = tworelay("report", str(RECORDED / name), "--output", str(target))
    assert done.returncode == 0, done.stderr
    page = target.read_text("utf-8")
    text = re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL)
    for words in REPORTED[name]:
        assert words in text, words
    for words in NEVER.get(name, ()):
        assert words not in text, words
    assert ("<svg" in page) is (name not in ("refused", "limited"))


def test_a_proof_that_failed_is_not_shown_as_finished(tworelay: Tworelay) -> None:
    with signalled(signal.SIGINT, 20000):
        done = tworelay("commission", "virtual://bench", "--yes")
    assert done.returncode == 130
    assert "proof with 50 %" in done.stdout
    page = Path(tworelay("report", "last").stdout.strip()).read_text("utf-8")
    assert "· stopped" in page
    assert "· completed" not in page
    assert "ended by the operator (SIGINT)" in page
    assert "written, read back" not in page
    assert "the drive&#39;s compensation is as it was found" in page
    history = tworelay("history").stdout
    assert "good, then stopped" in history
    assert "as found" in history
