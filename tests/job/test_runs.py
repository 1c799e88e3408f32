"""Runs as people find them again.

By name, in the order in which they came, from wherever they lie.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from commissioning.journal import Journal
from commissioning.records import RunContext
from drivers.home import home
from drivers.link import axis_of, open_drive
from profiles.axis import load_axis
from profiles.errors import ProfileError
from tests import serving
from tests.command import ROOT
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES

# -- names ----------------------------------------------------------------------------------------

NAMES = (
    "Presse 7", "Achse-Ž", "a,b", "axis.", "軸 1", "-x", ".hidden", "CON", "x" * 100, "a/b", "50 %",
    "[red]",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_an_axis_is_called_what_people_call_it(
    name: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    file = tmp_path / "axis.toml"
    file.write_text(
        f'name = "{name}"\nlink = "virtual://bench"\nprofile = "virtual-modbus"\ntravel = 3\n',
        "utf-8",
    )
    done = tworelay("identify", str(file), "--yes", "--json", str(tmp_path / "run.json"))
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "run.json").read_text())
    assert result["axis"] == name
    assert result["run"].isascii()
    assert (home() / "runs" / result["run"] / "run.json").exists()
    assert tworelay("apply", result["run"], "--yes").returncode == 0
    listed = json.loads(tworelay("history", "list", "--json", "--", name).stdout)["runs"]
    assert [one["axis"] for one in listed] == [name]
    assert tworelay("export", "last", str(tmp_path / "sent")).returncode == 0
    other = {"TWORELAY_HOME": str(tmp_path / "other")}
    done = tworelay("adopt", str(tmp_path / "sent"), "--yes", environment=other)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("x" * 101, "has 101 characters"), ("", "must not be empty"), (" x",
        "begin or end with a space"),
        ("a\\nb", "one line of printable characters"), ("a\\u202eb",
        "one line of printable characters"),
    ],
)  # fmt: skip
def test_what_is_no_name_is_refused_when_the_file_is_read(
    name: str, words: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    file = tmp_path / "axis.toml"
    file.write_text(f'name = "{name}"\nlink = "virtual://bench"\n', "utf-8")
    done = tworelay("identify", str(file), "--yes")
    assert done.returncode == 2
    assert words in done.stderr
    assert not home().exists() or not (home() / "runs").exists()


def test_a_file_s_own_name_is_a_name_too(tmp_path: Path) -> None:
    for stem in ("Presse 7", "Achse-Ž", "a,b", "trailing."):
        (tmp_path / f"{stem}.toml").write_text('link = "virtual://bench"\n')
        assert load_axis(tmp_path / f"{stem}.toml").name == stem
    long = tmp_path / f"{'x' * 240}.toml"
    long.write_text('link = "virtual://bench"\n')
    with pytest.raises(ProfileError, match=r'has 240 characters.*name = "…"'):
        load_axis(long)


@pytest.mark.parametrize(
    ("link", "name"),
    [
        ("modbus-tcp://192.168.1.10?unit=3", "192.168.1.10-3"),
        ("modbus-tcp://192.168.1.10:1502", "192.168.1.10-1502-1"),
        ("modbus-rtu:///dev/ttyUSB0?unit=5", "ttyUSB0-5"),
        ("modbus-rtu:COM5?unit=2", "COM5-2"),
        ("canopen://socketcan/can0?node=17", "can0-17"),
        ("canopen://slcan/%2Fdev%2FttyACM0?node=7&bitrate=500000", "ttyACM0-7"),
        ("canopen://socketcand/gateway:29536/can1?node=5", "gateway-29536-can1-5"),
        ("virtual://mx106?coulomb=0.2", "mx106"),
    ],
)
def test_a_bare_link_is_called_by_what_it_is(link: str, name: str) -> None:
    assert axis_of(link).name == name


# -- order ----------------------------------------------------------------------------------------


def test_a_clock_that_was_corrected_backwards_changes_no_order(
    serve: Serve, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run A with the clock 30 days ahead, then run B: `apply last` writes B's values."""
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    other = serve("bench", "--set", "coulomb=0.3", *WIRES["modbus-tcp"], "--clock", "step")[0]
    with monkeypatch.context() as ahead:
        now = time.time
        ahead.setattr("commissioning.journal.time.time", lambda: now() + 30 * 86400)
        assert tworelay("identify", other, "--travel", "3", "--yes").returncode == 0
        assert tworelay("apply", "last", "--yes").returncode == 0
    assert tworelay("identify", link, "--travel", "3", "--yes").returncode == 0
    applied = tworelay("apply", "last", "--yes")
    assert applied.returncode == 0, applied.stderr
    drive = open_drive(axis_of(link))
    assert drive.read("coulomb_positive").raw == 85
    drive.close()
    runs = json.loads(tworelay("history", "--json").stdout)
    assert [round(one["coulomb"]["value"], 2) for one in runs] == [0.3, 0.1], "newest last"
    assert runs[0]["began"] > runs[1]["began"], "the wall clock is for people"
    done = tworelay("restore", "--yes")
    assert done.returncode == 0, done.stderr
    assert f"run {runs[1]['run']}" in done.stdout


def test_the_last_to_write_is_the_first_to_go_back(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        a, b = (
            journal.begin(
                axis="x", link="l", profile="p", profile_hash="", serial=serial,
                context=RunContext("{}")
            )
            for serial in "12"
        )  # fmt: skip
        for run in (a, b, a):
            journal.settle([journal.intend(run, "compensation", "p", 0, 1)], "verified")
        assert journal.run("last").id == b
        assert journal.open_runs() == [a, b]
        assert journal.last_written() == a


# -- drives that tell no serial number ------------------------------------------------------------


def test_two_drives_without_a_serial_do_not_block_each_other(
    serve: Serve, tworelay: Tworelay
) -> None:
    """Nothing empty is taken for an identity: the link is part of who it is."""
    twin = ("--modbus-tcp", "127.0.0.1:0", "--clock", "step", "--profile", "dsy-rs")
    one, two = (serve("bench", *twin)[0] for _ in range(2))
    drive = open_drive(axis_of(one).model_copy(update={"profile": "dsy-rs"}))
    assert drive.identity().serial == ""
    with Journal(home()) as journal:
        run = journal.begin(
            axis="x",
            link=one,
            profile="dsy-rs",
            profile_hash="",
            serial="",
            context=RunContext("{}"),
        )
        journal.intend(run, "experiment", "max_torque", 300, 200)
    drive.close()
    words = ("--profile", "dsy-rs", "--travel", "20", "--yes", "--dry-run", "--without-watchdog")
    refused = tworelay("identify", one, *words)
    assert refused.returncode == 3
    assert f"run {run} on this drive was cut off" in refused.stderr
    done = tworelay("identify", two, *words)
    assert done.returncode == 0, done.stderr


def test_a_served_twin_is_told_apart_by_its_state(tmp_path: Path) -> None:
    def serial(link: str) -> str:
        drive = open_drive(axis_of(link))
        found = drive.identity().serial
        drive.close()
        return found

    wire = (*WIRES["modbus-tcp"], "--clock", "step")
    with contextlib.ExitStack() as stack:
        first, again, other, changed = (
            serial(
                stack.enter_context(serving.serve("bench", *wire, *more, state=tmp_path / name))[0]
            )
            for name, more in (("a", ()), ("a", ()), ("b", ()), ("a", ("--set", "coulomb=0.2")))
        )
    assert first == again
    assert len({first, other, changed}) == 3


def test_two_demos_on_one_home_are_two_drives() -> None:
    demo = [sys.executable, "-m", "commissioning", "demo"]
    both = [
        subprocess.Popen(demo, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
        for _ in range(2)
    ]
    for process in both:
        out, errors = process.communicate(timeout=150)
        assert process.returncode == 0, errors
        assert "the drive's compensation is of this run, stored" in out


# -- what cannot be written is read ---------------------------------------------------------------


@contextlib.contextmanager
def nobody() -> Iterator[None]:
    """As a user who may write nothing there."""
    if os.geteuid():
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.mark.skipif(os.name == "nt", reason="rights of POSIX")
@pytest.mark.parametrize("ahead", [False, True], ids=["merged", "with an unmerged -wal"])
def test_a_home_that_cannot_be_written_is_read(
    ahead: bool, tworelay: Tworelay, after: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    after("commission", "virtual://bench", "--yes")
    with Journal(home()) as journal:
        run = journal.run("last").id
    for words in (("report", run), ("plot", "loci", run)):  # all that is imported later is here now
        assert tworelay(*words).returncode == 0
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        top.chmod(0o755)
        locked, work = top / "home", top / "work"
        if ahead:
            with Journal(home()) as journal:
                journal.note(run, "what is not merged yet")
                shutil.copytree(home(), locked)
        else:
            shutil.copytree(home(), locked)
        wal = locked / "journal.sqlite-wal"
        assert (wal.exists() and wal.stat().st_size > 0) is ahead
        (locked / "journal.sqlite-shm").unlink(missing_ok=True)
        work.mkdir()
        work.chmod(0o777)
        for path in (locked, *locked.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        before = {path: path.stat().st_mtime_ns for path in locked.rglob("*")}
        monkeypatch.setenv("TWORELAY_HOME", str(locked))
        monkeypatch.setattr("tests.command.ROOT", work)
        try:
            with nobody():
                done = {
                    words: tworelay(*words)
                    for words in (
                        ("report", "last"), ("plot", "loci", "last"), ("export", "last", "sent"),
                        ("history",),
                    )
                }  # fmt: skip
        finally:
            for path in (locked, *locked.rglob("*")):
                path.chmod(0o755)
        assert {words: one.returncode for words, one in done.items()} == dict.fromkeys(done, 0), {
            words: one.stderr for words, one in done.items()
        }
        assert (work / f"{run}-report.html").stat().st_size > 50_000, "said where, and there"
        assert (work / f"{run}-loci.svg").exists()
        journal_text = (work / "sent" / "journal.json").read_text()
        assert ("what is not merged yet" in journal_text) is ahead
        assert run in done["history",].stdout
        assert {path: path.stat().st_mtime_ns for path in locked.rglob("*")} == before


def test_reading_leaves_nothing_where_there_is_nothing(tworelay: Tworelay) -> None:
    assert tworelay("history").stdout.strip() == "no runs"
    done = tworelay("report", "last")
    assert done.returncode == 2
    assert "no run of this computer named 'last'" in done.stderr
    assert not home().exists()


# -- output that goes away ------------------------------------------------------------------------


@pytest.mark.skipif(os.name == "nt", reason="pipes of POSIX")
@pytest.mark.parametrize(
    ("words", "code", "drive"),
    [
        (("commission", "virtual://bench"), 0, "this run's, stored"),
        (("identify", "virtual://bench?coulomb=2.5"), 6, "as found"),
    ],
)
@pytest.mark.parametrize("reader", ["one that reads three lines", "a full device"])
def test_a_job_does_not_end_because_nobody_reads(
    words: tuple[str, ...], code: int, drive: str, reader: str, tworelay: Tworelay
) -> None:
    command = [sys.executable, "-m", "commissioning", *words, "--yes"]
    if reader == "a full device":
        if not Path("/dev/full").exists():
            pytest.skip("no /dev/full here")
        with Path("/dev/full").open("w") as full:
            ended = subprocess.run(
                command, stdout=full, stderr=subprocess.PIPE, cwd=ROOT, timeout=150, check=False
            )
        assert ended.returncode == code, ended.stderr
    else:
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
        ) as process:
            assert process.stdout is not None
            for _ in range(3):
                process.stdout.readline()
            process.stdout.close()
            assert process.wait(timeout=150) == code
    (run,) = json.loads(tworelay("history", "--json").stdout)
    assert run["drive"] == drive
    assert run["verdict"] == ("good" if not code else "rejected")


# -- the list -------------------------------------------------------------------------------------


def test_the_list_says_what_was_found_and_what_is_in_the_drive(tworelay: Tworelay) -> None:
    for words in (
        ("identify", "virtual://bench"), ("identify", "virtual://bench", "--duration", "2.5"),
        ("commission", "virtual://mx106?encoder=131072"),
    ):  # fmt: skip
        tworelay(*words, "--yes")
    rows = json.loads(tworelay("history", "--json").stdout)
    assert [(one["axis"], one["verdict"], one["drive"]) for one in rows] == [
        ("bench", "good", "as found"), ("bench", "stopped", "as found"),
        ("mx106", "good", "this run's, stored"),
    ]  # fmt: skip
    assert rows[0]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    assert rows[0]["coulomb"]["low"] < 0.1 < rows[0]["coulomb"]["high"]
    assert rows[1]["coulomb"] is None
    text = tworelay("history").stdout
    assert text.index(rows[0]["run"]) < text.index(rows[2]["run"])
    assert "this run's, stored" in text
    few = tworelay("history", "bench", "--most", "1").stdout
    assert "1 older runs are not shown: --all" in few
    assert rows[1]["run"] in few
    assert rows[2]["run"] not in few
    nosuch = tworelay("history", "nosuch").stdout.strip()
    assert nosuch == "no runs of axis 'nosuch'; there are: bench, mx106"
    shutil.rmtree(home() / "runs" / rows[0]["run"])
    assert json.loads(tworelay("history", "--json").stdout)[0]["verdict"] == "files missing"
