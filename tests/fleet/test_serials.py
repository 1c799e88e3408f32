"""A drive belongs to its axis: what is exchanged, new or nameless is said, and not moved."""

from __future__ import annotations

from pathlib import Path

import pytest

from commissioning.fleet.serials import Pins, misplaced
from profiles.errors import UsageError
from tests.raising import raises

A, B, C = "0x0000000A", "0x0000000B", "0x0000000C"


@pytest.mark.parametrize(
    ("found", "pinned", "wrong"),
    [
        ({"x": A, "y": B}, {}, {}),
        ({"x": A, "y": B}, {"x": A, "y": B}, {}),
        ({"x": B, "y": A}, {"x": A, "y": B}, {"x": "exchanged", "y": "exchanged"}),
        ({"x": B}, {"x": A, "y": B}, {"x": "the drive of 'y'"}),
        ({"x": B, "y": B}, {"x": A, "y": B}, {"x": "the drive of 'y'", "y": "are one drive"}),
        ({"x": C, "y": B}, {"x": A, "y": B}, {"x": "--accept-serial x"}),
        ({"x": A, "y": A}, {}, {"x": "are one drive", "y": "are one drive"}),
        ({"new": A}, {"x": A}, {"new": "the drive of 'x'"}),
        ({"x": ""}, {}, {"x": 'serial = "none"'}),
        ({"x": "0x00000000"}, {}, {"x": 'serial = "none"'}),
        ({"x": ""}, {"x": "none"}, {}),
        ({"x": ""}, {"x": A}, {"x": f"was {A}"}),
        ({"x": "", "y": ""}, {"x": "none", "y": "none"}, {}),
    ],
)
def test_each_drive_is_held_to_its_axis(
    found: dict[str, str], pinned: dict[str, str], wrong: dict[str, str]
) -> None:
    said = misplaced(found, pinned)
    assert set(said) == set(wrong)
    for name, part in wrong.items():
        assert part in str(said[name])
        assert said[name].exit_code == 3


def test_pins_lie_beside_the_fleet_file(tmp_path: Path) -> None:
    pins = Pins(tmp_path / "line.toml")
    pins.pin({'x "1"': A, "y\n": B})
    assert Pins(tmp_path / "line.toml").known == {'x "1"': A, "y\n": B}
    assert (tmp_path / "line.serials.toml").exists()


def test_pins_that_cannot_be_written_stop_the_run(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    pins = Pins(folder / "line.toml")
    folder.rmdir()
    with raises(Exception, "refused.pins"):
        pins.pin({"x": A})


@pytest.mark.parametrize("text", ["serials = 3", "[serials]\nx = 7", "not toml"])
def test_a_damaged_file_of_pins_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / "line.serials.toml").write_text(text)
    with pytest.raises(UsageError, match=r"serials\.toml"):
        Pins(tmp_path / "line.toml")


def test_a_rehearsal_pins_nothing(tmp_path: Path) -> None:
    pins = Pins(tmp_path / "line.toml", kept=False)
    pins.pin({"x": A})
    assert not (tmp_path / "line.serials.toml").exists()
