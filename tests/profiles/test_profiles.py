"""Profiles and axis files: what is accepted, and what is said of a mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from profiles.axis import load_axis
from profiles.errors import IdentityMismatch, ProfileError, UnknownName
from profiles.identity import Identity
from profiles.law import CompensationLaw
from profiles.library import (
    builtin_names,
    check,
    digest,
    fitting,
    load_profile,
    outdated,
    source_text,
)
from tests.command import ROOT

TEXT = source_text("virtual-modbus")


@pytest.mark.parametrize("name", builtin_names())
def test_every_built_in_profile_is_valid_and_clean(name: str) -> None:
    profile = load_profile(name)
    assert profile.name == name
    assert not [f for f in check(profile) if f.severity == "error"]
    assert len(digest(profile)) == 64


def test_the_virtual_profiles_have_the_same_names_and_law() -> None:
    modbus, canopen = load_profile("virtual-modbus"), load_profile("virtual-canopen")
    assert modbus.compensation == canopen.compensation
    only_modbus = set(modbus.parameters) - set(canopen.parameters)
    assert only_modbus == {"store_status", "serial_number"}
    assert modbus.compensation.law is CompensationLaw.COULOMB_VISCOUS


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('stop_time = 1.0', 'stop_tme = 1.0'), "stop_tme: unknown key, did you mean 'stop_time'"),
        (('title = "Target torque"', 'titel = "x"'),
        r"\[parameters.torque_target\] titel: unknown key"),
        (('bus = "modbus"', 'bus = "profibus"'), "bus: input should be 'modbus' or 'canopen'"),
        (('register = 0x0100', 'register = 70000'), "register"),
        (('type = "i16" }\ntitle = "Target torque"', 'type = "i17" }\ntitle = "Target torque"'),
        "i17"),
        (('scale = 0.001\nprotection = "command"', 'scale = 0\nprotection = "command"'),
        "scale is 0"),
        (('minimum = 0\nmaximum = 8', 'minimum = 9\nmaximum = 8'), "upside down"),
        (('minimum = 0\nmaximum = 8', 'minimum = 0\nmaximum = 99999'), "does not fit type i16"),
        (('law = "coulomb+viscous"', 'law = "magic"'), "law"),
        (('positive = "coulomb_positive"\n', ''), "needs positive"),
        (('viscous = "viscous_gain"', 'viscous = "viscous_gain"\ngain = "viscous_gain"'),
        "names gain, too"),
        (('parameter = "watchdog_time"', 'parameter = "wd"'), r"\[watchdog\] names 'wd'"),
        (('write = "controlword"\nraw = 0x0002', 'write = "cw"\nraw = 2'), r"\[stop\] names 'cw'"),
        (('write = "controlword"\nraw = 0x0002', 'write = "controlword"'), "a step is either"),
        (('function = "fc23"', 'function = "pdo"'), "does not fit bus"),
        (('integral_time = "integral_time"\n', ''), "go together"),
        (('scale = 0.01\nmaximum = 1000000\nprotection = "gain"',
          'scale = 0.01\nmaximum = 1000000\nprotection = "read"'), "must have protection 'gain'"),
        (('unit = "1/s"', 'unit = "rpm"'), "must have unit '1/s'"),
        (('lag = "torque_lag"', 'lag = "torque_lagg"'), r"\[loops\] names 'torque_lagg'"),
        (('timeout = 0.05', 'timeout = inf'), "timeout"),
        (('timeout = 0.05', 'timeout = "fast"'), "timeout"),
        (('[parameters.controlword]', '[parameters.cw]'), "lacks controlword"),
        (('name = "virtual-modbus"', 'name = "Virtual Modbus!"'), "name"),
        (('version = "1.1.0"', ''), "version: is missing"),
        (('[link]', '[link'), "is not TOML"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_file_section_key(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    assert change[0] in TEXT
    path = tmp_path / "mine.toml"
    path.write_text(TEXT.replace(*change, 1))
    with pytest.raises(ProfileError, match=message) as caught:
        load_profile(str(path))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_profiles(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="cannot be read"):
        load_profile(str(tmp_path / "missing.toml"))
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ProfileError, match="UTF-8"):
        load_profile(str(binary))
    large = tmp_path / "large.toml"
    large.write_text("#" * 1_000_001)
    with pytest.raises(ProfileError, match="larger than"):
        load_profile(str(large))
    deep = tmp_path / "deep.toml"
    deep.write_text("a = " + "[" * 5000)
    with pytest.raises(ProfileError, match="is not TOML"):
        load_profile(str(deep))


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(
        UnknownName, match=r"applied-motion.*, cia402, .*, virtual-canopen, virtual-modbus"
    ):
        load_profile("nosuch")


def test_the_profile_that_fits_an_identity() -> None:
    def identity(vendor: str, product: str) -> Identity:
        return Identity(vendor=vendor, product=product, revision="1.0", serial="1")

    assert fitting(identity("tworelay", "virtual drive"), "modbus").name == "virtual-modbus"
    assert fitting(identity("0x00007457", "0x00000001"), "canopen").name == "virtual-canopen"
    with pytest.raises(IdentityMismatch, match="no built-in profile fits"):
        fitting(identity("ACME", "X"), "modbus")


def test_check_finds_what_will_go_wrong(tmp_path: Path) -> None:
    text = TEXT.replace("register = 0x0402", "register = 0x0401")
    text = text.replace('acts_in = ["position"]', 'acts_in = ["torque"]')
    text = text.replace('kind = "cycle"', 'kind = "none"')
    text = text.replace(
        'trust = "verified"\nnonvolatile = true\n\n# -- loop', 'trust = "unverified"\n\n# -- loop'
    )
    path = tmp_path / "mine.toml"
    path.write_text(text)
    found = {(f.severity, f.text) for f in check(load_profile(str(path), lenient=True))}
    with pytest.raises(
        ProfileError, match=r"overlaps 'coulomb_positive' at register 0401h \(and 1 more"
    ):
        load_profile(str(path))
    assert any("coulomb_negative] overlaps 'coulomb_positive'" in text for _, text in found)
    assert any("torque mode only" in text for _, text in found)
    assert any("does not notice a dead link" in text for _, text in found)
    assert any("viscous_gain] is written by apply but unverified" in text for _, text in found)


def test_an_axis_file(tmp_path: Path) -> None:
    path = tmp_path / "press-7-x.toml"
    path.write_text(
        'link = "modbus-tcp://127.0.0.1:1?unit=1"\ntravel = 0.2\ngroup = "gantry"\n'
        '[mechanics]\nmotion = "linear"\ngear = 2.0\nfeed = 0.01\nheld_by = "brake"\n'
        "[limits]\ntorque = 100.0\n"
    )
    axis = load_axis(path)
    assert axis.name == "press-7-x"
    assert axis.mechanics.travel_per_revolution == pytest.approx(0.005)
    assert axis.position_unit == "m"
    assert axis.effort_unit == "N"
    path.write_text("travl = 1.0")
    with pytest.raises(ProfileError, match="did you mean 'travel'"):
        load_axis(path)
    path.write_text("travel = -1.0")
    with pytest.raises(ProfileError, match="greater than 0"):
        load_axis(path)


def test_a_number_of_thousands_of_digits_is_no_traceback(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text('name = "x"\nstop_time = ' + "9" * 5000 + "\n")
    with pytest.raises(ProfileError, match="is not TOML"):
        load_profile(str(path))


CIA402 = (ROOT / "profiles" / "builtin" / "cia402.toml").read_text("utf-8")
DSY = (ROOT / "profiles" / "builtin" / "dsy-rs.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("text", "old", "new", "words"),
    [
        (CIA402, "code = 10\n", "", "lacks a code"),
        (
            CIA402,
            '"torque_target", "position_target"]',
            '"position_target"]',
            "out lacks 'torque_target'",
        ),
        (DSY, "mask = 0x000F, equals = 1", "mask = 0x0008, equals = 1", "can never read so"),
        (DSY, 'out = ["torque_target"]', "out = []", "out lacks 'torque_target'"),
    ],
)
def test_a_profile_that_could_not_be_driven_is_refused(
    tmp_path: Path, text: str, old: str, new: str, words: str
) -> None:
    assert old in text
    path = tmp_path / "p.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ProfileError, match=words):
        load_profile(str(path))


@pytest.mark.parametrize(
    "without", ['[["a"]]', "3", '["nosuch"]', '["parameters", "rated_torque"]']
)
def test_a_bad_without_is_told(tmp_path: Path, without: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'extends = "cia402"\nname = "x"\nwithout = {without}\n')
    with pytest.raises(ProfileError, match="without"):
        load_profile(str(path))


def test_a_profile_of_a_run_may_have_been_corrected_since() -> None:
    profile = load_profile("beckhoff-ax2000")
    assert outdated(profile) == ""
    said = outdated(profile.model_copy(update={"version": "1.0.0"}))
    assert "profile beckhoff-ax2000 1.0.0, and the built-in one is 2.0.0" in said
    assert outdated(profile.model_copy(update={"name": "mine", "version": "1.0.0"})) == ""
