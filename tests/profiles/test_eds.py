"""EDS and DCF files as they are out there.

What is mended, what is refused, and never a traceback.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from profiles.address import CanopenAddress
from profiles.eds import parse_eds, read_eds
from profiles.errors import ProfileError
from profiles.library import check, draft_from_eds, load_profile
from profiles.procedures import Mode
from profiles.schema import Profile
from tests.command import ROOT
from tests.conftest import Tworelay

DATA = ROOT.parent / "shared" / "data" / "eds"
real_files = pytest.mark.skipif(not DATA.exists(), reason="the drives' own files are not here")

# what the drives' own files say (their sections 6071h, 6502h and 1018h, read by eye)
REFUSED = {
    "cia__301_profile.eds": "no [DeviceInfo] section",
    "faulhaber__605.3150.51-V-EK-2-60.eds": "no 6071h target torque",
    "faulhaber__605.3150.67-A-EK-2-60.eds": "no 6071h target torque",
    "faulhaber__605.3150.73-A-EK-2-60.eds": "no 6071h target torque",
    "igus__dryve-D1-4PDO.eds": "no 6071h target torque",
    "pilz__prbt_0_1.dcf": "its 60B2h torque offset is an addition",
    "ros2canopen__cia402_slave.eds": "no 6071h target torque",
    "schunk__ERB415.eds": "no 6071h target torque",
    "technosoft__ipos_ros2canopen.eds": "6502h supported drive modes is 0x1F0065",
    "test__canopen-python_sample.eds": "no CiA 402 drive",
    "zltech__zlac8015d_sim.eds": "6071h target torque is read only in this drive, and in no PDO",
}
USABLE = {  # vendor and product of object 1018h
    "cia__402_profile.eds": (None, None),
    "elmo__Elmo_cob.dcf": ("0x0000009A", "0x00030923"),
    "eyou__YiyouServo_V1.4.eds": ("0x00000668", "0x00220811"),
    "ingenia__EverestXCR.eds": ("0x0000029C", "0x00000019"),
    "maxon__EPOS4_CRF.eds": ("0x000000FB", "0x61500000"),
}


@real_files
def test_every_file_of_a_real_drive_is_known_here() -> None:
    assert {path.name for path in DATA.iterdir()} == {*REFUSED, *USABLE}


@real_files
@pytest.mark.parametrize("name", REFUSED)
def test_a_drive_without_a_torque_command_is_refused_with_the_reason(
    name: str, tworelay: Tworelay, tmp_path: Path
) -> None:
    done = tworelay(
        "profile", "new", "--eds", str(DATA / name), "--output", str(tmp_path / "p.toml")
    )
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert REFUSED[name] in done.stderr
    assert not (tmp_path / "p.toml").exists()


@real_files
@pytest.mark.parametrize("name", USABLE)
def test_a_torque_drive_becomes_a_profile(name: str, tworelay: Tworelay, tmp_path: Path) -> None:
    target = tmp_path / "p.toml"
    done = tworelay("profile", "new", "--eds", str(DATA / name), "--output", str(target))
    assert done.returncode == 0, done.stderr
    profile = load_profile(str(target))
    assert (profile.identity.vendor, profile.identity.product) == USABLE[name]
    assert profile.modes[Mode.TORQUE]
    has_offset = name.split("__", maxsplit=1)[0] in (
        "elmo",
        "ingenia",
        "maxon",
    )  # 60B2h is in their files
    assert profile.compensation.law == ("host" if has_offset else "none")
    assert not [f for f in check(profile) if f.severity == "error"]


@real_files
def test_what_the_files_say_beyond_the_standard_is_taken() -> None:
    def type_of(name: str, parameter: str) -> str:
        address = load_drafted(name).parameters[parameter].address
        assert isinstance(address, CanopenAddress)
        return address.type

    assert type_of("eyou__YiyouServo_V1.4.eds", "max_torque") == "i16"
    assert type_of("elmo__Elmo_cob.dcf", "max_torque") == "u16"
    notes = draft_from_eds(DATA / "elmo__Elmo_cob.dcf").notes
    assert any("delivered with 50000 per mille, which means no limit" in note for note in notes)
    notes = draft_from_eds(DATA / "maxon__EPOS4_CRF.eds").notes
    assert any("no 608Fh: give encoder" in note for note in notes)
    eyou = load_drafted("eyou__YiyouServo_V1.4.eds")
    assert [mode.code for mode in eyou.modes[Mode.TORQUE]] == [10, 4]  # 6502h = 3CDh: tq and cst
    assert "rated_torque" not in eyou.parameters


def load_drafted(name: str):  # type: ignore[no-untyped-def]
    from profiles.schema import Profile
    from profiles.toml_files import parse_model

    return parse_model(draft_from_eds(DATA / name).text, Profile, name)


SHORT = """[DeviceInfo]
VendorName=Acme
VendorNumber=0x99
[6040]
ParameterName=Controlword
DataType=0x6
AccessType=rww
[6041]
ParameterName=Statusword
DataType=0x6
AccessType=ro
[6060]
ParameterName=Modes of operation
DataType=0x2
AccessType=rww
[6064]
ParameterName=Position actual value
DataType=0x4
AccessType=ro
[6071]
ParameterName=Target torque
DataType=0x3
AccessType=rww
[607A]
ParameterName=Target position
DataType=0x4
AccessType=rww
[6502]
ParameterName=Supported drive modes
DataType=0x7
AccessType=ro
DefaultValue=0x3EF
ParameterValue=0x201
[60A9]
ParameterName=SI unit velocity
DataType=0x7
AccessType=rw
DefaultValue=0xFDB44700
[1018]
ParameterName=Identity
ObjectType=0x9
DataType=0x7
AccessType=ro
CompactSubObj=2
[1018Value]
NrOfEntries=2
1=0x123
2=0x456
[2F10]
ParameterName=Friction compensation
ObjectType=0x8
DataType=0x3
AccessType=rw
CompactSubObj=2
[2F10Name]
NrOfEntries=2
1=Positive
2=Negative
[2F11]
ParameterName=Static friction torque
DataType=0x8
AccessType=rw
"""


def draft(text: str, tmp_path: Path) -> tuple[Profile, str]:
    """The profile of an EDS, and all that is said of it."""
    path, target = tmp_path / "drive.eds", tmp_path / "drive.toml"
    path.write_text(text, "utf-8")
    made = draft_from_eds(path)
    target.write_text(made.text, "utf-8")
    return load_profile(str(target)), "\n".join(made.notes)


def test_arrays_in_short_have_names_values_and_an_identity_that_counts(tmp_path: Path) -> None:
    """CompactSubObj with [....Name] and [....Value]: CiA 306, 4.6.3.3."""
    eds = parse_eds(SHORT.encode(), "x.eds")
    assert [eds.value(0x1018, sub) for sub in (0, 1, 2)] == [2, 0x123, 0x456]
    entry = eds.entry(0x2F10, 2)
    assert entry is not None
    assert (entry.name, entry.type, entry.access) == ("Negative", "i16", "rw")
    profile, said = draft(SHORT, tmp_path)
    assert (profile.identity.vendor, profile.identity.product) == ("0x00000123", "0x00000456")
    assert "VendorNumber is 99h in [DeviceInfo], and 123h in 1018h:01: 1018h counts" in said


def test_what_a_dcf_is_set_to_counts_before_what_is_delivered(tmp_path: Path) -> None:
    """6502h = 201h: profile position and cyclic torque, neither torque nor cyclic position."""
    profile, said = draft(SHORT, tmp_path)
    assert [code.code for code in profile.modes[Mode.TORQUE]] == [10]
    assert Mode.POSITION not in profile.modes
    assert "no cyclic position mode in 6502h = 0x201" in said
    assert "no 6061h: the mode is read back where it is written" in said


def test_friction_objects_of_the_maker_are_candidates(tmp_path: Path) -> None:
    _, said = draft(SHORT, tmp_path)
    assert "2F10h:01 'Friction compensation: Positive' (i16)" in said
    assert "2F11h 'Static friction torque' (f32) stand in the file; describe" in said
    assert "60A9h counts velocities in 10^-3 rev/min" in said


def test_guarding_is_seen_where_there_is_no_heartbeat(tmp_path: Path) -> None:
    guarding = SHORT + "".join(
        f"[{index}]\nParameterName={name}\nDataType={kind}\nAccessType=rw\n"
        for index, name, kind in (("100C", "Guard time", 6), ("100D", "Life time factor", 5))
    )
    profile, said = draft(guarding, tmp_path)
    watchdog = profile.watchdog
    assert (watchdog.kind, watchdog.parameter, watchdog.life_factor) == (
        "guarding", "guard_time", "life_factor",
    )  # fmt: skip
    assert "life guarding (100Ch, 100Dh)" in said
    profile, said = draft(SHORT, tmp_path)
    assert profile.watchdog.kind == "none"
    assert "no consumer heartbeat 1016h, no life guarding 100Ch" in said


@pytest.mark.parametrize(
    ("gone", "reason"),
    [
        ("6064", "the drive has no position feedback 6064h"),
        ("6041", "the drive has no statusword 6041h"),
        ("6071", "no 6071h target torque"),
    ],
)
def test_the_reason_of_a_refusal_is_the_true_one(gone: str, reason: str, tmp_path: Path) -> None:
    text = SHORT.replace(f"[{gone}]", "[5FFF]", 1)
    with pytest.raises(ProfileError) as caught:
        draft(text, tmp_path)
    assert reason in str(caught.value)


def test_the_built_in_profile_of_a_drive_is_named(tmp_path: Path) -> None:
    elmo = SHORT.replace("1=0x123", "1=0x9A").replace("2=0x456", "2=0x30923")
    assert "the built-in profile 'elmo-gold' is for this drive" in draft(elmo, tmp_path)[1]
    kollmorgen = SHORT.replace("VendorName=Acme", "VendorName=Kollmorgen\nProductName=AKD-P")
    assert "the built-in profile 'kollmorgen-akd' may be for this" in draft(kollmorgen, tmp_path)[1]


@real_files
def test_a_byte_that_is_not_utf_8_is_read_and_reported_with_its_line() -> None:
    found = read_eds(DATA / "faulhaber__605.3150.51-V-EK-2-60.eds")
    assert [str(m) for m in found.mended] == [
        "line 52: byte 0x94 is not UTF-8: read as Windows-1252"
    ]


# -- every oddity by itself -----------------------------------------------------------------------

DEVICE = "[DeviceInfo]\nVendorName=ACME\nProductName=D1\nVendorNumber=0x2A\nProductNumber=7\n"
OBJECT = (
    "ParameterName=Target torque\nObjectType=0x7\nDataType=0x0003\nAccessType=rww\nPDOMapping=1\n"
)


def parsed(text: str | bytes):  # type: ignore[no-untyped-def]
    data = text if isinstance(text, bytes) else text.encode()
    return parse_eds(data, "x.eds")


@pytest.mark.parametrize(
    ("text", "mended"),
    [
        (b"\xef\xbb\xbf" + f"{DEVICE}[6071]\n{OBJECT}".encode(), "line 1: a byte order mark"),
        (f"{DEVICE}[6071]\n{OBJECT}".encode() + b"Note=\xfc\n", "byte 0xFC is not UTF-8"),
        (f"{DEVICE}[6071]\n{OBJECT}nonsense\n", "line 12: 'nonsense' has no '='"),
        (f"{DEVICE}[6071\n{OBJECT}", "line 6: '[6071' lacks its ']'"),
        (f"{DEVICE}[6071]\n{OBJECT}[6071]\nx=1\n", "section [6071] comes twice"),
        (f"{DEVICE}[6071]\n{OBJECT}DataType=9\n", "DataType comes twice: the first is taken"),
        (f"{DEVICE}VendorNumber2=1\n[6071]\n{OBJECT}LowLimit=4.0\n", "LowLimit=4.0 is read as 4"),
        (f"{DEVICE}[6071]\n{OBJECT}LowLimit=low\n", "LowLimit=low is no number"),
        (f"{DEVICE}[6071]\n{OBJECT}HighLimit=010\n", "HighLimit=010 is read as decimal"),
        (f"{DEVICE}[6071]\n{OBJECT}HighLimit=5 ; five\n", "HighLimit=5 ; five is read as 5"),
        (f"{DEVICE}[6071]\n{OBJECT.replace('AccessType=rww', '')}", "AccessType is missing"),
        (f"{DEVICE}[6071]\n{OBJECT.replace('rww', 'maybe')}", "AccessType 'maybe' is unknown"),
        (f"x=1\n{DEVICE}[6071]\n{OBJECT}", "line 1: 'x=1' stands before the first section"),
        (
            f"{DEVICE}[OptionalObjects]\nSupportedObjects=2\n1=0x6071\n[6071]\n{OBJECT}",
            "counts 2 objects and lists 1",
        ),
        (
            (f"{DEVICE}[OptionalObjects]\nSupported "
            f"Objects=0x2\n1=0x6071\n2=0x6099\n[6071]\n{OBJECT}"),
            "object 6099h is listed and not described",
        ),
    ],
)  # fmt: skip
def test_an_oddity_is_mended_and_said_with_its_line(text: str | bytes, mended: str) -> None:
    found = parsed(text)
    assert any(mended in str(item) for item in found.mended), [str(m) for m in found.mended]
    assert found.entry(0x6071) is not None


@pytest.mark.parametrize("data_type", ["3", "0x3", "0x0003", "0x003"])
@pytest.mark.parametrize("access", ["rww", "RWW", "rw", "rwr", "Rw"])
def test_numbers_and_access_in_every_spelling(data_type: str, access: str) -> None:
    body = OBJECT.replace("0x0003", data_type).replace("rww", access)
    entry = parsed(f"{DEVICE}[6071]\n{body}").entry(0x6071)
    assert entry.type == "i16"
    assert entry.access == "rw"


@pytest.mark.parametrize("section", ["1018sub1", "1018Sub1", "1018SUB1", "1018sub01"])
def test_sub_objects_in_every_spelling(section: str) -> None:
    body = OBJECT.replace("0x0003", "7").replace("rww", "Const")
    entry = parsed(f"{DEVICE}[{section}]\n{body}").entry(0x1018, 1)
    assert (entry.type, entry.access) == ("u32", "ro")


def test_a_negative_limit_that_is_written_as_its_bits() -> None:
    body = OBJECT.replace("0x0003", "4") + "LowLimit=0x80000000\nHighLimit=0x7FFFFFFF\n"
    entry = parsed(f"{DEVICE}[607A]\n{body}").entry(0x607A)
    assert (entry.low, entry.high) == (-(2**31), 2**31 - 1)


@pytest.mark.parametrize("value", ["$NODEID+0x180", "0x180+$NODEID", "$NODEID", "$nodeid+384", ""])
def test_a_default_that_hangs_on_the_node_is_no_number(value: str) -> None:
    entry = parsed(f"{DEVICE}[1400]\n{OBJECT}DefaultValue={value}\n").entry(0x1400)
    assert entry.default is None


def test_a_dcf_has_values_beside_its_defaults() -> None:
    entry = parsed(f"{DEVICE}[6072]\n{OBJECT}DefaultValue=1000\nParameterValue=850\n").entry(0x6072)
    assert (entry.default, entry.value) == (1000, 850)


@pytest.mark.parametrize(
    "text", ["", "no eds at all", "[FileInfo]\nx=1\n", DEVICE, "\0\0\0", "[[[[\n]=\n"]
)
def test_what_is_no_eds_is_refused(text: str) -> None:
    with pytest.raises(ProfileError, match="no EDS"):
        parsed(text)


PIECES = st.lists(
    st.one_of(
        st.sampled_from(
            ["[DeviceInfo]", "[6071]", "[1018sub1]", "[6502]", "[OptionalObjects]", "VendorNumber=",
             "DataType=0x0003", "AccessType=rw", "ObjectType=0x7", "DefaultValue=$NODEID+1",
             "SupportedObjects=99999999999999999999", "1=0x6071", "LowLimit=-0x8000", "=", "[", "]"]
        ),
        st.text(max_size=30),
    ),
    max_size=40,
)  # fmt: skip


@given(PIECES)
@example(["[DeviceInfo]", "VendorNumber=" + "9" * 5000, "[6071]", "DataType=3", "AccessType=rw"])
@settings(max_examples=200, deadline=None)
def test_no_text_makes_a_traceback(pieces: list[str]) -> None:
    try:
        parse_eds("\n".join(pieces).encode("utf-8", "surrogatepass"), "x.eds")
    except ProfileError:
        return


@given(st.binary(max_size=400))
@settings(max_examples=200, deadline=None)
def test_no_bytes_make_a_traceback(data: bytes) -> None:
    try:
        parse_eds(DEVICE.encode() + data, "x.eds")
    except ProfileError:
        return


def test_what_is_wrong_with_the_command_is_said(tworelay: Tworelay, tmp_path: Path) -> None:
    there = tmp_path / "p.toml"
    there.write_text("")
    for arguments, words in (
        (["--eds", "nosuch.eds", "--output", str(tmp_path / "q.toml")], "cannot be read"),
        (["--eds", "x", "--output", str(there)], "exists already"),
        (["--eds", "x", "--output", "p.txt"], "ends with .toml"),
    ):
        done = tworelay("profile", "new", *arguments)
        assert done.returncode == 2
        assert words in done.stderr
