"""What is in a drive's RAM and what is in its memory, after several acts and runs."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from commissioning.rig.rig import Rig
from commissioning.session import verify
from drivers.errors import LinkLost, WriteFailed
from drivers.home import home
from drivers.link import axis_of, open_drive
from drivers.places import same_place
from drivers.profiled import ProfiledDrive
from tests.conftest import Serve, Tworelay
from tests.job.test_endings import AS_FOUND, RECORDED, kept, told
from tests.serving import WIRES

# -- what is in RAM and what is in the memory -----------------------------------------------------


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
    serve: Serve, tworelay: Tworelay
) -> None:
    """Else a bare `restore` would switch on what a later one has switched off.

    Of an axis without viscous friction, which two measurements give one count apart.
    """
    link = serve("bench?viscous=0", *WIRES["modbus-tcp"], "--clock", "step")[0]
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


# -- one drive, several runs ----------------------------------------------------------------------


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
