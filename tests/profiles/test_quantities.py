"""Numbers with units: values from the definitions of the units, not from the code."""

from __future__ import annotations

import math
from pathlib import Path

import click
import pytest

from commissioning.cli.quantity import PER_CENT, POSITION, SHARE, SPEED, Measure
from profiles.axis import load_axis
from profiles.errors import ProfileError
from profiles.quantities import parse, unit_named
from tests.raising import raises


@pytest.mark.parametrize(
    ("text", "si", "kind"),
    [
        ("180 deg", math.pi, "position"), ("180°", math.pi, "position"),
        ("0,5 rev", math.pi, "position"), ("20mm", 0.02, "position"), ("-3 µm", -3e-6, "position"),
        ("3000 rpm", 100 * math.pi, "velocity"), ("3000 1/min", 100 * math.pi, "velocity"),
        ("60 m/min", 1.0, "velocity"), ("4ms", 0.004, "time"), ("2 min", 120.0, "time"),
        ("1,5 N·m", 1.5, "torque"), ("1.5 Nm", 1.5, "torque"), ("250 mNm", 0.25, "torque"),
        ("85 %", 0.85, "share"), ("5 ‰", 0.005, "share"), ("10 Hz", 20 * math.pi, "frequency"),
        ("100 mA", 0.1, "current"), ("1e-3 m", 0.001, "position"),
    ],
)  # fmt: skip
def test_units_of_the_shop_floor(text: str, si: float, kind: str) -> None:
    found = parse(text)
    assert found.si == pytest.approx(si, rel=1e-12)
    assert found.unit is not None
    assert found.unit.kind == kind


def test_a_number_alone_has_no_unit() -> None:
    assert parse("0,25").unit is None
    assert parse("0,25").si == 0.25


@pytest.mark.parametrize("text", ["", "deg", "1.000,5", "1 parsec", "nan", "inf", "1 2", "0x10"])
def test_what_is_no_quantity(text: str) -> None:
    with pytest.raises(ValueError, match=r"is no (number|unit)"):
        parse(text)


def test_milli_is_not_mega() -> None:
    assert unit_named("MNm") is None
    assert unit_named("Ms") is None
    assert unit_named("NM") is None, "nanometres, or newton metres"
    assert unit_named("MM/S") is None
    assert unit_named("RPM") is not None


@pytest.mark.parametrize(
    ("kind", "text", "words"),
    [
        (POSITION, "3 rpm", "it takes rad, mrad, deg"), (SPEED, "-3 rpm", "not in the range"),
        (SHARE, "120 %", "not in the range"), (POSITION, "100 counts", "is in counts"),
        (Measure("time", low=0.1, high=1), "5 s", "0.1<=x<=1"),
    ],
)  # fmt: skip
def test_options_say_what_they_take(kind: Measure, text: str, words: str) -> None:
    with pytest.raises(click.BadParameter, match=words):
        kind.convert(text, None, None)


def test_per_cent_is_said_with_its_sign_or_without() -> None:
    assert PER_CENT.convert("12 %", None, None) == PER_CENT.convert("12", None, None) == 12.0


def axis(path: Path, text: str) -> Path:
    path.write_text(text, "utf-8")
    return path


def test_an_axis_file_has_units_too(tmp_path: Path) -> None:
    text = (
        'travel = "±90 deg"\ncycle = "4 ms"\nrated_torque = "1270 mNm"\n[limits]\n'
        'speed = "300 rpm"\ntorque = "0,5 Nm"\nends = ["-180 deg", "180 deg"]\nduration = "2 min"\n'
    )
    found = load_axis(axis(tmp_path / "a.toml", text))
    assert found.travel == pytest.approx(math.pi / 2)
    assert found.cycle == 0.004
    assert found.rated_torque == pytest.approx(1.27)
    assert found.limits.speed == pytest.approx(10 * math.pi)
    assert found.limits.torque == 0.5
    assert found.limits.ends == pytest.approx((-math.pi, math.pi))
    assert found.limits.duration == 120.0


def test_a_linear_axis_is_in_millimetres(tmp_path: Path) -> None:
    text = 'travel = "50 mm"\n[mechanics]\nmotion = "linear"\nfeed = "10 mm"\n'
    found = load_axis(axis(tmp_path / "a.toml", text))
    assert (found.travel, found.mechanics.feed) == (0.05, 0.01)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('travel = "50 mm"', "the axis is rotary"), ('travel = "5"', "give it a unit"),
        ('travel = "5 s"', "give it a unit"), ('cycle = "soon"', "is no number"),
        ('travel = "5 deg"\n[mechanics]\nmotion = "linear"\nfeed = 0.01', "the axis is linear"),
    ],
)  # fmt: skip
def test_units_of_the_other_kind_are_told(tmp_path: Path, text: str, words: str) -> None:
    with raises(ProfileError, "usage.profile") as caught:
        load_axis(axis(tmp_path / "a.toml", text))
    assert words in str(caught.value)
