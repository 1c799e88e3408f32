"""Every built-in profile against its twin, as a technician would rehearse it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import canopen
import jsonschema
import pytest

from commissioning.journal import Intent, Journal
from drivers.home import home
from drivers.link import axis_of, modbus_wire, open_drive, parse
from drivers.modbus.client import Client
from profiles.axis import Axis, load_axis
from profiles.library import builtin_names, load_profile
from tests.command import ROOT
from tests.conftest import Serve, Tworelay

REAL = [name for name in builtin_names() if load_profile(name).status != "virtual"]
PROFILES = [name for name in REAL if load_profile(name).moves]
RUN_SCHEMA = json.loads((ROOT / "docs/run.schema.json").read_text())
GEAR = 4.0
SLOW = 0.02  # kg.m2: an axis that cycles of 10 to 50 ms can follow


def served(serve: Serve, profile: str, *options: str) -> str:
    loaded = load_profile(profile)
    wire = ["--socketcand" if loaded.bus == "canopen" else "--modbus-rtu-tcp", "127.0.0.1:0"]
    if loaded.watchdog.kind == "guarding":  # of whose remote frames socketcand has none
        wire = ["--slcan", "pty"]
    twin = ("--profile", profile, *wire, "--clock", "step")
    return serve("bench", *twin, *options)[0]


def axis_file(tmp_path: Path, link: str, profile: str) -> str:
    """What the drive does not tell is said here; what it does tell is then not read."""
    path = tmp_path / f"{profile}.toml"
    known = load_profile(profile).parameters
    text = f'link = "{link}"\nprofile = "{profile}"\ntravel = 30.0\n'
    text += "" if "rated_torque" in known else "rated_torque = 1.0\n"
    text += "" if "encoder_increments" in known else "encoder = 131072\n"
    text += "torque_constant = 0.5\n" if profile == "kollmorgen-s300" else ""
    path.write_text(f"{text}[limits]\nspeed = 200.0\n")
    return str(path)


@pytest.mark.parametrize("profile", PROFILES)
def test_a_profile_identifies_its_twin(
    serve: Serve, tworelay: Tworelay, tmp_path: Path, profile: str
) -> None:
    loaded = load_profile(profile)
    is_slow = loaded.link.cycle > 0.005
    link = served(serve, profile, *(("--set", f"inertia={SLOW}") if is_slow else ()))
    found = not loaded.identity.empty  # by itself
    target = link if found else axis_file(tmp_path, link, profile)
    options = ["--travel", "30"]
    options += ["--without-watchdog"] if loaded.watchdog.kind == "none" else []
    done = tworelay("identify", target, "--yes", "--json", "-", *options)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["profile"]["name"] == profile
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    inertia = SLOW if is_slow else 1e-3
    assert result["friction"]["inertia"]["value"] == pytest.approx(inertia, rel=0.01)
    if loaded.compensation.law == "none":
        assert result["compensation"] == []


def test_a_drive_without_a_torque_command_gets_what_a_recording_shows(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    assert [name for name in REAL if name not in PROFILES] == ["festo-cmmt"]
    (link,) = serve("bench", "--profile", "festo-cmmt", "--modbus-tcp", "127.0.0.1:0")
    asked = ("--profile", "festo-cmmt")
    done = tworelay("identify", link, *asked, "--travel", "1", "--yes")
    assert done.returncode == 3
    assert "no torque command, so no relay experiment can be run" in done.stderr
    done = tworelay("stop", link, *asked)
    assert done.returncode == 3
    assert "no way to stop the drive, which says: disabled" in done.stderr

    recording = tmp_path / "recorded.csv"
    rows = recorded_oscillation()
    recording.write_text("\n".join(["time_s,position_rad,torque_Nm", *rows]))
    done = tworelay("analyze", str(recording), "--for", link, *asked, "--json", str(tmp_path / "j"))
    assert done.returncode == 0, done.stderr
    assert "own estimate of the Coulomb friction (kinetic_friction) is 0.1 N.m" in done.stdout
    jsonschema.validate(json.loads((tmp_path / "j").read_text()), RUN_SCHEMA)
    done = tworelay("apply", "last", "--yes")  # the table counts at the output of the gear
    assert done.returncode == 3
    assert "its ratio is not said" in done.stderr
    assert "give gear (motor revolutions per revolution of its output" in done.stderr
    axis = tmp_path / "axis.toml"
    axis.write_text(f'link = "{link}"\nprofile = "festo-cmmt"\n[mechanics]\ngear = {GEAR}\n')
    done = tworelay("analyze", str(recording), "--for", str(axis))
    assert done.returncode == 0, done.stderr
    done = tworelay("apply", "last", "--yes")
    assert done.returncode == 0, done.stderr
    assert "N.m and rad/s at the output of the gear" in done.stdout
    drive = open_drive(load_axis(axis))
    raw = {name: drive.parameters[name].parameter.number(drive.read(name).raw)
           for name in drive.profile.compensation.terms.values()}  # fmt: skip
    # the recording is of the axis, behind the gear: 85 % of 0.1 N.m and of 0.002 N.m.s/rad at the
    # output's 0.5/4 and 300/4 rad/s
    for name, value in (
        ("friction_velocity_1", 0.5 / GEAR), ("friction_velocity_2", 300 / GEAR),
        ("friction_torque_1", 0.085 + 0.0017 * 0.5 / GEAR),
        ("friction_torque_2", 0.085 + 0.0017 * 300 / GEAR), ("friction_points", 2),
    ):  # fmt: skip
        assert raw[name] == pytest.approx(value, rel=0.03, abs=2e-3)
    drive.close()
    assert tworelay("restore", "--yes").returncode == 0
    drive = open_drive(Axis(link=link, profile="festo-cmmt"))
    assert drive.read("friction_torque_1").si == drive.read("friction_points").si == 0
    drive.close()


def recorded_oscillation() -> list[str]:
    """A virtual bench under a square torque of two amplitudes, by small steps.

    J a = u - f sign(v) - B v.
    """
    rows, y, v, step = [], 0.0, 0.0, 1e-5
    for n in range(200_000):
        t = n * step
        u = (0.25 if t < 1.0 else 0.4) * (1 if int(t / 0.05) % 2 == 0 else -1)
        if n % 100 == 0:
            rows.append(f"{t:.5f},{y:.8f},{u:.4f}")
        drive = u - 0.002 * v
        stuck = v == 0 and abs(drive) <= 0.1
        a = 0.0 if stuck else (drive - math.copysign(0.1, v or drive)) / 1e-3
        after = v + a * step
        v = 0.0 if v * after < 0 else after
        y += v * step
    return rows


def test_leadshine_gets_per_cents_with_the_sign_of_the_direction_and_stores_them(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    profile = "leadshine-el7"
    link = served(serve, profile, "--set", f"inertia={SLOW}")
    axis = axis_file(tmp_path, link, profile)
    assert tworelay("identify", axis, "--yes", "--without-watchdog").returncode == 0
    done = tworelay("apply", "last", "--yes")
    assert done.returncode == 0, done.stderr
    assert "auto tuning (Pr0.02 other than 0) overwrites" in done.stdout
    drive = open_drive(load_axis(Path(axis)))
    # 85 % of 0.1 N.m is 8.5 % of the rated 1 N.m, and the drive counts whole per cents
    assert drive.read("coulomb_positive").raw in (8, 9)
    assert drive.read("coulomb_negative").raw == -drive.read("coulomb_positive").raw
    # the experiment left nothing behind
    assert drive.read("control_mode").raw == drive.read("torque_source").raw == 0
    assert not drive.state().is_energised
    drive.close()
    stored = json.loads((tmp_path / "drive-0.json").read_text())
    assert stored["coulomb_positive"] in (80, 90)  # of the virtual drive, per mille
    assert tworelay("restore", "--yes").returncode == 0
    drive = open_drive(load_axis(Path(axis)))
    assert drive.read("coulomb_positive").raw == 0
    drive.close()


def test_the_ax2000_gets_a_current_and_is_told_what_else_it_needs(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    link = served(serve, "beckhoff-ax2000")
    options = (
        "--profile", "beckhoff-ax2000", "--travel", "3", "--yes", "--without-watchdog",
        "--max-speed", "100",
    )  # fmt: skip
    assert tworelay("identify", link, *options).returncode == 0
    done = tworelay("apply", "last", "--yes")  # its rated current is from memory
    assert done.returncode == 3
    assert "give torque_constant (N.m/A of the motor) in the axis file" in done.stderr
    path = tmp_path / "axis.toml"
    path.write_text(
        f'link = "{link}"\nprofile = "beckhoff-ax2000"\ntravel = 3.0\ntorque_constant = 0.5\n'
    )
    assert tworelay("identify", str(path), *options[4:]).returncode == 0
    done = tworelay("apply", "last", "--yes")
    assert done.returncode == 0, done.stderr
    assert "takes effect after a save and a reset" in done.stdout
    drive = open_drive(load_axis(path))
    # 85 % of 0.1 N.m, at the twin's 1 N.m for 2 A: 0.17 A, weighted by 1000
    assert drive.read("friction_current").raw == 170
    assert drive.read("friction_current").si == pytest.approx(0.085)
    drive.close()
    exported = tmp_path / "exported"
    assert tworelay("export", "last", str(exported)).returncode == 0
    changes = canopen.import_od(str(exported / "changes.dcf"))  # by another reader than ours
    assert changes[0x36A4][1].value == 170  # behind sub-index 0 is the number of entries
    assert tworelay("restore", "--yes").returncode == 0
    again = tmp_path / "again"
    assert tworelay("export", "last", str(again)).returncode == 0
    assert not (again / "changes.dcf").exists()  # nothing is changed any more


def test_a_drive_without_a_compensation_says_what_its_master_adds(
    serve: Serve, tworelay: Tworelay
) -> None:
    link = served(serve, "elmo-gold")
    before = open_drive(axis_of(link).model_copy(update={"profile": "elmo-gold"}))
    before.write("torque_offset", 40)  # a master that is off has left it there
    before.close()
    done = tworelay("identify", link, "--travel", "30", "--yes")
    assert done.returncode == 0, done.stderr
    # 85 % of 0.1 N.m, at 1 N.m rated, in per mille
    assert "torque_offset (60B2h:00) in every cycle +0 +85 * sign(velocity command)" in done.stdout
    after = open_drive(axis_of(link).model_copy(update={"profile": "elmo-gold"}))
    assert after.read("torque_offset").raw == 40
    after.close()
    done = tworelay("apply", "last", "--yes")
    assert done.returncode == 3
    assert "no friction compensation to write to" in done.stderr
    (intent,) = [i for i in intents_of_last_run() if i.parameter == "torque_offset"]
    assert (intent.old, intent.new, intent.state) == (40, 0, "restored")


def intents_of_last_run() -> list[Intent]:
    with Journal(home()) as journal:
        return journal.intents(journal.run("last").id)


def test_other_masters_are_locked_out_of_a_lexium_while_it_is_written(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    link = served(serve, "lexium-32-modbus", "--set", f"inertia={SLOW}")
    axis = axis_file(tmp_path, link, "lexium-32-modbus")
    assert tworelay("identify", axis, "--yes", "--without-watchdog").returncode == 0
    intents = intents_of_last_run()
    assert intents[0].parameter == "access_lock"  # first, and put back last
    assert {i.state for i in intents} == {"restored"}
    drive = open_drive(load_axis(Path(axis)))
    assert drive.read("access_lock").raw == 0
    drive.close()


def test_an_unverified_address_is_not_written(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    link = served(serve, "delta-asda", "--set", f"inertia={SLOW}")
    axis = axis_file(tmp_path, link, "delta-asda")
    assert tworelay("identify", axis, "--yes", "--without-watchdog").returncode == 0
    done = tworelay("apply", "last", "--yes")
    assert done.returncode == 3
    assert "'friction' (register 017Ch) is unverified" in done.stderr
    assert "nothing was written" in done.stderr
    assert tworelay("restore", "--yes").stdout.strip() == "nothing to restore"


def test_a_drive_whose_motor_is_not_set_up_has_no_torque_scale(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    """EPOS4 and Elmo are delivered with 6076h = 0; the twin of a profile without it likewise."""
    profile = tmp_path / "mine.toml"
    profile.write_text('extends = "elmo-gold"\nname = "mine"\nwithout = ["rated_torque"]\n')
    link = served(serve, "elmo-gold")
    done = tworelay("identify", link, "--profile", str(profile), "--travel", "3", "--yes")
    assert done.returncode == 3
    assert "give rated_torque (N.m of the motor) in the axis file" in done.stderr
    axis = tmp_path / "axis.toml"
    axis.write_text(f'link = "{link}"\nprofile = "{profile}"\ntravel = 3.0\nrated_torque = 1.0\n')
    done = tworelay("identify", str(axis), "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)


def test_a_step_clock_is_not_written_to_a_drive_that_is_no_twin(
    serve: Serve, tworelay: Tworelay
) -> None:
    (link,) = serve("bench", "--socketcand", "127.0.0.1:0")
    done = tworelay("identify", f"{link}&clock=step", "--profile", "cia402", "--yes")
    assert done.returncode == 4
    assert "needs a served virtual drive" in done.stderr


def test_a_twin_is_served_on_its_own_bus(tworelay: Tworelay) -> None:
    for arguments, words in (
        (
            ["--profile", "elmo-gold", "--modbus-tcp", "127.0.0.1:0"],
            "is for canopen: its twin is served",
        ),
        (
            ["--profile", "virtual-modbus", "--socketcand", "127.0.0.1:0"],
            "is for modbus: its twin is served",
        ),
        (["--profile", "nosuch", "--socketcand", "127.0.0.1:0"], "no profile named 'nosuch'"),
    ):
        done = tworelay("virtual", "serve", "bench", *arguments)
        assert done.returncode == 2, done.stderr
        assert words in done.stderr


def test_a_drive_that_carries_its_eds_makes_its_own_profile(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    (link,) = serve("bench", "--socketcand", "127.0.0.1:0", "--clock", "step")
    target = tmp_path / "mine.toml"
    done = tworelay("profile", "new", "--drive", link, "--output", str(target))
    assert done.returncode == 0, done.stderr
    profile = load_profile(str(target))
    assert profile.identity.vendor == "0x00007457"
    assert profile.watchdog.kind == "heartbeat"
    done = tworelay("profile", "new", "--drive", "modbus-tcp://127.0.0.1", "--output", "x.toml")
    assert done.returncode == 2
    assert "must be the link of a CANopen drive" in done.stderr


PRESET = {  # what a machine builder may have left in the drive, and where: value by parameter
    "leadshine-el7": {"input_1_function": 0x0001, "torque_target": 7, "auto_tuning": 1},
    "dsy-rs": {"torque_target": 77, "input_1_function": 5, "eeprom_writes": 1},
    "applied-motion-m56s": {"torque_target": 77, "control_mode": 7},
    "delta-asda": {"torque_target": 50, "input_source": 0x000F, "monitor_1": 3},
}


@pytest.mark.parametrize("profile", PRESET)
def test_what_was_set_in_the_drive_is_there_again_after_an_experiment(
    serve: Serve, tworelay: Tworelay, tmp_path: Path, profile: str
) -> None:
    link = served(serve, profile, "--set", f"inertia={SLOW}")
    path = axis_file(tmp_path, link, profile)
    bus = open_drive(load_axis(Path(path)))
    for name, raw in PRESET[profile].items():
        bus._bus.write(bus.profile.parameters[name].address, raw)  # type: ignore[attr-defined]
    bus.close()
    done = tworelay("identify", path, "--yes", "--without-watchdog")
    assert done.returncode == 0, done.stderr
    drive = open_drive(load_axis(Path(path)))
    there = {name: drive.read(name).raw for name in PRESET[profile]}
    drive.close()
    resting = {name: 0 for name in PRESET[profile] if name == "torque_target"}
    assert there == PRESET[profile] | resting
    assert tworelay("restore", "--yes").stdout.strip() == "nothing to restore"


def test_the_bits_of_others_survive_a_stop(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    link = served(serve, "delta-asda")
    path = axis_file(tmp_path, link, "delta-asda")
    client = Client(modbus_wire(parse(link.replace("&clock=step", "")), None), 1, 1.0)
    client.write(16, 0x040E, [0x00F1])  # P4-07: servo on, and four inputs of others
    assert tworelay("stop", path).returncode == 0
    assert client.read(3, 0x040E, 1) == [0x00F0]
    client.close()


def test_a_drive_that_is_enabled_by_what_is_set_there_is_refused(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    link = served(serve, "leadshine-el7", "--clock", "step")
    path = axis_file(tmp_path, link, "leadshine-el7")
    client = Client(modbus_wire(parse(link.replace("&clock=step", "")), None), 1, 1.0)
    client.write(6, 0x0401, [0x0083])
    done = tworelay("identify", path, "--yes", "--without-watchdog")
    assert done.returncode == 3
    assert client.read(3, 0x0323, 1) == [0]  # nothing was prepared
    client.close()


def test_a_drive_that_is_not_set_up_as_its_profile_requires_is_refused(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    """Another M56S than the twin: protocol 133, low word first."""
    link = served(serve, "applied-motion-m56s")
    mine = tmp_path / "mine.toml"
    mine.write_text(
        'extends = "applied-motion-m56s"\nname = "mine"\n'
        'requires = [{ parameter = "protocol", equals = 133 }]\n'
    )
    path = tmp_path / "a.toml"
    path.write_text(
        f'link = "{link}"\nprofile = "{mine}"\ntravel = 30.0\n'
        "rated_torque = 1.0\nencoder = 131072\n"
    )
    done = tworelay("identify", str(path), "--yes", "--without-watchdog")
    assert done.returncode == 3
    assert "'protocol' (register 0120h, 40289: protocol (PR)" in done.stderr
    assert "reads 5, and must be 133" in done.stderr


def test_latency_of_a_drive_that_may_store_each_command_is_refused(
    serve: Serve, tworelay: Tworelay, tmp_path: Path
) -> None:
    (link,) = serve("bench", "--profile", "dsy-rs", "--modbus-rtu-tcp", "127.0.0.1:0")
    done = tworelay("latency", axis_file(tmp_path, link, "dsy-rs"))
    assert done.returncode == 3
    assert "needs eeprom_writes set before (or the drive may store each command)" in done.stderr
