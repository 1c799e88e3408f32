"""Fleet runs as a user types them, with processes of their own."""

from __future__ import annotations

import csv
import json
import os
import signal
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import jsonschema
import pytest

from commissioning.fleet.ledger import Ledger
from commissioning.result.fleet import JobState
from commissioning.result.fleet_codec import fleet_schema
from tests.command import ROOT, in_this_process, running

AXIS = '[[axes]]\nname = "{0}"\nlink = "virtual://bench?{1}"\n'
HEAD = 'job = "identify"\nconfirm = "yes"\n[groups.g]\n'
GOOD, JAMMED = "coulomb=0.15", "coulomb=5&seed=2"


@pytest.fixture
def line(tmp_path: Path) -> Path:
    """Three axes: one in order, one that is jammed, and one of its group."""
    path = tmp_path / "line.toml"
    path.write_text(
        HEAD + AXIS.format("good", GOOD) + AXIS.format("jammed", JAMMED) + 'group = "g"\n'
        + AXIS.format("beside", "seed=3") + 'group = "g"\n'
    )  # fmt: skip
    return path


def run(*arguments: str) -> tuple[int, str, str]:
    done = in_this_process("fleet", *arguments)
    return done.returncode, done.stdout, done.stderr


def test_a_run_leaves_all_that_others_read(line: Path, tmp_path: Path, state_folder: Path) -> None:
    files = {kind: tmp_path / f"out.{kind}" for kind in ("json", "junit", "csv")}
    options = [part for kind, file in files.items() for part in (f"--{kind}", str(file))]
    code, said, errors = run("run", str(line), *options)
    assert (code, errors) == (9, "")
    tree = json.loads(files["json"].read_text())
    jsonschema.validate(tree, fleet_schema())
    states = {axis["name"]: axis["state"] for axis in tree["axes"]}
    assert states == {"good": "done", "jammed": "rejected", "beside": "blocked"}
    good = next(axis for axis in tree["axes"] if axis["name"] == "good")
    found = good["outcome"]["coulomb"]
    assert found["low"] < 0.15 < found["high"]
    assert good["confirmed"]["how"] == 'confirm = "yes" in the file'
    suite = ET.parse(files["junit"]).getroot()[0]
    assert {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")} == {
        "tests": "3", "failures": "1", "errors": "0", "skipped": "1",
    }  # fmt: skip
    case = suite.find("testcase[@name='jammed: identify']")
    assert case is not None
    assert case.get("classname") == "line.g"
    number = suite.find(".//property[@name='coulomb [N.m]']")
    assert number is not None
    assert float(number.get("value") or 0) == pytest.approx(0.15, rel=0.02)
    rows = {row["axis"]: row for row in csv.DictReader(files["csv"].read_text().splitlines())}
    assert float(rows["good"]["coulomb"]) == pytest.approx(found["value"])
    assert rows["beside"]["state"] == "blocked"
    folder = state_folder / "fleets" / tree["fleet_run"]
    assert {path.name for path in folder.iterdir()} >= {
        "fleet.html", "acceptance.html", "fleet.json"
    }  # fmt: skip
    assert 'http-equiv="refresh"' not in (folder / "fleet.html").read_text()
    record = (folder / "acceptance.html").read_text()
    assert good["serial"] in record
    assert good["outcome"]["sha256"] in record
    assert "1 done, 1 rejected, 1 blocked" in said
    assert (line.parent / "line.serials.toml").exists()
    code, said, _ = run("status", "--json")
    for known, told in zip(json.loads(said)["axes"], tree["axes"], strict=True):
        for key in ("step", "steps", "ended", "began"):  # of the moment, and of its second
            known.pop(key), told.pop(key)
        assert known == told


def test_the_published_schema_is_that_of_the_types() -> None:
    assert json.loads((ROOT / "docs/fleet.schema.json").read_text()) == fleet_schema()


def test_again_is_a_new_attempt_and_resume_what_was_not_started(
    line: Path, state_folder: Path
) -> None:
    assert run("run", str(line), "--only", "jammed")[0] == 9
    text = line.read_text().replace(JAMMED, "coulomb=0.2&seed=2")
    line.write_text(text)
    code, _, errors = run("run", str(line), "--resume")
    assert code == 3
    assert "has changed since" in errors
    assert "axes.jammed.link is" in errors
    line.write_text(text.replace("coulomb=0.2&seed=2", JAMMED))
    code, said, _ = run("run", str(line), "--again", "failed")
    assert code == 9
    with Ledger(state_folder, reading=True) as ledger:
        of_run = ledger.record("last")
        attempts = [(row.axis, row.attempt, str(row.state)) for row in ledger.attempts(of_run.id)]
    assert ("jammed", 1, "rejected") in attempts
    assert ("jammed", 2, "rejected") in attempts
    assert ("good", 1, "skipped") in attempts
    code, said, _ = run("run", str(line), "--resume")
    assert code == 9
    assert "good" in said
    assert _states(state_folder)["good"] == "skipped", "nobody has asked for it"
    code, _, errors = run("run", str(line), "--again", "good")
    assert code == 3
    assert "nothing to do again" in errors
    assert "its runner is gone" not in run("status")[1]
    code, _, errors = run("run", str(line), "--again", "nobody")
    assert code == 2
    assert "nobody" in errors


def _states(home: Path) -> dict[str, str]:
    with Ledger(home, reading=True) as ledger:
        rows = ledger.rows(ledger.record("last").id)
    return {name: str(row.state) for name, row in rows.items()}


def test_exchanged_drives_are_both_refused(line: Path) -> None:
    assert run("run", str(line), "--only", "good,beside")[0] == 0
    text = line.read_text()
    line.write_text(text.replace(GOOD, "x").replace("seed=3", GOOD).replace("?x", "?seed=3"))
    code, said, errors = run("run", str(line), "--only", "good,beside")
    assert code == 3
    assert "'good' and 'beside' are exchanged" in said
    assert errors == ""
    code, _, errors = run("check", str(line), "--only", "good,beside", "--accept-serial", "good")
    assert code == 2
    assert "is the drive of 'beside': accept both" in errors
    code, said, _ = run("check", str(line), "--only", "good,beside", "--accept-serial", "good",
                        "--accept-serial", "beside")  # fmt: skip
    assert "is its drive from now on, was" in said
    assert code == 0
    assert "2 of 2 axes can be moved" in said


REAL = '[[axes]]\nname = "real"\nlink = "modbus-tcp://192.0.2.1?unit=1"\ntravel = 1.0\n'


@pytest.mark.parametrize(
    ("confirm", "options", "ci", "code"),
    [
        ("yes", [], "", "not enough for real drives"),
        ("group", ["--yes"], "", "--yes is not enough"),
        ("yes", ["--yes"], "1", "CI is set"),
        ("yes", [], "1", "CI is set"),
        ("group", [], "", "no terminal"),
    ],
)
def test_nothing_real_moves_without_somebody_who_sees_it(
    confirm: str, options: list[str], ci: str, code: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, state_folder: Path,
) -> None:  # fmt: skip
    monkeypatch.setenv("CI", ci)
    path = tmp_path / "line.toml"
    path.write_text(f'job = "identify"\nconfirm = "{confirm}"\n' + REAL)
    out = tmp_path / "out.json"
    exit_code, _, errors = run("run", str(path), *options, "--json", str(out))
    assert exit_code == 3
    assert code in errors
    assert errors.count("\n") == 1
    tree = json.loads(out.read_text())
    jsonschema.validate(tree, fleet_schema())
    assert code in tree["notes"][0]
    assert not (state_folder / "fleets").exists()


def test_what_is_not_there_is_named(line: Path, state_folder: Path) -> None:
    for command in (["status"], ["report"], ["stop"], ["restore"], ["run", str(line), "--resume"]):
        code, _, errors = run(*command)
        assert code == 2, command
        assert "no fleet run" in errors
    assert run("run", str(line), "--resume", "--again", "good")[0] == 2
    assert run("run", str(line.with_name("none.toml")))[0] == 2
    assert run("status", "20990101-000000-fleet-x")[0] == 2


def test_a_home_that_cannot_be_written(
    line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TWORELAY_HOME", str(tmp_path / "file" / "home"))
    code, _, errors = run("run", str(line))
    assert code == 7
    assert errors.count("\n") == 1
    assert "cannot be written" in errors


def test_a_broken_axis_file_is_refused_and_the_others_run(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text("link = 3\n")
    path = tmp_path / "line.toml"
    path.write_text(HEAD + '[[axes]]\nfile = "x.toml"\n' + AXIS.format("good", GOOD))
    code, said, _ = run("run", str(path))
    assert code == 9
    assert "x: refused" in said
    assert "good: done" in said


def test_a_dry_run_shows_every_write_and_does_none(line: Path, state_folder: Path) -> None:
    code, said, _ = run("run", str(line), "--dry-run")
    assert code == 0
    assert "max_speed" in said
    assert "nothing was written or moved" in said
    with Ledger(state_folder) as ledger, pytest.raises(Exception, match="no fleet run"):
        ledger.record("last")


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_ctrl_c_finishes_what_runs_and_resume_does_the_rest(
    tmp_path: Path, state_folder: Path
) -> None:
    path = tmp_path / "line.toml"
    path.write_text(HEAD + "".join(AXIS.format(f"a{n}", f"seed={n}") for n in range(9)))
    with running("fleet", "run", str(path), "--at-once", "1") as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "a0: done" in line:
                process.send_signal(signal.SIGINT)
                break
        said = process.stdout.read()
        assert process.wait(60) == 130
    assert "nothing more starts" in said
    with Ledger(state_folder, reading=True) as ledger:
        states = [row.state for row in ledger.rows(ledger.record("last").id).values()]
    assert states.count(JobState.DONE) < 9
    assert set(states) == {JobState.DONE, JobState.WAITING}
    code, _, _ = run("run", str(path), "--resume")
    assert code == 0
    with Ledger(state_folder, reading=True) as ledger:
        attempts = ledger.attempts(ledger.record("last").id)
    assert [row.attempt for row in attempts] == [1] * 9


@pytest.mark.skipif(os.name == "nt", reason="serves pseudo-terminals, too")
def test_a_rehearsal_touches_no_drive_and_shares_buses(
    tmp_path: Path, state_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "line.toml"
    path.write_text(
        'job = "identify"\nconfirm = "group"\n[defaults]\ntravel = 3.0\ncycle = 0.004\n'
        '[[axes]]\nname = "u1"\nlink = "modbus-tcp://192.0.2.1?unit=1"\nserial = "0x1"\n'
        '[[axes]]\nname = "u2"\nlink = "modbus-tcp://192.0.2.1?unit=2"\n'
        '[[axes]]\nname = "n5"\nlink = "canopen://socketcan/can0?node=5"\n'
        "profile = \"maxon-epos4\"\n"
    )  # fmt: skip
    monkeypatch.setenv("TWORELAY_HOME", str(state_folder))
    out = tmp_path / "out.json"
    code, said, errors = run("rehearse", str(path), "--json", str(out))
    assert code == 0, said + errors
    tree = json.loads(out.read_text())
    assert tree["rehearsed"] is True
    links = [axis["link"] for axis in tree["axes"]]
    assert links[0].replace("unit=1", "unit=2") == links[1]
    assert all("192.0.2" not in link and "can0" not in link.split("/")[2] for link in links)
    assert not (tmp_path / "line.serials.toml").exists()
    assert (state_folder / "rehearsal" / "fleets").exists()
    assert not (state_folder / "fleets").exists()


@pytest.mark.skipif(os.name == "nt", reason="kills a process")
def test_a_runner_that_is_killed_leaves_an_account(tmp_path: Path, state_folder: Path) -> None:
    path = tmp_path / "line.toml"
    path.write_text(HEAD + "".join(AXIS.format(f"a{n}", f"seed={n}") for n in range(6)))
    with running("fleet", "run", str(path), "--at-once", "1") as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "a1: done" in line:
                process.kill()
                break
        process.wait()
    until = time.monotonic() + 60
    while time.monotonic() < until:  # its worker finishes the axis that it has
        with Ledger(state_folder, reading=True) as ledger:
            of_run = ledger.record("last")
            rows = ledger.rows(of_run.id).values()
        if not any(row.state is JobState.STARTED and row.is_alive for row in rows):
            break
        time.sleep(0.1)
    code, said, _ = run("status")
    assert code == 0
    assert "its runner is gone" in said
    code, _, _ = run("run", str(path), "--resume")
    with Ledger(state_folder, reading=True) as ledger:
        states = {str(row.state) for row in ledger.rows(of_run.id).values()}
    assert states == {"done"}
    assert code == 0


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_one_run_of_a_fleet_file_at_a_time_and_it_can_be_stopped(
    tmp_path: Path, state_folder: Path
) -> None:
    path = tmp_path / "line.toml"
    path.write_text(HEAD + "".join(AXIS.format(f"a{n}", f"seed={n}") for n in range(30)))
    with running("fleet", "run", str(path), "--at-once", "1") as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "a0: started" in line:
                break
        code, _, errors = run("run", str(path), "--only", "a20")
        assert code == 3
        assert "is under way" in errors
        code, said, _ = run("stop")
        assert code == 0
        assert said.endswith("moves\n")
        states = _states(state_folder)
        assert not {"granted", "started"} & set(states.values())
        assert process.wait(60) in (3, 9)
    stopped = [name for name, state in states.items() if state == "stopped"]
    with Ledger(state_folder, reading=True) as ledger:
        rows = ledger.rows(ledger.record("last").id)
    assert all("fleet stop" in rows[name].why for name in stopped)


def test_files_that_are_taken_for_each_other(tmp_path: Path) -> None:
    axis, fleet = tmp_path / "x.toml", tmp_path / "line.toml"
    axis.write_text('link = "virtual://bench"\n')
    fleet.write_text(HEAD + AXIS.format("good", GOOD))
    code, _, errors = run("check", str(axis))
    assert code == 2
    assert "is an axis file" in errors
    done = in_this_process("identify", str(fleet), "--yes")
    assert done.returncode == 2
    assert "is a fleet file" in done.stderr


def test_a_check_says_whom_the_group_would_hold_back(tmp_path: Path) -> None:
    path = tmp_path / "line.toml"
    gone = '[[axes]]\nname = "gone"\nlink = "modbus-tcp://127.0.0.1:1"\ntravel = 1.0\ngroup = "g"\n'
    path.write_text(HEAD + gone + AXIS.format("beside", "seed=3") + 'group = "g"\n')
    code, said, _ = run("check", str(path))
    assert code == 9
    assert "gone: cannot connect to 127.0.0.1:1" in said
    assert "0 of 2 axes can be moved" in said
