"""What a technician calls things, and what he is told."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import click
import pytest

from commissioning.cli import cli
from commissioning.cli.helping import EXAMPLES
from profiles.library import load_profile
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES

QUICK = ("--travel", "3", "--yes")


def commands(group: click.Group, path: str = "") -> dict[str, click.Command]:
    found: dict[str, click.Command] = {path: group}
    with click.Context(group, help_option_names=["-h", "--help"]) as context:
        for name in group.list_commands(context):
            command = group.get_command(context, name)
            assert command is not None
            way = f"{path} {name}".strip()
            found |= commands(command, way) if isinstance(command, click.Group) else {way: command}
    return found


def test_every_command_has_examples_that_it_takes() -> None:
    every = commands(cli)
    assert EXAMPLES.keys() == every.keys()
    for path, lines in EXAMPLES.items():
        for line in lines:
            words = shlex.split(line)
            assert words[0] == "tworelay"
            way, rest = "", words[1:]
            while rest and f"{way} {rest[0]}".strip() in every:
                way, rest = f"{way} {rest[0]}".strip(), rest[1:]
            command = every[way]
            if "--help" not in rest:
                command.make_context(way, rest, help_option_names=["-h", "--help"])
            assert way.startswith(path), (path, line)


@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help_shows_groups_and_examples(tworelay: Tworelay, option: str) -> None:
    text = tworelay("commission", option).stdout
    for words in ("What it may do:", "What is measured:", "Examples:", "tworelay commission press"):
        assert words in text


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("COM5", "modbus-rtu:COM5?unit=1"), ("/dev/ttyUSB0", "modbus-rtu:/dev/ttyUSB0?unit=1"),
        ("192.168.1.10", "modbus-tcp://192.168.1.10?unit=1"),
        ("192.168.1.10:1502", "modbus-tcp://192.168.1.10:1502?unit=1"),
        ("drive-7.plant.local", "modbus-tcp://drive-7.plant.local?unit=1"),
        ("can0", "canopen://socketcan/can0?node=1"), ("bensh", "virtual://bench"),
    ],
)  # fmt: skip
def test_targets_as_people_call_them_are_told_how_to_write(
    tworelay: Tworelay, target: str, words: str
) -> None:
    done = tworelay("identify", target)
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_unit_of_the_other_kind_moves_nothing(tworelay: Tworelay) -> None:
    done = tworelay("identify", "virtual://bench", "--travel", "20 mm", "--yes")
    assert done.returncode == 2
    assert "the axis is rotary" in done.stderr
    done = tworelay("identify", "virtual://bench", "--travel", "±90 deg", "--dry-run")
    assert "±1.571 rad" in done.stdout


def test_a_restore_respects_a_later_run_of_the_same_drive(serve: Serve, tworelay: Tworelay) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    runs = []
    for fraction in ("60 %", "85 %"):
        done = tworelay("commission", link, *QUICK, "--fraction", fraction, "--json", "-")
        runs.append(json.loads(done.stdout)["run"])
    done = tworelay("restore", runs[0], "--yes")
    assert done.returncode == 3
    assert f"run {runs[1]} wrote" in done.stderr
    assert f"'tworelay restore {runs[1]}' first" in done.stderr
    assert tworelay("restore", runs[1], "--yes").returncode == 0
    assert tworelay("restore", runs[0], "--yes").returncode == 0


def test_a_look_at_a_proof_writes_nothing_for_good(serve: Serve, tworelay: Tworelay) -> None:
    link = serve("bench", *WIRES["modbus-tcp"], "--clock", "step")[0]
    run = json.loads(tworelay("commission", link, *QUICK, "--json", "-").stdout)
    kept = next(step for step in run["verification"]["steps"] if step["kept"])
    done = tworelay("verify", "last", "--check-only", "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["reversal_error"] == pytest.approx(kept["reversal_error"], rel=0.2)
    assert "at the proof of run" in done.stderr
    assert "its compensation" not in done.stderr
    assert tworelay("restore", "last", "--yes").returncode == 0


def test_a_profile_says_what_its_drive_s_faults_mean(tmp_path: Path) -> None:
    text = (Path("profiles/builtin/cia402.toml")).read_text("utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text + '\n[faults]\n7380h = "resolver: look at plug X7"\n"0xFF08" = "fan"\n')
    profile = load_profile(str(path))
    assert profile.fault(0x7380) == "resolver: look at plug X7"
    assert profile.fault(0xFF08) == "fan"
    assert profile.fault(0x1234) == ""


def test_a_confirmation_covers_the_whole_job_and_names_each_act(tworelay: Tworelay) -> None:
    done = tworelay("commission", "virtual://bench", "--yes")
    question = next(line for line in done.stdout.splitlines() if line.startswith("This will"))
    for words in ("1. MOVE", "2. WRITE", "coulomb_positive", "3. MOVE", "4. STORE", "for about"):
        assert words in question
    assert len(done.stdout.splitlines()) <= 24
    assert "about a minute" not in done.stdout


def test_the_result_alone(tworelay: Tworelay) -> None:
    done = tworelay("identify", "virtual://bench", "--yes", "-q")
    assert "step " not in done.stdout
    assert done.stdout.splitlines()[-1].startswith("run ")


def test_theory_is_said_where_it_is_asked_for(tworelay: Tworelay) -> None:
    done = tworelay("identify", "virtual://bench", "--yes", "-v")
    assert "naive: a relay autotuner" in done.stdout
    assert "stop path proved" in done.stdout
