"""Register tables: what becomes a profile, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from profiles.address import ModbusAddress
from profiles.errors import ProfileError
from profiles.library import check, draft_from_csv, load_profile
from profiles.parameter import Unit
from profiles.procedures import Mode
from profiles.schema import Profile
from profiles.table import from_table
from profiles.table_rows import read_csv
from profiles.toml_files import parse_model
from tests.conftest import Tworelay

# P06.05 = 0605h and so on: the DSY-RS' own addresses, in the notations that people use
TABLE = """# a comment
Name;Register;Type;Unit;Scale;Minimum;Maximum;Function;Mask;On;Off;Word order
torque_target;0605h;i16;rated;0,001;-3000;3000;6;;;;
position_actual;0x1207;i32;;;;;;;;;low-first
torque_actual;4612;i16;rated;0.001;;;;;;;
drive_status;1200h;u16;;;;;;0xFF;2;;
servo_on;020Bh;u16;;;;;6;;1;0;
rated_torque;0105h;u16;N.m;0.01;;;;;;;
coulomb_positive;0x700;i16;rated;0.01;-100;100;6;;;;
coulomb_negative;0x701;i16;rated;0.01;-100;100;6;;;;
"""


def test_a_table_becomes_a_profile(tworelay: Tworelay, tmp_path: Path) -> None:
    table, target = tmp_path / "my drive.csv", tmp_path / "mine.toml"
    table.write_text(TABLE, "utf-8")
    done = tworelay("profile", "new", "--csv", str(table), "--output", str(target))
    assert done.returncode == 0, done.stderr
    assert "note: no watchdog_time: the drive does not notice a dead link" in done.stdout
    profile = load_profile(str(target))
    assert profile.name == "my-drive"
    torque = profile.parameters["torque_target"]
    assert isinstance(torque.address, ModbusAddress)
    assert (torque.address.register_, torque.address.write_function) == (0x0605, 6)
    assert (torque.scale, torque.unit, torque.minimum) == (0.001, Unit.RATED_TORQUE, -3000)
    position = profile.parameters["position_actual"].address
    assert isinstance(position, ModbusAddress)
    assert (position.register_, position.word_order) == (0x1207, "low-first")
    assert profile.cycle.function == "fc6+3"
    assert profile.power is not None
    assert profile.power.enabled.holds(0x0102)
    assert not profile.power.enabled.holds(0x0103)
    assert profile.compensation.law == "offset+asymmetric"
    assert not [f for f in check(profile) if f.severity == "error"]


def test_a_cia_402_drive_counted_from_40001_with_commas() -> None:
    rows = read_csv(
        b"name,modicon,type\ncontrolword,40001,u16\nstatusword,40002,u16\nmode_of_operation,40003,i16\n"
        b"mode_display,40004,i16\ntorque_target,40005,i16\nposition_actual,40006,i32\n",
        "t.csv",
    )
    draft = from_table(rows, "X", "t.csv")
    assert 'state_machine = "cia402"' in draft.text
    assert "register = 4\n" in draft.text
    assert any("'torque_target' has no scale" in note for note in draft.notes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Name;Register", "Name;Adress", "no column 'adress'; there are name, register"),
        ("0605h", "0605q", "row 2: register '0605q' must be a number such as 813"),
        ("0,001;-3000", "much;-3000", "row 2: scale 'much' is no number"),
        ("torque_target", "Torque!", "row 2: name 'Torque!' must be of lower-case letters"),
        ("torque_actual", "torque_target", "row 4: 'torque_target' comes twice"),
        ("position_actual", "position_target", "the table lacks position_actual"),
        ("servo_on", "controlword", "the table lacks statusword"),
        ("servo_on", "alarm", "how is the drive enabled? The table needs controlword"),
        # a name, or a unit, that is none: what was probably meant
        (
            "coulomb_positive",
            "coulmb_positive",
            "row 8: 'coulmb_positive' is no name that tworelay knows: is it 'coulomb_positive'?",
        ),
        # by its words, in whatever order, and by what other makers call it
        ("coulomb_positive", "friction_forward", "is it 'coulomb_positive'?"),
        ("position_actual", "actual_position", "is it 'position_actual'?"),
        ("torque_actual", "actual_torque", "is it 'torque_actual'?"),
        ("drive_status", "status", "is it 'drive_status'?"),
        ("coulomb_negative", "reverse_friction", "is it 'coulomb_negative'?"),
        ("0605h", "0605", "register '0605': is it hexadecimal (0605h) or decimal (605)?"),
        ("u16;N.m;", "u16;Nm;", "row 7: unit 'Nm' is none of"),
        ("u16;N.m;", "u16;Nm;", "('N.m'?)"),
        ("i16;rated;0,001", "i16;%;0,001", "('rated'?)"),
        ("0x700;i16", "0x700;i16;rated;x", "scale 'x' is no number"),
        ("0xFF;2", "0xFF;", "drive_status needs 'on'"),
        ("Name;Register", "Name;Name", "column 'name' comes twice"),
    ],
)
def test_a_mistake_is_told_with_its_row(old: str, new: str, words: str) -> None:
    with pytest.raises(ProfileError) as caught:
        from_table(read_csv(TABLE.replace(old, new, 1).encode(), "t.csv"), "x", "t.csv")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("i16;rated;0,001", "i99;rated;0,001", "type"),
        ("i16;rated;0,001", "i16;furlong;0,001", "unit"),
        ("0605h;i16", "0605h;i32", "write_function 6 writes one register"),
    ],
)
def test_what_the_schema_refuses_ends_with_exit_code_2(
    old: str, new: str, words: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    table, target = tmp_path / "t.csv", tmp_path / "mine.toml"
    table.write_text(TABLE.replace(old, new, 1), "utf-8")
    done = tworelay("profile", "new", "--csv", str(table), "--output", str(target))
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not target.exists()


EVERY = (
    "name;register;type;unit;scale;minimum;maximum;mask;on;off;stop;reset;stopping;fault_value;"
    "torque;position;before"
)
KEYS = f"""{EVERY}
torque_target;100h;i16;rated;0.001
position_target;101h;i32
position_actual;202h;i32
drive_status;200h;u16;;;;;0xFF;4 5;;;;6;9 10
servo_on;300h;u16;;;;;;0x55 0xAA;0;2;0xF0
mode_of_operation;0A00h;u16;;;;;;;;;;;;3;1
source;0A01h;u16;;;;;;;;;;;;;;7
fault_reset;0A02h;u16;;;;;;0x11 0x22
store_command;402h;u16;;;;;;0x1234
store_status;403h;u16;;;;;0x0F;5
max_torque;410h;u16;rated;0.001
max_torque_negative;411h;i16;rated;0.001;-4000;0
watchdog_time;420h;u16;s;0.001
torque_offset;500h;i16;rated;0.001
coulomb_positive;501h;i16;rated;0.001;0;300
coulomb_negative;502h;i16;rated;0.001;-300;300
friction_speed;503h;u16;rpm
serial_number;600h;u32
rated_torque;610h;u16;N.m;0.01
encoder_increments;612h;u32
"""


def test_keys_modes_and_a_linear_zone_become_a_profile_that_is_performed(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    table, target = tmp_path / "acme.csv", tmp_path / "acme.toml"
    table.write_text(KEYS, "utf-8")
    done = tworelay("profile", "new", "--csv", str(table), "--output", str(target))
    assert done.returncode == 0, done.stderr
    assert "coulomb_negative takes values below zero" in done.stdout
    profile = load_profile(str(target))
    power, law, store = profile.power, profile.compensation, profile.store
    assert power is not None
    assert store is not None
    assert [step.raw for step in power.enable] == [0x55, 0xAA]
    assert power.enabled.wanted == (4, 5)
    assert power.stopping is not None
    assert power.stopping.holds(6)
    assert power.fault is not None
    assert power.fault.wanted == (9, 10)
    assert [(s.write, s.raw) for s in power.reset] == [
        ("servo_on", 0xF0), ("fault_reset", 0x11), ("fault_reset", 0x22), ("servo_on", 0),
    ]  # fmt: skip
    assert [(s.write, s.raw) for s in profile.stop] == [("servo_on", 2)]
    codes = {str(mode): mode_codes[0].code for mode, mode_codes in profile.modes.items()}
    assert codes == {"torque": 3, "position": 1}
    assert [(s.write, s.raw) for s in profile.modes[Mode.TORQUE][0].before] == [("source", 7)]
    assert (law.law, law.negative_sign, law.speed) == ("saturated-linear", -1, "friction_speed")
    assert profile.limits["torque_negative"] == "max_torque_negative"
    assert [(s.write, s.raw, s.until, s.mask, s.equals) for s in store.steps] == [
        ("store_command", 0x1234, None, -1, None), (None, None, "store_status", 15, 5),
    ]  # fmt: skip
    done = tworelay("profile", "check", str(target))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all of it performed on its own twin" in done.stdout


@pytest.mark.parametrize("speed", ["", "friction_speed;503h;u16;rpm\n"])
def test_one_torque_for_both_directions(speed: str) -> None:
    rows = KEYS.replace("coulomb_positive;", "friction;")
    rows = "\n".join(
        line for line in rows.splitlines()
        if not line.startswith(("coulomb_negative", "friction_speed"))
    )  # fmt: skip
    draft = from_table(read_csv(f"{rows}\n{speed}".encode(), "t.csv"), "x", "t.csv")
    assert f'law = "{"saturated-linear" if speed else "single-gain"}"' in draft.text


def test_terms_of_no_law_are_refused(tmp_path: Path) -> None:
    text = KEYS.replace("coulomb_negative;", "# coulomb_negative;").encode()
    with pytest.raises(ProfileError, match="are the terms of no law"):
        from_table(read_csv(text, "t.csv"), "x", "t.csv")


def test_questions_need_a_terminal(tworelay: Tworelay, tmp_path: Path) -> None:
    done = tworelay("profile", "new", "--output", str(tmp_path / "x.toml"))
    assert done.returncode == 2
    assert "give --eds F, --csv F or --drive LINK; questions need a terminal" in done.stderr


STATUS = "name;register;type;unit;scale;function;mask;on;off;stop;reset;fault\n"
ROWS = (
    "torque_target;1002h;i16;rated;0.001;6\nposition_actual;1004h;i32\n"
    "drive_status;1000h;u16;;;;0x01;1;;;;0x08\nservo_on;1001h;u16;;;6;;1;0;2;4\n"
)


def test_quick_stop_fault_and_reset_are_asked_for_and_their_lack_is_said(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text(STATUS + ROWS)
    profile = parse_model(draft_from_csv(path).text, Profile, "mine")
    assert [(s.write, s.raw) for s in profile.stop] == [("servo_on", 2)]
    assert [(s.write, s.raw) for s in profile.disable] == [("servo_on", 0)]
    assert profile.power is not None
    assert profile.power.fault is not None
    assert profile.power.fault.holds(0x09)
    assert not profile.power.fault.holds(0x01)
    assert [(s.write, s.raw) for s in profile.power.reset] == [("servo_on", 4), ("servo_on", 0)]
    path.write_text(STATUS + ROWS.replace(";2;4", "").replace(";;;;0x08", ""))
    notes = " ".join(draft_from_csv(path).notes)
    for words in ("and coasts", "a fault is not recognised", "leaves that proof out"):
        assert words in notes


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (("i16;rated", "int16;rated"), "row 2: type 'int16' is none of i8, u8"),
        (("rated;0.001", "0.1 %;1"), "row 2: unit '0.1 %' is none of"),
    ],
)
def test_a_wrong_type_or_unit_is_told_with_its_row(
    tmp_path: Path, wrong: tuple[str, str], words: str
) -> None:
    path = tmp_path / "mine.csv"
    path.write_text(STATUS + ROWS.replace(*wrong))
    with pytest.raises(ProfileError) as caught:
        draft_from_csv(path)
    assert words in str(caught.value)
