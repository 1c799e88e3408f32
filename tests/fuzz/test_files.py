"""Whatever a file holds: it is read, or refused in one line. Nothing else, and never for long."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from commissioning.fleet.loading import load_fleet
from commissioning.fleet.plan import differences
from commissioning.fleet.taking_up import chosen
from commissioning.recordings.files import table_of
from commissioning.recordings.reading import read
from drivers.link_text import is_simulated, parse
from profiles.axis import load_axis
from profiles.draft import from_eds
from profiles.eds import parse_eds
from profiles.errors import TwoRelayError
from profiles.library import builtin_names, check, digest, load_profile
from profiles.schema import Profile
from profiles.table import from_table
from profiles.table_rows import read_csv
from profiles.toml_files import parse_model
from tests.command import ROOT
from tests.fuzz.mutation import fuzzed, mutated

BUILTIN = ROOT / "profiles" / "builtin"
PROFILES = [(BUILTIN / f"{name}.toml").read_bytes() for name in builtin_names()]
TEMPLATE = (BUILTIN / "cia402.toml").read_text("utf-8")
OBJECTS = {
    "6040": (6, "rww"), "6041": (6, "ro"), "6060": (2, "rw"), "6061": (2, "ro"), "6064": (4, "ro"),
    "6071": (3, "rww"), "6072": (6, "rw"), "6076": (7, "ro"), "6502": (7, "ro"),
}  # fmt: skip
EDS = (
    "[FileInfo]\nFileName=x.eds\nEDSVersion=4.0\n[DeviceInfo]\nVendorName=ACME\nVendorNumber=0x2A\n"
    "ProductName=D1\nProductNumber=7\n[MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n"
    + "".join(
        f"[{index}]\nParameterName=P{index}\nObjectType=0x7\nDataType=0x000{kind}\nAccessType={access}\n"
        f"DefaultValue={'0x3AD' if index == '6502' else '$NODEID+1'}\nLowLimit=\nHighLimit=\n"
        f"PDOMapping=1\n"
        for index, (kind, access) in OBJECTS.items()
    )
).encode()
TABLE = b"""name;register;type;unit;scale;minimum;maximum;function;mask;on;off
torque_target;0605h;i16;rated;0.001;-3000;3000;6;;;
position_actual;0x1207;i32;;;;;;;;
drive_status;1200h;u16;;;;;;0xFF;2;
servo_on;020Bh;u16;;;;;6;;1;0
coulomb_positive;0x700;i16;rated;0.01;-100;100;6;;;
coulomb_negative;0x701;i16;rated;0.01;-100;100;6;;;
"""
AXIS = b"""link = "modbus-tcp://192.168.1.10?unit=1"
profile = "virtual-modbus"
travel = 0.2
[mechanics]
motion = "linear"
gear = 2.0
feed = 0.01
held_by = "brake"
[limits]
torque = 400.0
speed = 0.5
"""
FLEET = b"""name = "line"
job = "commission"
confirm = "group"
[defaults]
fraction = 0.85
max_torque = 0.5
[zones.cell]
at_once = 2
[groups.gantry]
zone = "cell"
on_failure = "go-on"
[[axes]]
name = "left"
link = "virtual://bench?seed=1"
group = "gantry"
serial = "0x38EB7EA1"
[[axes]]
name = "feed"
link = "canopen://socketcan/can0?node=5"
travel = 1.5
after = ["left"]
limits = { speed = 3.0 }
[[axes]]
name = "table"
link = "modbus-rtu:///dev/ttyUSB7?unit=2"
zone = "cell"
twin = "bench?coulomb=0.2"
"""
RECORDING = "time_s,position_rad,command_Nm\n" + "".join(
    f"{0.001 * k:.3f},{0.01 * (k % 7):.4f},{0.1 if k % 10 < 5 else -0.1}\n" for k in range(60)
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "x.toml"


@given(mutated(EDS))
@fuzzed
def test_eds(data: bytes) -> None:
    with suppress(TwoRelayError):
        parse_model(from_eds(parse_eds(data, "x.eds"), TEMPLATE, "x.eds").text, Profile, "x.eds")


@given(mutated(*PROFILES))
@fuzzed
def test_profiles(file: Path, data: bytes) -> None:
    file.write_bytes(data)
    with suppress(TwoRelayError):
        profile = load_profile(str(file))
        check(profile)
        digest(profile)


@given(mutated(TABLE))
@fuzzed
def test_register_tables(data: bytes) -> None:
    with suppress(TwoRelayError):
        parse_model(from_table(read_csv(data, "t.csv"), "x", "t.csv").text, Profile, "t.csv")


@given(mutated(AXIS))
@fuzzed
def test_axis_files(file: Path, data: bytes) -> None:
    file.write_bytes(data)
    with suppress(TwoRelayError):
        load_axis(file)


@given(mutated(FLEET))
@fuzzed
def test_fleet_files(file: Path, data: bytes) -> None:
    file.write_bytes(data)
    with suppress(TwoRelayError):
        fleet = load_fleet(file)
        assert not list(differences(fleet.definition, fleet.definition))
        chosen(fleet, "!feed")


@given(mutated(RECORDING.encode()))
@fuzzed
def test_recordings(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(data)
    with suppress(TwoRelayError):
        read(table_of(path), {})


LINKS = (
    "virtual://bench?coulomb=0.1&delay=0.002", "modbus-tcp://10.0.0.1:502?unit=1",
    "modbus-rtu:COM5?unit=1",
    "canopen://socketcand/[::1]:29536/can0?node=5&bitrate=500000", "modbus-tls://h:802?ca=a&cert=b&key=c",
    "modbus-rtu:///spy:///dev/null?file=x", "canopen://slcan/%2Fdev%2Fpts%2F3?node=5", "virtual://bench?state=x",
)  # fmt: skip
OPTIONS = {
    "unit", "node", "timeout", "clock",
    "baudrate", "parity", "stopbits", "bitrate", "sync", "ca", "cert", "key",
}  # fmt: skip
NAME = re.compile(r"[A-Za-z0-9_.:/\\\[\]@-]*")


@given(st.one_of(mutated(*(link.encode() for link in LINKS)), st.binary(max_size=60)))
@fuzzed
def test_links(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    with suppress(TwoRelayError):
        link = parse(text)
        is_simulated(text)
        for name in (link.device, link.interface, link.channel if link.interface else ""):
            assert NAME.fullmatch(name), name
            assert "://" not in name, "a handler of a library"
        assert set(link.options) <= OPTIONS or link.scheme == "virtual"
