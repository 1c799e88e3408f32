"""Drives that no built-in profile fits, from their manual to a proved compensation.

The twins are made from profiles of their own (`foreign/`), which what is drafted here never sees.
"""

from __future__ import annotations

from pathlib import Path

from profiles.library import load_profile
from tests.command import ROOT
from tests.conftest import Serve, Tworelay

FOREIGN = Path(__file__).with_name("foreign")
# as a technician writes down the manual of the drive behind foreign/norvik.toml
TABLE = """name;register;type;unit;scale;minimum;maximum;word_order;mask;on;off;stop;reset;stopping;fault_value;torque;position;before;trust
torque_target;0B10h;i16;rated;0.001
position_target;0B11h;i32;;;;;low-first
position_actual;0B24h;i32;;;;;low-first
torque_actual;0B21h;i16;rated;0.001
drive_status;0B20h;u16;;;;;;0x0F;3 4;;;;5;8 9
servo_on;0B30h;u16;;;;;;;0x5A5A 0xA5A5;0;0x0B0B;0xF0
mode_of_operation;0A00h;u16;;;;;;;;;;;;;2;6
command_source;0A01h;u16;;;;;;;;;;;;;;;1
max_torque;0C00h;u16;rated;0.001
max_torque_negative;0C01h;u16;rated;0.001
max_speed;0C02h;u16;rpm
watchdog_time;0C10h;u16;s;0.001
store_command;0C20h;u16;;;;;;;0x7357
store_status;0C21h;u16;;;;;;;2
torque_offset;0D00h;i16;rated;0.001;;;;;;;;;;;;;;derived
coulomb_positive;0D01h;i16;rated;0.001;;;;;;;;;;;;;;derived
coulomb_negative;0D02h;i16;rated;0.001;-300;300;;;;;;;;;;;;derived
friction_speed;0D03h;u16;rpm;0.1;;;;;;;;;;;;;;derived
serial_number;0E00h;u32;;;;;low-first
rated_torque;0E02h;u16;N.m;0.01
encoder_increments;0E04h;u32;;;;;low-first
"""  # noqa: E501
COMPENSATION = """
[compensation]
law = "offset+asymmetric"
offset = "constant_torque"
positive = "friction_positive"
negative = "friction_negative"
"""
PARAMETER = """
[parameters.{name}]
address = {{ index = 0x2F10, sub = {sub}, type = "{kind}" }}
title = "{name}"
unit = "rated"
scale = 0.001
protection = "compensation"
trust = "derived"
"""


def served(serve: Serve, name: str, *wire: str) -> str:
    return serve("bench", "--profile", str(FOREIGN / f"{name}.toml"), *wire, "--clock", "step")[0]


def test_a_modbus_drive_with_two_keys_and_a_linear_zone(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    table, profile = tmp_path / "nx.csv", str(tmp_path / "nx.toml")
    table.write_text(TABLE, "utf-8")
    done = tworelay("profile", "new", "--csv", str(table), "--output", profile)
    assert done.returncode == 0, done.stderr
    assert tworelay("profile", "check", profile).returncode == 0
    link = served(serve, "norvik", "--modbus-tcp", "127.0.0.1:0")
    options = ("--profile", profile, "--travel", "3", "--yes")
    done = tworelay("commission", link, *options, "--dry-run")
    assert "would enable: 5A5Ah to servo_on (register 0B30h), A5A5h to servo_on" in done.stdout
    done = tworelay("commission", link, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "less error after reversals with 85 % of the friction compensated" in done.stdout
    assert "coulomb_negative -0.085 N·m" in done.stdout
    assert tworelay("restore", "last", "--yes").returncode == 0


def test_keys_in_the_wrong_order_are_told_with_what_the_drive_says(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    table, profile = tmp_path / "nx.csv", str(tmp_path / "nx.toml")
    table.write_text(TABLE.replace("0x5A5A 0xA5A5", "0xA5A5 0x5A5A"), "utf-8")
    assert tworelay("profile", "new", "--csv", str(table), "--output", profile).returncode == 0
    link = served(serve, "norvik", "--modbus-tcp", "127.0.0.1:0")
    done = tworelay("identify", link, "--profile", profile, "--travel", "3", "--yes")
    assert done.returncode == 3
    assert "written were A5A5h to 'servo_on' (register 0B30h), 5A5Ah to 'servo_on'" in done.stderr
    assert "'drive_status' reads 0h, of which the bits Fh must be 3 or 4" in done.stderr
    assert "axis at rest and off; settings put back" in done.stdout


def test_what_nobody_has_verified_is_refused_before_anything_moves(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    table, profile = tmp_path / "nx.csv", str(tmp_path / "nx.toml")
    table.write_text(TABLE.replace("derived", "unverified"), "utf-8")
    done = tworelay("profile", "new", "--csv", str(table), "--output", profile)
    assert done.returncode == 0, done.stderr
    link = served(serve, "norvik", "--modbus-tcp", "127.0.0.1:0")
    done = tworelay("commission", link, "--profile", profile, "--travel", "3", "--yes")
    assert done.returncode == 3
    assert "could not be written: nothing was moved" in done.stderr
    assert "'tworelay identify' only measures" in done.stderr
    assert "torque ramp" not in done.stdout


def test_a_canopen_drive_with_friction_objects_of_its_own(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    profile = tmp_path / "p7.toml"
    done = tworelay("profile", "new", "--eds", str(FOREIGN / "p7.eds"), "--output", str(profile))
    assert done.returncode == 0, done.stderr
    assert "2F10h:02 'Friction compensation: Positive direction' (u16)" in done.stdout
    assert '# address = { index = 0x2F10, sub = 3, type = "u16" }' in profile.read_text("utf-8")
    rest, law, _ = profile.read_text("utf-8").partition("[compensation]")
    assert law, "a drive without 60B2h has no host law, and says so"
    _, _, after = profile.read_text("utf-8").partition('law = "none"')
    described = COMPENSATION + after + "".join(
        PARAMETER.format(name=name, sub=sub, kind=kind)
        for name, sub, kind in (
            ("constant_torque", 1, "i16"), ("friction_positive", 2, "u16"),
            ("friction_negative", 3, "u16"),
        )
    )  # fmt: skip
    profile.write_text(rest + described, "utf-8")
    assert load_profile(str(profile)).compensation.law == "offset+asymmetric"
    assert tworelay("profile", "check", str(profile)).returncode == 0
    # position units by 6092h, and 1029h as CiA 301 has it
    wire = "--socketcand", "127.0.0.1:0", "--habit", "feed=65536"
    link = served(serve, "pellworth", *wire)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(profile.read_text("utf-8").replace("sub = 3, type", "sub = 4, type"), "utf-8")
    done = tworelay("identify", link, "--profile", str(wrong), "--travel", "3", "--yes")
    assert done.returncode == 3
    assert "the drive does not have its compensation where its profile says" in done.stderr
    assert "2F10h:04" in done.stderr
    assert "torque ramp" not in done.stdout
    done = tworelay("identify", link, "--profile", str(profile), "--travel", "3", "--dry-run")
    assert "positive of the compensation, friction_positive (2F10h:02, " in done.stdout
    assert "that is node 127, 50 ms" in done.stdout
    done = tworelay("commission", link, "--profile", str(profile), "--travel", "3", "--yes")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "less error after reversals with 85 % of the friction compensated" in done.stdout


def test_the_table_of_the_guide_is_a_profile(tworelay: Tworelay, tmp_path: Path) -> None:
    guide = (ROOT / "docs" / "bring-your-own-drive.md").read_text("utf-8")
    table = next(part for part in guide.split("```text\n") if part.startswith("name"))
    path, profile = tmp_path / "my-drive.csv", str(tmp_path / "my-drive.toml")
    path.write_text(table.split("```")[0], "utf-8")
    done = tworelay("profile", "new", "--csv", str(path), "--output", profile)
    assert done.returncode == 0, done.stderr
    done = tworelay("profile", "check", profile)
    assert done.returncode == 0, done.stdout + done.stderr
