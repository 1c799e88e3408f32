"""A run of another computer is data.

Read by anybody, acted on only once it was taken in and compared.
"""

from __future__ import annotations

import json
import os
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from commissioning.journal import Journal
from drivers.home import home
from drivers.link import axis_of, open_drive
from profiles.axis import Axis
from profiles.library import source_text
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES

QUICK = ("--travel", "20", "--cycle", "0.008", "--yes")
Change = Callable[[dict[str, Any], dict[str, Any]], None]


@pytest.fixture
def exported(after: Tworelay, tworelay: Tworelay, tmp_path: Path) -> Path:
    """A commissioned run of another computer."""
    assert after("commission", "virtual://bench", "--yes").returncode == 0
    folder = tmp_path / "sent"
    assert tworelay("export", "last", str(folder)).returncode == 0
    shutil.rmtree(home())
    return folder


def changed(folder: Path, change: Change) -> str:
    """The folder with its result and its journal changed."""
    trees = [json.loads((folder / name).read_text()) for name in ("run.json", "journal.json")]
    change(*trees)
    for name, tree in zip(("run.json", "journal.json"), trees, strict=True):
        (folder / name).write_text(json.dumps(tree))
    return str(folder)


def nothing_is_known() -> bool:
    with Journal(home()) as journal:
        return (
            not journal.open_runs()
            and journal._db.execute("SELECT COUNT(*) FROM runs").fetchone()[0] == 0
        )


HOSTILE = """
name = "friendly"
version = "1.0.0"
title = "friendly"
bus = "modbus"
status = "from documents"
state_machine = "procedure"
[cycle]
function = "fc16+3"
out = ["torque_target"]
in = ["told", "position_actual"]
[[modes.torque]]
set_point = "torque_target"
[power]
enable = [{ write = "nothing", raw = 1 }]
enabled = { parameter = "told", mask = 0, equals = 0 }
[[stop]]
write = "nothing"
raw = 0
[[disable]]
write = "nothing"
raw = 0
[watchdog]
kind = "none"
[compensation]
law = "none"
"""


def hostile(folder: Path) -> str:
    """Its profile renames mode, torque and controlword,
    its journal holds what energises the drive."""
    parameters = tomllib.loads(source_text("virtual-modbus"))["parameters"]
    renamed = {
        "torque_target": ("friction_1", 0), "told": ("statusword", 0),
        "position_actual": ("position_actual", 0), "nothing": ("max_speed", 0),
        "gain_a": ("mode_of_operation", 10), "gain_b": ("torque_target", 300),
        "gain_c": ("controlword", 15),
    }  # fmt: skip
    text = HOSTILE
    for name, (of, _) in renamed.items():
        address = parameters.get(of, parameters["coulomb_positive"])["address"]
        inline = ", ".join(
            f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in address.items()
        )
        protection = (
            'access = "ro"' if name in ("told", "position_actual") else 'protection = "experiment"'
        )
        text += f'[parameters.{name}]\naddress = {{ {inline} }}\ntitle = "x"\n{protection}\n'
    (folder / "profile.toml").write_text(text)

    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        journal["intents"] = [
            {"kind": "experiment", "parameter": name, "old": old, "new": 0, "state": "verified"}
            for name, old in (
                ("gain_c", 15),
                ("gain_c", 7),
                ("gain_c", 6),
                ("gain_b", 300),
                ("gain_a", 10),
            )
        ]
        result["compensation"] = []

    return changed(folder, change)


def test_a_hostile_run_energises_no_drive(
    serve: Serve, tworelay: Tworelay, exported: Path, state_folder: Path
) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    folder = hostile(exported)

    def aim(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["link"] = journal["run"]["link"] = link

    changed(exported, aim)
    assert tworelay("report", folder).returncode == 0, "to read it adopts nothing"
    assert tworelay("export", folder, f"{folder}-again").returncode == 0
    assert nothing_is_known()
    assert tworelay("restore", "--yes").stdout.strip() == "nothing to restore"
    assert tworelay("report", "last").returncode == 2
    done = tworelay("restore", folder, "--yes", "--link", link)
    assert done.returncode == 3
    assert "adopt it first" in done.stderr
    done = tworelay("adopt", folder, "--yes")
    assert done.returncode == 3
    for name in ("gain_a", "gain_b", "gain_c"):
        assert f"'{name}' is not in it" in done.stderr
    named = tworelay("adopt", folder, "--yes", "--profile", "virtual-modbus")
    assert named.returncode == 3
    assert nothing_is_known()
    drive = open_drive(axis_of(link))
    assert not drive.state().is_energised
    assert drive.read("torque_target").raw == 0
    drive.close()


def test_what_is_taken_in_is_shown_and_agreed_to(tworelay: Tworelay, exported: Path) -> None:
    refused = tworelay("adopt", str(exported))
    assert refused.returncode == 3
    assert "give --yes" in refused.stderr
    for word in (
        "virtual://bench",
        "virtual-modbus 1",
        "0xAD3B31AF",
        "coulomb_positive",
        "'bench'",
    ):
        assert word in refused.stdout
    assert nothing_is_known()
    taken = tworelay("adopt", str(exported), "--yes")
    assert taken.returncode == 0, taken.stderr
    run = taken.stdout.split()[-1]
    again = tworelay("adopt", str(exported))
    assert again.returncode == 0
    assert "is known here: nothing was taken in" in again.stdout
    assert tworelay("report", run).returncode == 0
    assert tworelay("report", "last").returncode == 2, "it was not measured here"
    bare = tworelay("restore", "--yes")
    assert bare.returncode == 3
    assert f"of runs that were taken in: {run}" in bare.stderr
    assert tworelay("restore", run, "--dry-run").returncode == 0
    assert (home() / "runs" / run / "profile.toml").read_text() == source_text("virtual-modbus")
    assert not (home() / "runs" / run / "report.html").is_symlink()


def test_what_is_written_beside_a_file_is_not_written_elsewhere(
    tworelay: Tworelay, exported: Path, tmp_path: Path
) -> None:
    """A name that can be foretold can be taken beforehand, by a link."""
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    for name in ("report.html", "run.json", "loci.svg"):
        for pid in (os.getpid(), *range(1, 300)):
            (exported / f"{name}.{pid}.new").symlink_to(mine)
    for words in (
        ["report", str(exported)],
        ["tune", str(exported)],
        ["plot", "loci", str(exported)],
    ):
        assert tworelay(*words).returncode == 0
    assert mine.read_text() == "mine"
    assert not (exported / "report.html").is_symlink()


@pytest.mark.parametrize(
    "run", ["last", "20261126-002213-x.toml", "20261126-002213-x.", "CON", "x", "..", "a" * 300]
)
def test_a_name_that_means_something_else_is_no_id(
    tworelay: Tworelay, exported: Path, run: str
) -> None:
    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["run"] = journal["run"]["id"] = run

    done = tworelay("adopt", changed(exported, change), "--yes")
    assert done.returncode == 2
    assert "is no id of a run" in done.stderr
    assert nothing_is_known()


def test_a_run_that_is_there_is_not_overwritten(tworelay: Tworelay, exported: Path) -> None:
    run = json.loads((exported / "run.json").read_text())["run"]
    (home() / "runs" / run).mkdir(parents=True)
    (home() / "runs" / run / "run.json").write_text("mine")
    done = tworelay("adopt", str(exported), "--yes")
    assert done.returncode == 3
    assert "of a run that the journal does not know" in done.stderr
    assert (home() / "runs" / run / "run.json").read_text() == "mine"
    shutil.rmtree(home() / "runs" / run)
    assert tworelay("adopt", str(exported), "--yes").returncode == 0

    def shout(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["run"] = journal["run"]["id"] = run.upper()

    done = tworelay("adopt", changed(exported, shout), "--yes")
    assert "is known here: nothing was taken in" in done.stdout


def test_a_profile_is_not_taken_from_where_the_run_says(
    tworelay: Tworelay, exported: Path, tmp_path: Path
) -> None:
    elsewhere = tmp_path / "elsewhere.toml"
    elsewhere.write_text(source_text("virtual-modbus"))
    (exported / "profile.toml").unlink()
    (exported / "profile.toml").symlink_to(elsewhere)
    for words in (
        ["tune", str(exported)],
        ["adopt", str(exported), "--yes"],
        ["report", str(exported)],
    ):
        done = tworelay(*words)
        assert done.returncode == (0 if words[0] == "report" else 2), done.stderr
    (exported / "profile.toml").unlink()

    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        journal["run"]["profile"] = str(elsewhere)

    done = tworelay("tune", changed(exported, change))
    assert done.returncode == 2
    assert "the profile of its drive is missing" in done.stderr


def test_a_link_of_others_presents_no_key_of_ours(
    tworelay: Tworelay, exported: Path, tmp_path: Path
) -> None:
    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["link"] = journal["run"]["link"] = (
            f"modbus-tls://127.0.0.1:1?ca={tmp_path}/a&cert={tmp_path}/b"
        )

    taken = tworelay("adopt", changed(exported, change), "--yes")
    assert taken.returncode == 0, taken.stderr
    for act in ("apply", "verify", "restore"):
        done = tworelay(act, taken.stdout.split()[-1], "--yes")
        assert done.returncode == 3
        assert "its ca is a file outside" in done.stderr


def test_an_adopted_run_says_nothing_about_how_far_the_axis_may_go(
    tworelay: Tworelay, exported: Path
) -> None:
    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["experiment"]["limits"] = {"travel": 1e6, "torque": 1e9, "speed": 1e9}
        result["experiment"]["cycle"] = 1e200
        journal["run"]["context"]["axis"]["travel"] = None

    taken = tworelay("adopt", changed(exported, change), "--yes")
    run = taken.stdout.split()[-1]
    done = tworelay("verify", run, "--yes")
    assert done.returncode in (2, 3)
    assert "travel" in done.stderr

    def none(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["experiment"] = None
        result["run"] = journal["run"]["id"] = run.replace("-bench", "-other")

    taken = tworelay("adopt", changed(exported, none), "--yes")
    done = tworelay("verify", taken.stdout.split()[-1], "--yes", "--travel", "3")
    assert "internal error" not in done.stderr


DIFFERENCES: dict[str, tuple[Change, str]] = {
    "another parameter": (
        lambda r, j: j["intents"].append(
            {"kind": "compensation", "parameter": "nosuch", "old": 0, "new": 1, "state": "verified"}
        ),
        "'nosuch' is not in it",
    ),
    "another kind": (
        lambda r, j: j["intents"].append(
            {
                "kind": "compensation",
                "parameter": "max_torque",
                "old": 9,
                "new": 1,
                "state": "verified",
            }
        ),
        "'max_torque' has protection 'experiment' and is written as compensation",
    ),
    "maintenance": (
        lambda r, j: j["intents"].append(
            {
                "kind": "experiment",
                "parameter": "store_command",
                "old": 1,
                "new": 0,
                "state": "verified",
            }
        ),
        "'store_command' has protection 'maintenance' and is written as experiment",
    ),
    "a command of the moment": (
        lambda r, j: j["intents"].append(
            {
                "kind": "experiment",
                "parameter": "controlword",
                "old": 31,
                "new": 0,
                "state": "verified",
            }
        ),
        "'controlword' has protection 'command' and is written as experiment",
    ),
    "a value out of range": (
        lambda r, j: j["intents"][-1].update(
            parameter="coulomb_positive", old=32000, state="verified"
        ),
        "'coulomb_positive' does not take 32000 (0…1000)",
    ),
    "a proposal out of range": (
        lambda r, j: next(
            c for c in r["compensation"] if c["parameter"] == "coulomb_positive"
        ).update(new_raw=-5),
        "'coulomb_positive' does not take -5 (0…1000)",
    ),
    "another proposal": (
        lambda r, j: r["compensation"].append({**r["compensation"][0], "parameter": "controlword"}),
        "'controlword' has protection 'command' and is written as compensation",
    ),
    "an object of a bus that it has not": (
        lambda r, j: j["intents"].append(
            {"kind": "experiment", "parameter": "1400h:01", "old": 1, "new": 0, "state": "verified"}
        ),
        "'1400h:01' is not in it",
    ),
}


@pytest.mark.parametrize("case", DIFFERENCES)
def test_what_differs_from_the_profile_known_here_is_refused_by_name(
    tworelay: Tworelay, exported: Path, case: str
) -> None:
    change, words = DIFFERENCES[case]
    done = tworelay("adopt", changed(exported, change), "--yes")
    assert done.returncode == 3
    assert words in done.stderr
    assert nothing_is_known()


def test_an_address_that_was_moved_is_refused_by_name(tworelay: Tworelay, exported: Path) -> None:
    path = exported / "profile.toml"
    text = path.read_text()
    moved = text.replace("register = 0x0402", "register = 0x0777").replace(
        "register = 1026", "register = 1911"
    )
    assert moved != text
    path.write_text(moved)
    done = tworelay("adopt", str(exported), "--yes")
    assert done.returncode == 3
    assert "is at register 0402h and not at register 0777h" in done.stderr


def test_a_profile_that_is_not_known_here_must_be_named(
    tworelay: Tworelay, exported: Path, tmp_path: Path
) -> None:
    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["profile"]["name"] = str(tmp_path / "evil.toml")

    (tmp_path / "evil.toml").write_text(source_text("virtual-modbus"))
    done = tworelay("adopt", changed(exported, change), "--yes")
    assert done.returncode == 3
    assert "name yours with --profile" in done.stderr
    assert tworelay("adopt", str(exported), "--yes", "--profile", "virtual-modbus").returncode == 0


@pytest.mark.parametrize(
    "link", ["virtual://bench?state={file}", "virtual://bench?state=../../x.json"]
)
def test_a_link_of_others_names_no_file_outside(
    tworelay: Tworelay, exported: Path, tmp_path: Path, link: str
) -> None:
    file = tmp_path / "mine.json"

    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["link"] = journal["run"]["link"] = link.format(file=file)

    done = tworelay("adopt", changed(exported, change), "--yes")
    assert done.returncode == 3
    assert "its state is a file outside" in done.stderr
    assert not file.exists()
    assert nothing_is_known()


@pytest.mark.parametrize(
    "link", ["modbus-rtu:///spy://x?file=y", "http://x", "canopen://slcan/a;b?node=5"]
)
def test_a_link_of_others_is_read_as_strictly(
    tworelay: Tworelay, exported: Path, link: str
) -> None:
    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["link"] = journal["run"]["link"] = link

    assert tworelay("adopt", changed(exported, change), "--yes").returncode == 2
    assert nothing_is_known()


def test_two_runs_in_one_folder_are_refused(tworelay: Tworelay, exported: Path) -> None:
    for key, value in (
        ("run", "20200101-000000-x"),
        ("axis", "y"),
        ("link", "virtual://bench?delay=0.003"),
    ):

        def change(
            result: dict[str, Any], journal: dict[str, Any], key: str = key, value: str = value
        ) -> None:
            result[key] = value

        folder = shutil.copytree(exported, exported.parent / key)
        assert tworelay("adopt", changed(folder, change), "--yes").returncode == 2
    assert nothing_is_known()


def test_a_name_that_leads_elsewhere_is_no_run(tworelay: Tworelay, exported: Path) -> None:
    def change(result: dict[str, Any], journal: dict[str, Any]) -> None:
        result["run"] = journal["run"]["id"] = "../../elsewhere"

    assert tworelay("adopt", changed(exported, change), "--yes").returncode == 2
    assert nothing_is_known()


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="this system has no links")
@pytest.mark.parametrize(
    "name", ["run.json", "journal.json", "profile.toml", "samples.npz", "report.html"]
)
def test_no_link_is_followed(tworelay: Tworelay, exported: Path, tmp_path: Path, name: str) -> None:
    """Neither one that lies in a run, nor one that waits where an export goes."""
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    target = tmp_path / "target"
    target.mkdir()
    (target / name).symlink_to(mine)
    assert tworelay("export", str(exported), str(target)).returncode == 0
    assert mine.read_text() == "mine"
    assert not (target / name).is_symlink() or name == "report.html", (
        "a page of others is not copied"
    )
    (exported / name).unlink()
    (exported / name).symlink_to(mine)
    sent = str(exported)
    for command in (["report", sent], ["plot", "loci", sent], ["adopt", sent, "--yes"], ["tune",
    sent],
                    ["export", sent, str(tmp_path / "out")]):  # fmt: skip
        done = tworelay(*command)
        assert done.returncode in (0, 2, 3), done.stderr
        assert len(done.stderr.splitlines()) <= 1
    assert mine.read_text() == "mine"
    copied = tmp_path / "out" / name
    assert not copied.exists() or copied.read_text("utf-8", "replace") != "mine"


def test_restore_names_axis_and_values_and_asks(tworelay: Tworelay, after: Tworelay) -> None:
    after("commission", "virtual://bench", "--yes")
    asked = tworelay("restore")
    assert asked.returncode == 3
    assert "give --yes" in asked.stderr
    for word in ("'bench'", "coulomb_positive", "will be written", "and stored"):
        assert word in asked.stdout
    shown = tworelay("restore", "--dry-run")
    assert shown.returncode == 0
    assert shown.stdout.splitlines()[-1] == "dry run: nothing was written"
    with Journal(home()) as journal:
        assert journal.open_runs()
    assert tworelay("restore", "--yes").returncode == 0


def test_a_drive_without_a_serial_is_not_restored_unasked(
    serve: Serve, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    from drivers.profiled import ProfiledDrive

    identity = ProfiledDrive.identity
    monkeypatch.setattr(
        ProfiledDrive, "identity", lambda drive: identity(drive).model_copy(update={"serial": ""})
    )
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    other = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    assert tworelay("commission", link, *QUICK).returncode == 0
    done = tworelay("restore", "--link", other)
    assert done.returncode == 3
    assert "tells no serial number" in done.stdout


def test_what_profile_check_calls_an_error_is_one_when_it_is_loaded(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(source_text("virtual-modbus").replace("register = 0x0402", "register = 0x0401"))
    done = tworelay("identify", "virtual://bench", "--profile", str(path), "--yes")
    assert done.returncode == 2
    assert "overlaps 'coulomb_positive' at register 0401h" in done.stderr


def test_a_run_of_ours_is_stopped_and_restored_by_a_profile_that_is_refused_today(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    """It overlaps, and has a key that nobody knows any more."""
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    assert tworelay("identify", link, *QUICK).returncode == 0
    assert tworelay("apply", "last", "--yes").returncode == 0
    with Journal(home()) as journal:
        run = journal.run("last").id
    path = home() / "runs" / run / "profile.toml"
    text = path.read_text().replace('bus = "modbus"', 'bus = "modbus"\nobsolete = 3', 1)
    at = text[text.index("[parameters.coulomb_positive]") :].split("\n")[1]
    text = f'{text}\n[parameters.twice]\n{at}\ntitle = "the same again"\nlost = 1\n'
    path.write_text(text)
    assert "unknown key" in tworelay("profile", "check", str(path)).stderr
    path.write_text(text.replace("lost = 1\n", "").replace("obsolete = 3\n", ""))
    refused = tworelay("profile", "check", str(path))
    path.write_text(text)
    assert refused.returncode == 2
    assert "overlaps 'coulomb_positive'" in refused.stdout
    assert tworelay("identify", link, *QUICK, "--profile", str(path)).returncode == 2
    assert tworelay("report", run).returncode == 0
    assert tworelay("stop", link, "--profile", str(path)).returncode == 0
    assert tworelay("restore", run, "--yes").returncode == 0
    drive = open_drive(Axis(link=link, profile="virtual-modbus"))
    assert drive.read("coulomb_positive").raw == 0
    drive.close()
