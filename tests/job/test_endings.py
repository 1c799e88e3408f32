"""Every act ends with one line of truth, and the same in its JSON and in its run."""

from __future__ import annotations

import contextlib
import json
import re
import signal
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import jsonschema
import pytest

from commissioning.journal import Journal
from commissioning.rig.rig import Rig
from commissioning.runs import RunFolder
from commissioning.session import verify
from drivers.errors import LinkLost, WriteDenied, WriteFailed
from drivers.home import home
from drivers.link import axis_of, open_drive
from drivers.places import same_place
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
        ("identify", "virtual://bench", "--duration", "3"), 5, "stopped", None, "at rest and off",
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
        assert done.stderr.strip() == f"tworelay: {result['error']['text']}"
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
        if len(gone) > 800:
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
    assert "50 % of the friction compensated" in done.stdout
    page = Path(tworelay("report", "last").stdout.strip()).read_text("utf-8")
    assert "· stopped" in page
    assert "· completed" not in page
    assert "ended by the operator (SIGINT)" in page
    assert "written, read back" not in page
    assert "the drive&#39;s compensation is as it was found" in page
    history = tworelay("history").stdout
    assert "good, then stopped" in history
    assert "as found" in history


# -- what is in RAM and what is in the memory
# -------------------------------------------------------


@pytest.fixture
def link(serve: Serve) -> str:
    return serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]


BASE = ("--travel", "3", "--cycle", "0.004", "--yes")


def in_ram(link: str) -> list[int]:
    drive = open_drive(axis_of(link))
    found = [drive.read(name).raw for name in ("coulomb_positive", "coulomb_negative")]
    drive.close()
    return found


def in_memory(tmp_path: Path) -> list[int]:
    tree = json.loads((tmp_path / "drive-0.json").read_text())
    return [tree.get(name, 0) for name in ("coulomb_positive", "coulomb_negative")]


def follows(errors: list[float]) -> Callable[..., tuple[float, Any]]:
    """What each step of a proof is said to leave of the error, in turn; then the last."""
    return lambda command, position, turns: (errors.pop(0) if errors[1:] else errors[0], position)


def test_a_signal_in_the_store_undoes_nothing_of_what_is_decided(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """85 % is stored, then a proof finds that 50 % is best,
    and Ctrl-C comes while that is stored."""
    assert tworelay("identify", link, *BASE).returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0
    assert in_ram(link) == in_memory(tmp_path) == [85, 85]
    store = ProfiledDrive.store

    def hurried(drive: ProfiledDrive) -> None:
        signal.raise_signal(signal.SIGINT)
        store(drive)

    monkeypatch.setattr(verify, "reversal_error", follows([1.0, 0.5, 2.0]))
    monkeypatch.setattr(ProfiledDrive, "store", hurried)
    done = tworelay("verify", "last", "--yes", "--cycle", "0.004", "--json", str(tmp_path / "j"))
    assert done.returncode == 130
    assert in_ram(link) == in_memory(tmp_path) == [50, 50]
    assert kept() == json.loads((tmp_path / "j").read_text())
    assert kept()["status"] == "completed"
    assert kept()["ending"]["drive"] == {"compensation": "of this run", "stored": True}
    whys = {c["parameter"]: c["why"] for c in kept()["compensation"] if c["new_raw"] == 50}
    assert set(whys.values()) == {"50 % of the friction: the most that helped"}


def test_trial_values_are_not_said_to_be_stored(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert tworelay("identify", link, *BASE).returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0
    follow, steps = Rig.follow, []

    def lost(job: Rig, path: Any) -> Any:
        steps.append(kept()["ending"])
        if len(steps) == 2:
            job.drive._bus.close()  # type: ignore[attr-defined]
            raise LinkLost("the cable was pulled")
        return follow(job, path)

    with monkeypatch.context() as broken:
        broken.setattr(Rig, "follow", lost)
        done = tworelay("verify", "last", "--yes", "--cycle", "0.004")
    assert done.returncode == 4
    assert steps == [None, None], "a run that is killed now has no ending that is not true"
    assert in_ram(link) == [50, 50]
    assert in_memory(tmp_path) == [85, 85]
    ending = kept()["ending"]
    assert ending["drive"] == {"compensation": "partly of this run", "stored": False}
    assert ending["axis"] == "NOT VERIFIED"
    assert "coulomb_positive = 50" in told(done.stdout)
    refused = tworelay("apply", "last", "--yes")
    assert refused.returncode == 3
    assert "NOT VERIFIED" in told(refused.stdout), "nobody has looked since"
    assert "failed" in tworelay("history").stdout
    assert tworelay("stop", link).returncode == 0
    assert tworelay("restore", "--yes").returncode == 0
    assert in_ram(link) == in_memory(tmp_path) == [0, 0]
    assert kept()["ending"]["drive"] == AS_FOUND


def test_old_values_that_could_not_be_stored_are_said_to_be_in_ram_only(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert tworelay("identify", link, *BASE).returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0

    def refuses(drive: ProfiledDrive) -> None:
        raise WriteFailed("store refused")

    with monkeypatch.context() as broken:
        broken.setattr(ProfiledDrive, "store", refuses)
        done = tworelay("restore", "--yes")
    assert done.returncode == 7
    assert in_ram(link) == [0, 0]
    assert in_memory(tmp_path) == [85, 85]
    assert kept()["ending"]["drive"] == {"compensation": "as it was found", "stored": False}
    assert "in its RAM: its memory may have others" in told(done.stdout)
    assert kept()["error"]["text"] in done.stderr
    assert tworelay("restore", "--yes").returncode == 0
    assert in_memory(tmp_path) == [0, 0]
    assert kept()["ending"]["drive"] == AS_FOUND


def test_what_somebody_else_wrote_is_not_ours(
    link: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    assert tworelay("identify", link, *BASE).returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0
    drive = open_drive(axis_of(link))
    drive.write("coulomb_positive", 33)
    drive.close()
    done = tworelay("restore", "--yes")
    assert done.returncode == 7
    assert in_ram(link) == [33, 0]
    assert "NOT KNOWN what compensation the drive has" in told(done.stdout)
    assert [(w["parameter"], w["certain"]) for w in kept()["written"]] == [
        ("coulomb_positive", False)
    ]


def test_values_that_stood_there_before_a_proof_come_back(
    link: str, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert tworelay("identify", link, *BASE).returncode == 0
    drive = open_drive(axis_of(link))
    drive.write("coulomb_positive", 7)
    drive.close()
    monkeypatch.setattr(verify, "reversal_error", follows([1.0, 2.0]))
    done = tworelay("verify", "last", "--yes", "--cycle", "0.004")
    assert done.returncode == 8
    assert in_ram(link) == [7, 0]
    assert "as it was found" in told(done.stdout)


def test_gains_stay_said_where_the_compensation_does_not_help(
    link: str, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert tworelay("tune", link, *BASE).returncode == 0
    assert tworelay("apply", "last", "--gains", "cascade", "--yes").returncode == 0
    monkeypatch.setattr(verify, "reversal_error", follows([1.0, 2.0]))
    done = tworelay("verify", "last", "--yes", "--cycle", "0.004")
    assert done.returncode == 8
    line = told(done.stdout)
    assert "as it was found, with gains of this run (velocity_gain, " in line
    assert kept()["ending"]["drive"] == AS_FOUND
    assert {w["kind"] for w in kept()["written"]} == {"gain"}


def test_the_last_run_that_wrote_has_the_drive(link: str, tworelay: Tworelay) -> None:
    for fraction in ("0.5", "0.8"):
        done = tworelay("identify", link, *BASE, "--fraction", fraction)
        assert done.returncode == 0, done.stderr
        assert tworelay("apply", "last", "--yes").returncode == 0
    first, second = json.loads(tworelay("history", "--json").stdout)
    assert (first["drive"], second["drive"]) == ("another run's", "this run's, stored")
    page = Path(tworelay("report", first["run"]).stdout.strip()).read_text("utf-8")
    assert "compensation is of another run" in page
    assert tworelay("restore", "--yes").returncode == 0
    first, second = json.loads(tworelay("history", "--json").stdout)
    assert (first["drive"], second["drive"]) == ("this run's, stored", "as found")
    assert in_ram(link) == [50, 50]


def test_a_proof_that_ends_where_it_began_leaves_nothing_to_restore(
    link: str, tworelay: Tworelay
) -> None:
    """Else a bare `restore` would switch on what a later one has switched off."""
    assert tworelay("commission", link, *BASE).returncode == 0
    again = tworelay("commission", link, *BASE)
    assert again.returncode == 0, again.stderr
    assert in_ram(link) == [85, 85]
    first, second = (one["run"] for one in json.loads(tworelay("history", "--json").stdout))
    assert tworelay("restore", second, "--yes").stdout.strip() == "nothing to restore"
    assert tworelay("restore", first, "--yes").returncode == 0
    assert in_ram(link) == [0, 0]


def test_a_damaged_record_keeps_no_act_from_its_end(tworelay: Tworelay, after: Tworelay) -> None:
    after("identify", "virtual://bench", "--yes")
    folder = home() / "runs" / kept()["run"]
    (folder / "samples.npz").write_bytes(b"no archive")
    done = tworelay("verify", "last", "--yes")
    assert done.returncode == 0, done.stderr
    assert kept()["verification"]["kept_fraction"] == 0.85
    assert (folder / "samples.damaged.npz").read_bytes() == b"no archive"
    (folder / "run.json").write_text("{}")
    assert json.loads(tworelay("history", "--json").stdout)[0]["verdict"] == "files damaged"
    restored = tworelay("restore", "--yes")
    assert restored.returncode == 0, restored.stderr
    assert "the drive's compensation is as it was found" in told(restored.stdout)


def test_a_stop_that_reaches_nothing_says_what_that_means(tworelay: Tworelay) -> None:
    done = tworelay("stop", "modbus-tcp://127.0.0.1:1")
    assert done.returncode == 4
    assert told(done.stdout).endswith("use the emergency stop")


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("modbus-tcp://127.0.0.1:1502?unit=1", "modbus-tcp://localhost:1502", True),
        ("modbus-tcp://127.0.0.1:1502?unit=1", "modbus-tcp://127.0.0.1:1502?unit=1&timeout=2",
        True),
        ("modbus-tcp://127.0.0.1:1502?unit=1", "modbus-tcp://127.0.0.1:1502?unit=2", False),
        ("modbus-tcp://127.0.0.1:1502", "modbus-rtu-tcp://127.0.0.1:1502", True),
        ("canopen://socketcan/can0?node=5", "canopen://socketcan/can0?node=5&sync=bus", True),
        ("canopen://socketcan/can0?node=5", "canopen://socketcan/can1?node=5", False),
        ("virtual://bench", "virtual://bench?load=0.1", False),
        ("no link", "virtual://bench", False),
    ],
)  # fmt: skip
def test_one_drive_by_two_spellings_of_its_link(one: str, other: str, same: bool) -> None:
    assert same_place(one, other) is same
    assert same_place(other, one) is same


# -- one drive, several runs
# ------------------------------------------------------------------------


def measured(tworelay: Tworelay, link: str, fraction: str) -> str:
    done = tworelay("identify", link, *BASE, "--fraction", fraction)
    assert done.returncode == 0, done.stderr
    return str(kept()["run"])


def said(tworelay: Tworelay, run: str) -> str:
    """What the list says of a run's drive."""
    return next(
        one["drive"]
        for one in json.loads(tworelay("history", "--json").stdout)
        if one["run"] == run
    )


def test_what_another_run_has_stored_is_known(
    link: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    first = measured(tworelay, link, "0.85")
    assert tworelay("apply", first, "--yes").returncode == 0
    second = measured(tworelay, link, "0.5")
    assert tworelay("apply", second, "--yes").returncode == 0
    assert in_memory(tmp_path) == [50, 50]
    assert tworelay("apply", first, "--yes").returncode == 0
    assert in_ram(link) == in_memory(tmp_path) == [85, 85]
    assert (said(tworelay, first), said(tworelay, second)) == (
        "this run's, stored",
        "as found",
    )


def test_a_restore_stores_what_another_run_has_left_in_the_memory(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first one stored nothing.

    The second stored, and its way back stores the first one's values.
    """
    first = measured(tworelay, link, "0.85")
    with monkeypatch.context() as broken:
        broken.setattr(ProfiledDrive, "store", lambda drive: (_ for _ in ()).throw(LinkLost("no")))
        assert tworelay("apply", first, "--yes").returncode == 4
    second = measured(tworelay, link, "0.5")
    assert tworelay("apply", second, "--yes").returncode == 0
    assert tworelay("restore", second, "--yes").returncode == 0
    assert in_ram(link) == in_memory(tmp_path) == [85, 85]
    assert said(tworelay, first) == "this run's, stored"
    assert tworelay("restore", first, "--yes").returncode == 0
    assert in_ram(link) == in_memory(tmp_path) == [0, 0]
    assert said(tworelay, first) == "as found"


def test_what_is_written_back_is_journalled_before(
    link: str, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A restore that is killed: its run has no ending, and nobody claims to know the value."""
    run = measured(tworelay, link, "0.85")
    assert tworelay("apply", run, "--yes").returncode == 0
    write = ProfiledDrive.write

    def killed(drive: ProfiledDrive, name: str, raw: int) -> None:
        write(drive, name, raw)
        if name == "coulomb_negative":
            raise ZeroDivisionError  # as good as a kill: nothing of ours handles it

    with monkeypatch.context() as broken:
        broken.setattr(ProfiledDrive, "write", killed)
        assert tworelay("restore", run, "--yes").returncode == 1
    assert kept()["ending"] is None
    assert said(tworelay, run) == "not known"
    assert "NOT KNOWN" not in tworelay("restore", run, "--yes").stdout
    assert in_ram(link) == [0, 0]
    assert said(tworelay, run) == "as found"


def test_values_that_somebody_has_written_already_have_a_way_back(
    link: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    run = measured(tworelay, link, "0.85")
    drive = open_drive(axis_of(link))
    for change in kept()["compensation"]:
        drive.write(change["parameter"], change["new_raw"])
    drive.close()
    done = tworelay("apply", run, "--yes")
    assert done.returncode == 0, done.stderr
    assert in_memory(tmp_path) == [85, 85]
    assert "of this run, stored" in told(done.stdout)
    assert tworelay("restore", run, "--yes").returncode == 0
    assert in_ram(link) == in_memory(tmp_path) == [0, 0]


@pytest.mark.parametrize("text", ["stored up to write x", f"stored up to write {'9' * 5000}"])
def test_a_foreign_journal_that_counts_wrongly_is_read(
    text: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    for name in ("run.json", "profile.toml"):
        (tmp_path / name).write_bytes((RECORDED / "written" / name).read_bytes())
    journal = json.loads((RECORDED / "written" / "journal.json").read_text())
    journal["events"] += [{"at": 1.0, "text": "stored"}, {"at": 1.0, "text": text}]
    (tmp_path / "journal.json").write_text(json.dumps(journal))
    output = ("--output", str(tmp_path / "r.html"))
    assert tworelay("report", str(tmp_path), *output).returncode == 0


def test_two_stores_that_were_cut_off_leave_the_memory_unknown(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first has happened and the second has not: it is not taken for the old values."""
    run = measured(tworelay, link, "0.85")
    store = ProfiledDrive.store

    def answer_lost(drive: ProfiledDrive) -> None:
        store(drive)
        raise LinkLost("no answer")

    def refused(drive: ProfiledDrive) -> None:
        raise WriteFailed("store refused")

    for broken_store, act in ((answer_lost, "apply"), (refused, "restore")):
        with monkeypatch.context() as broken:
            broken.setattr(ProfiledDrive, "store", broken_store)
            assert tworelay(act, run, "--yes").returncode in (4, 7)
    assert (in_ram(link), in_memory(tmp_path)) == ([0, 0], [85, 85])
    assert said(tworelay, run) == "as found, not stored"
    assert tworelay("restore", run, "--yes").returncode == 0
    assert in_ram(link) == in_memory(tmp_path) == [0, 0]
    assert said(tworelay, run) == "as found"
