"""What stays in the drive.

Nothing that was not proved, nothing half restored, nothing stored twice.
"""

from __future__ import annotations

import json
import os
import re
import signal
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from markupsafe import escape

from commissioning.errors import Interrupted
from commissioning.journal import RESTORED, STORED, STORING, Journal
from commissioning.records import UP_TO
from commissioning.rig.mover import Mover
from commissioning.rig.rig import Rig
from drivers.errors import DriveFault, LinkLost, WriteDenied, WriteFailed
from drivers.home import home
from drivers.link import axis_of, open_drive
from drivers.modbus.bus import ModbusBus
from drivers.preparation import Preparation
from drivers.profiled import ProfiledDrive
from profiles.address import Address
from profiles.axis import Axis
from profiles.library import load_profile, source_text
from tests.command import ROOT
from tests.conftest import Serve, Tworelay

NAMES = ("torque_offset", "coulomb_positive", "coulomb_negative", "viscous_gain")
ASKED = ("--travel", "3", "--yes", "--method", "modulating", "--cycle", "0.008")
KNOWN = load_profile("virtual-modbus").parameters


@pytest.fixture
def link(serve: Serve) -> str:
    """A drive that keeps its RAM from one connection to the next,
    with friction already in its memory."""
    made = serve("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "step")[0]
    drive = open_drive(axis_of(made))
    drive.write("coulomb_positive", 20)
    drive.store()
    drive.close()
    return made


def values(link: str) -> dict[str, int]:
    drive = open_drive(axis_of(link))
    found = {name: drive.read(name).raw for name in NAMES}
    drive.close()
    return found


FOUND = {"torque_offset": 0, "coulomb_positive": 20, "coulomb_negative": 0, "viscous_gain": 0}
PROVED = {"torque_offset": 0, "coulomb_positive": 85, "coulomb_negative": 85, "viscous_gain": 170}


def stored(tmp_path: Path) -> dict[str, int]:
    """What is in the served drive's non-volatile memory."""
    kept = json.loads((tmp_path / "drive-0.json").read_text())
    return {name: kept.get(name, 0) for name in NAMES}


def events() -> list[str]:
    with Journal(home()) as journal:
        return [e.text for e in journal.history("last").events if not e.text.startswith(UP_TO)]


def open_parameters() -> set[str]:
    with Journal(home()) as journal:
        run = journal.run("last").id
        return {i.parameter for i in journal.intents(run, open_only=True)}


# -- commission -----------------------------------------------------------------------------------


def test_what_is_proved_is_stored_once_and_not_before(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[dict[str, int], list[str]]] = []
    follow = Rig.follow

    def watched(job: Rig, path: Any) -> Any:
        seen.append((stored(tmp_path), events()))
        return follow(job, path)

    monkeypatch.setattr(Rig, "follow", watched)
    done = tworelay("commission", link, *ASKED)
    assert done.returncode == 0, done.stderr
    assert seen
    assert all(kept == FOUND and said == [] for kept, said in seen), (
        "in RAM only, while it is proved"
    )
    assert values(link) == stored(tmp_path) == pytest.approx(PROVED, rel=0.1)
    assert events() == [STORING, STORED]
    assert "STORE what helps, or put the old values back" in done.stdout


def failing(error: BaseException, after: int) -> Callable[..., Any]:
    """A proof that ends by an error after some steps."""
    follow, count = Rig.follow, []

    def fails(job: Rig, path: Any) -> Any:
        count.append(job)
        if len(count) > after:
            raise error
        return follow(job, path)

    return fails


@pytest.mark.parametrize("after", [0, 2])
@pytest.mark.parametrize(
    ("error", "code"),
    [
        (DriveFault("the drive stopped by itself"), 5),
        (LinkLost("the link is lost"), 4),
        (Interrupted("interrupted by SIGINT", signal.SIGINT), 130),
        (WriteFailed("it was not taken"), 7),
    ],
    ids=["fault", "link", "Ctrl-C", "write"],
)
def test_what_is_not_proved_does_not_stay(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    error: Exception, code: int, after: int,
) -> None:  # fmt: skip
    monkeypatch.setattr(Rig, "follow", failing(error, after))
    done = tworelay("commission", link, *ASKED, "--json", str(tmp_path / "run.json"))
    assert done.returncode == code
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith(f"tworelay: {error.args[0].partition(';')[0]}")
    assert "the drive is as it was found (" in line
    assert values(link) == stored(tmp_path) == FOUND
    assert open_parameters() == set()
    assert events() == [], "nothing was stored"
    result = json.loads((tmp_path / "run.json").read_text())
    cause, note = result["notes"]
    assert cause.startswith(f"not proved: {error.args[0].partition(';')[0]}")
    assert note.startswith("the drive is as it was found")
    (report,) = (home() / "runs").glob("*/report.html")
    assert escape(note) in report.read_text("utf-8")
    assert result["written"] == []
    assert result["ending"]["drive"]["compensation"] == "as it was found"
    assert tworelay("restore", "--yes").stdout.strip() == "nothing to restore"


def test_what_cannot_be_put_back_is_named_and_can_be_restored_later(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(Rig, "follow", failing(LinkLost("the link is lost"), 1))
        write = ProfiledDrive.write
        gone: list[bool] = []

        def dead(drive: ProfiledDrive, name: str, raw: int) -> None:
            if gone or (name == "coulomb_negative" and raw == 0 and open_parameters()):
                gone.append(True)
                raise LinkLost("no answer")
            write(drive, name, raw)

        broken.setattr(ProfiledDrive, "write", dead)
        done = tworelay("commission", link, *ASKED)
    assert done.returncode == 4
    (line,) = done.stderr.strip().splitlines()
    left = open_parameters()
    assert {"coulomb_positive", "coulomb_negative"} <= left
    named = re.search(r"NOT put back: ([\w, ]+) \(", line)
    assert named is not None
    assert {"coulomb_negative"} <= set(named[1].split(", ")) <= left
    run = re.search(r"'tworelay restore (\S+)'", line)
    assert run is not None
    restored = tworelay("restore", "--yes", run[1])
    assert restored.returncode == 0, restored.stderr
    assert values(link) == stored(tmp_path) == FOUND
    assert events() == []


def test_only_what_is_not_back_is_named_and_counts_as_written(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(Rig, "follow", failing(DriveFault("it tripped"), 1))
        write = ProfiledDrive.write

        def refuses(drive: ProfiledDrive, name: str, raw: int) -> None:
            if (name, raw) == ("coulomb_positive", FOUND["coulomb_positive"]):
                raise WriteDenied("no")
            write(drive, name, raw)

        broken.setattr(ProfiledDrive, "write", refuses)
        done = tworelay("commission", link, *ASKED, "--json", str(tmp_path / "run.json"))
    assert done.returncode == 5
    assert "NOT put back: coulomb_positive (" in done.stderr
    written = json.loads((tmp_path / "run.json").read_text())["written"]
    assert {item["parameter"] for item in written} == {"coulomb_positive"}
    assert tworelay("restore", "--yes").returncode == 0
    assert values(link) == FOUND


def test_a_ctrl_c_while_the_drive_is_put_back_hides_nothing(
    link: str, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = ProfiledDrive.write

    def pressed(drive: ProfiledDrive, name: str, raw: int) -> None:
        write(drive, name, raw)
        if (name, raw) == ("coulomb_positive", FOUND["coulomb_positive"]):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Rig, "follow", failing(DriveFault("it tripped"), 1))
    monkeypatch.setattr(ProfiledDrive, "write", pressed)
    done = tworelay("commission", link, *ASKED)
    assert done.returncode == 5
    assert "it tripped; the drive is as it was found" in done.stderr
    assert values(link) == FOUND


def test_what_does_not_help_is_not_in_the_memory_either(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from commissioning.session import verify

    monkeypatch.setattr(verify, "reversal_error", lambda command, position, turns: (0.01, position))
    done = tworelay("commission", link, *ASKED)
    assert done.returncode == 8
    assert "the compensation does not help" in done.stderr
    assert values(link) == stored(tmp_path) == FOUND
    assert open_parameters() == set()
    assert events() == []


def test_what_acts_only_once_it_is_stored_cannot_be_tried_and_is_not_written(
    link: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    """Steps in RAM would all be the same to it, and the proof a comparison of equal things."""
    text = source_text("virtual-modbus")
    profile = tmp_path / "acts.toml"
    profile.write_text(text.replace("[compensation]", "[compensation]\nacts_stored = true", 1))
    done = tworelay("commission", link, *ASKED, "--profile", str(profile))
    assert done.returncode == 3
    assert "acts only once it is stored, so it cannot be tried step by step" in done.stderr
    assert "nothing was written; 'tworelay apply" in done.stderr
    assert values(link) == stored(tmp_path) == FOUND


def test_a_drive_whose_compensation_cannot_be_seen_at_work_gets_nothing_unproved(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    text = (ROOT / "tests/faults/two_key.toml").read_text()
    head, rest = text.split("[[modes.position]]")
    profile = tmp_path / "torque_only.toml"
    profile.write_text(head + rest.partition("\n\n")[2])
    twin = ("--profile", str(profile), "--modbus-tcp", "127.0.0.1:0", "--clock", "step")
    (made,) = serve("bench", *twin)
    done = tworelay("commission", made, "--profile", str(profile), *ASKED)
    assert done.returncode == 3
    assert "has no position mode in which its compensation acts" in done.stderr
    assert "nothing was written; 'tworelay apply" in done.stderr
    drive = open_drive(Axis(link=made, profile=str(profile)))
    assert drive.read("friction_positive").raw == 0
    drive.close()


# -- verify alone ---------------------------------------------------------------------------------


def test_gains_in_the_memory_are_not_forgotten_when_the_compensation_does_not_help(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`verify` takes its own values out of the memory; what else the run stored is still in it."""
    from commissioning.session import verify

    gains = ("position_gain", "velocity_gain", "integral_time")
    before = {n: json.loads((tmp_path / "drive-0.json").read_text())[n] for n in gains}
    assert tworelay("identify", link, *ASKED).returncode == 0
    assert tworelay("tune", "last").returncode == 0
    done = tworelay("apply", "last", "--yes", "--gains", "cascade")
    assert done.returncode == 0, done.stderr
    monkeypatch.setattr(verify, "reversal_error", lambda command, position, turns: (0.01, position))
    assert tworelay("verify", "last", "--yes").returncode == 8
    assert open_parameters() == set(gains)
    assert tworelay("restore", "--yes").returncode == 0
    kept = json.loads((tmp_path / "drive-0.json").read_text())
    assert {name: kept[name] for name in gains} == before
    assert events()[-1] == RESTORED
    assert open_parameters() == set()


def test_a_bug_in_a_proof_leaves_what_was_there(
    link: str, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    from commissioning.session import verify

    assert tworelay("identify", link, *ASKED).returncode == 0
    count: list[int] = []

    def wrong(*arguments: object) -> tuple[float, Any]:
        count.append(1)
        if len(count) == 2:
            raise ZeroDivisionError
        return 0.01, arguments[1]

    monkeypatch.setattr(verify, "reversal_error", wrong)
    assert tworelay("verify", "last", "--yes").returncode == 1
    assert values(link) == FOUND


def test_a_store_whose_answer_is_lost_is_told_to_be_doubtful(
    link: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert tworelay("identify", link, *ASKED).returncode == 0
    store = ProfiledDrive.store

    def lost(drive: ProfiledDrive) -> None:
        store(drive)
        raise LinkLost("no answer")

    with monkeypatch.context() as broken:
        broken.setattr(ProfiledDrive, "store", lost)
        done = tworelay("verify", "last", "--yes")
    assert done.returncode == 4
    assert "not known to be stored: " in done.stderr
    assert "the drive's memory may hold what was to stay: 'tworelay restore" in done.stderr
    assert values(link) == FOUND
    assert stored(tmp_path) != FOUND
    assert tworelay("restore", "--yes").returncode == 0
    assert values(link) == stored(tmp_path) == FOUND


# -- restore --------------------------------------------------------------------------------------


@pytest.fixture
def applied(link: str, tworelay: Tworelay) -> str:
    """A drive with a run's values in its memory."""
    assert tworelay("identify", link, *ASKED).returncode == 0
    done = tworelay("apply", "last", "--yes")
    assert done.returncode == 0, done.stderr
    assert events() == [STORING, STORED]
    return link


def refusing(
    monkeypatch: pytest.MonkeyPatch, names: set[str], *, busy: bool = False, times: int = 1 << 30
) -> list[str]:
    """A drive that refuses writes to some parameters, so many times; what it was asked."""
    addresses = {str(KNOWN[name].address): name for name in names}
    write = ModbusBus.write
    asked: list[str] = []

    def refuses(bus: ModbusBus, address: Address, raw: int) -> None:
        if str(address) in addresses and len(asked) < times:
            asked.append(addresses[str(address)])
            raise WriteDenied(f"{address}: exception {6 if busy else 3}", busy=busy)
        write(bus, address, raw)

    monkeypatch.setattr(ModbusBus, "write", refuses)
    return asked


def test_nothing_is_stored_unless_everything_is_back(
    applied: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = stored(tmp_path)
    with monkeypatch.context() as broken:
        refusing(broken, {"coulomb_negative"})
        done = tworelay("restore", "--yes")
    assert done.returncode == 7
    assert (
        "failed coulomb_negative ('coulomb_negative': register 0402h: exception 3)" in done.stderr
    )
    assert "nothing was stored" in done.stderr
    assert stored(tmp_path) == before, "the memory has one whole set, not half of two"
    assert events() == [STORING, STORED]
    assert {"coulomb_positive", "coulomb_negative"} <= open_parameters()
    assert tworelay("restore", "--yes").returncode == 0
    assert values(applied) == stored(tmp_path) == FOUND
    assert events() == [STORING, STORED, STORING, RESTORED]
    assert open_parameters() == set()


def test_a_store_that_fails_names_what_is_not_stored_and_is_not_counted(
    applied: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as broken:
        refusing(broken, {"store_command"})
        done = tworelay("restore", "--yes")
    assert done.returncode == 7
    assert "store: 'store_command': register 0500h: exception 3" in done.stderr
    named = re.search(r"not known to be stored: ([\w, ]+); 'tworelay restore", done.stderr)
    assert named is not None
    assert set(named[1].split(", ")) == open_parameters() >= {"coulomb_positive"}
    with Journal(home()) as journal:
        assert journal.stores(journal.run("last").id) == 1
    assert tworelay("restore", "--yes").returncode == 0
    assert values(applied) == stored(tmp_path) == FOUND


@pytest.mark.parametrize("name", ["coulomb_negative", "store_command"])
def test_a_busy_drive_is_asked_again(
    applied: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    asked = refusing(monkeypatch, {name}, busy=True, times=8)
    done = tworelay("restore", "--yes")
    assert done.returncode == 0, done.stderr
    assert len(asked) == 8
    assert values(applied) == stored(tmp_path) == FOUND
    assert events()[2:] == [STORING, RESTORED], "stored once"


def test_patience_with_a_busy_drive_ends_and_its_key_is_named(
    applied: str, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = refusing(monkeypatch, {"coulomb_negative"}, busy=True)
    done = tworelay("restore", "--yes")
    assert done.returncode == 7
    assert "it was asked again for 5 s ([link] patience in the profile)" in done.stderr
    assert len(asked) == 101, "every 50 ms"


def test_a_restore_stores_only_what_the_run_stored(
    link: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    """A run that was killed before its proof has changed RAM alone."""
    assert tworelay("identify", link, *ASKED).returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0
    with sqlite3.connect(home() / "journal.sqlite") as db:
        db.execute("DELETE FROM events")
    db.close()
    stamp = (tmp_path / "drive-0.json").stat().st_mtime_ns
    assert tworelay("restore", "--yes").returncode == 0
    assert values(link) == FOUND
    assert events() == []
    assert (tmp_path / "drive-0.json").stat().st_mtime_ns == stamp


def test_a_store_that_was_cut_off_is_one_that_may_have_happened(
    link: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    assert tworelay("identify", link, *ASKED).returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0
    with sqlite3.connect(home() / "journal.sqlite") as db:
        db.execute("DELETE FROM events WHERE text=?", (STORED,))
    db.close()
    assert tworelay("restore", "--yes").returncode == 0
    assert values(link) == stored(tmp_path) == FOUND
    assert events() == [STORING, STORING, RESTORED]


def test_the_lock_on_other_masters_is_not_stored(
    applied: str, tworelay: Tworelay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """'Save all' saves what is in force at that moment."""
    locked: list[int] = []
    store = ProfiledDrive.store

    def lock(drive: Preparation) -> dict[str, int]:
        return {"max_torque": 2000}

    def looked(drive: ProfiledDrive) -> None:
        locked.append(drive.read("max_torque").raw)
        store(drive)

    monkeypatch.setattr(Preparation, "exclusive_access", lock)
    monkeypatch.setattr(ProfiledDrive, "store", looked)
    assert tworelay("restore", "--yes").returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0
    assert locked == [3000, 3000]


# -- a Ctrl-C at any moment -----------------------------------------------------------------------


@pytest.mark.parametrize("command", ["identify", "commission"])
def test_a_ctrl_c_while_a_fault_is_cleared_is_not_lost(
    link: str, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """It came at the end of the last step: the job stored, and ended with 0."""
    clear, seen = Mover.clear_own_fault, []

    def pressed(job: Mover) -> None:
        seen.append(True)
        if len(seen) == (
            2 if command == "identify" else 3
        ):  # the proof of the stop path is the first
            os.kill(os.getpid(), signal.SIGINT)
        clear(job)

    monkeypatch.setattr(Mover, "clear_own_fault", pressed)
    done = tworelay(command, link, *ASKED)
    assert done.returncode == 130, done.stdout
    assert "interrupted by SIGINT" in done.stderr
    assert values(link) == FOUND
    assert STORED not in events()
    drive = open_drive(axis_of(link))
    assert drive.read("mode_of_operation").raw == 0, "the settings are back all the same"
    drive.close()
