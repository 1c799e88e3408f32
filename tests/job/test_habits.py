"""Habits of real drives.

The job is done with the numbers of one without, or the way out is named.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivers.link import open_drive
from profiles.axis import Axis
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES

QUICK = ("--travel", "20", "--cycle", "0.008", "--yes")


def served(serve: Serve, *habits: str) -> str:
    words = [word for habit in habits if habit for word in ("--habit", habit)]
    return serve("bench", *WIRES["socketcand"], "--profile", "cia402", "--clock", "step", *words)[0]


@pytest.mark.parametrize(
    "habit",
    ["feed", "feed=10000", "feed=1000000", "gear", "old-factor", "polarity", "polarity gear=20000",
     "feed slow-reset short-sdo"],
)  # fmt: skip
def test_in_whatever_a_drive_counts_the_axis_is_the_same(
    serve: Serve, tworelay: Tworelay, habit: str
) -> None:
    """608Fh is the encoder.

    What a position unit is, 6091h, 6092h and 6093h say, and 607Eh which way.
    """
    link = served(serve, *habit.split(" "))
    done = tworelay("identify", link, "--profile", "cia402", *QUICK, "--points", "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    friction, coarse = result["friction"], "10000" in habit.split("=")
    assert friction["coulomb"]["value"] == pytest.approx(0.1, rel=0.05 if coarse else 0.02)
    assert friction["inertia"]["value"] == pytest.approx(1e-3, rel=0.05 if coarse else 0.02)
    assert friction["viscous"]["value"] == pytest.approx(2e-3, rel=0.1)
    assert result["experiment"]["limits"]["travel"] == 20.0
    assert result["experiment"]["setup"]["first_look"]["inertia"] == pytest.approx(1e-3, rel=0.2)


@pytest.mark.parametrize(
    ("habit", "words"),
    [
        (
            "delivered",
            "by 6092h and 6091h a motor revolution has 1 position units, by 608Fh 131072",
        ),
        (
            "old-factor delivered",
            "608Fh and 6093h make 65536 position units a motor revolution, 6092h",
        ),
    ],
)
def test_a_position_scale_that_nobody_can_know_is_refused_and_the_axis_file_outranks_it(
    serve: Serve, tworelay: Tworelay, tmp_path: Path, habit: str, words: str
) -> None:
    link = served(serve, *habit.split(" "))
    path = tmp_path / "press.toml"
    path.write_text(f'link = "{link}"\nprofile = "cia402"\ntravel = 20.0\n')
    refused = tworelay("identify", str(path), "--yes")
    assert refused.returncode == 3
    assert words in refused.stderr
    assert "encoder" in refused.stderr
    units = 65536.0 if "old" in habit else 131072.0
    path.write_text(f"{path.read_text()}encoder = {units}\n")
    done = tworelay("identify", str(path), "--cycle", "0.008", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["friction"]["inertia"]["value"] == pytest.approx(1e-3, rel=0.02)


@pytest.mark.parametrize(
    "habit", ["wrap", "wrap=10", "modulo", "modulo=1000000", "polarity wrap", "feed wrap"]
)
def test_a_counter_that_wraps_is_followed(serve: Serve, tworelay: Tworelay, habit: str) -> None:
    link = served(serve, *habit.split(" "))
    done = tworelay("identify", link, "--profile", "cia402", *QUICK, "--json", "-")
    assert done.returncode == 0, done.stderr
    friction = json.loads(done.stdout)["friction"]
    assert friction["coulomb"]["value"] == pytest.approx(0.1, rel=0.02)
    assert friction["inertia"]["value"] == pytest.approx(1e-3, rel=0.02)


@pytest.mark.parametrize(
    "habit", ["wrap", "modulo=1000000", "polarity", "feed", "gear=20000 polarity"]
)
def test_the_proof_goes_where_it_is_told_in_whatever_the_drive_counts(
    serve: Serve, tworelay: Tworelay, habit: str
) -> None:
    """In position mode.

    Done, or a target beyond the counter's end is refused by name, and all put back.
    """
    words = [word for one in habit.split(" ") for word in ("--habit", one)]
    link = serve("bench", *WIRES["socketcand"], "--clock", "step", *words)[0]
    done = tworelay("commission", link, *QUICK)
    if habit in ("wrap", "modulo=1000000"):
        assert done.returncode in (0, 3), done.stderr
        assert done.returncode == 0 or "'position_target' (607Ah:00)" in done.stderr
    else:
        assert done.returncode == 0, done.stderr
        assert "less error after reversals" in done.stdout


def test_a_node_that_goes_pre_operational_is_started_again_and_left_as_it_was(
    serve: Serve, tworelay: Tworelay
) -> None:
    """1029h:01 = 0 is the default of CiA 301: the proof of the watchdog ends in pre-operational."""
    link = serve("bench", *WIRES["socketcand"], "--clock", "step")[0]
    drive = open_drive(Axis(link=link, profile="virtual-canopen"))
    wire = drive._bus._wire  # type: ignore[attr-defined]
    assert wire.upload(0x1029, 1) == b"\0"
    drive.close()
    assert tworelay("commission", link, *QUICK).returncode == 0


def test_a_mode_that_never_comes_names_the_key(serve: Serve, tworelay: Tworelay) -> None:
    link = served(serve, "slow-mode=30")
    done = tworelay("identify", link, "--profile", "cia402", *QUICK)
    assert done.returncode == 3
    assert "[patience] mode" in done.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--habit", "polite"), "no habit of a virtual drive named 'polite'"),
        (("--habit", "short-sdo=3"), "takes no value"), (("--habit", "lacks=x"), "must be objects"),
        (("--habit", "slow-mode=x"), "must be a time from 0 to 60 s"),
        (("--habit", "lacks=6502h", "--habit", "lacks"), "twice"),
    ],
)  # fmt: skip
def test_a_habit_that_is_none(tworelay: Tworelay, words: tuple[str, ...], text: str) -> None:
    done = tworelay("virtual", "serve", "bench", "--socketcand", "127.0.0.1:0", *words)
    assert done.returncode == 2
    assert text in done.stderr


def test_habits_are_listed(tworelay: Tworelay) -> None:
    listed = tworelay("virtual", "list", "--habits")
    assert "slow-reset=0.05" in listed.stdout
    assert "lacks" in json.loads(tworelay("virtual", "list", "--habits", "--json").stdout)


@pytest.mark.parametrize(
    "habit", ["short-sdo", "unsized", "segmented", "slow-answer=0.3", "slow-boot"]
)
def test_doctor_finds_a_node_where_identify_does(
    serve: Serve, tworelay: Tworelay, habit: str
) -> None:
    link = served(serve, habit)
    found = json.loads(tworelay("doctor", link, "--json").stdout)
    assert [line["text"] for line in found if line["text"].startswith("node:")] == [
        "node: 5 answers"
    ]


def test_the_proof_of_the_watchdog_is_told_with_what_the_drive_said(
    serve: Serve, tworelay: Tworelay
) -> None:
    """Its entry in the drive's error history is ours.

    The technician reads it before a reset erases it.
    """
    link = served(serve, "slow-reset")
    done = tworelay("identify", link, "--profile", "cia402", *QUICK)
    assert "the drive noticed it, by itself:" in done.stdout
    assert "8130h (heartbeat of the master lost, or guarding)" in done.stdout


def test_a_node_that_was_operational_is_left_so(serve: Serve, tworelay: Tworelay) -> None:
    words = ("--habit", "operational", "--clock", "wall")
    link = serve("bench", *WIRES["socketcand"], "--profile", "cia402", *words)[0]
    drive = open_drive(Axis(link=link, profile="cia402"))
    try:
        list(drive.rehearsal.cycles(3))
    finally:
        drive.close()
    again = open_drive(Axis(link=link, profile="cia402"))
    try:
        wire = again._bus._wire  # type: ignore[attr-defined]
        wire.download(0x1017, 0, (20).to_bytes(2, "little"))
        wire.pump_until(lambda: wire.heartbeat_state is not None, 2.0)
        assert wire.heartbeat_state == 0x05
        wire.download(0x1017, 0, bytes(2))
    finally:
        again.close()
