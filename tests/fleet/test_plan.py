"""A fleet file is in order, or is refused in one line before anything is done."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from commissioning.cli.fleet.demo import demo_file
from commissioning.fleet.loading import load_fleet
from commissioning.fleet.plan import Fleet, differences
from commissioning.fleet.taking_up import chosen
from commissioning.fleet.twins import twins_of
from commissioning.journal import Journal
from commissioning.records import RunContext
from commissioning.result.found import Quantity
from commissioning.runs import RunFolder
from drivers.home import home
from profiles.axis import Axis
from profiles.errors import TwoRelayError, UsageError
from tests.command import in_this_process
from tests.result.test_codec import recorded

AXIS = '[[axes]]\nname = "{0}"\nlink = "virtual://bench?seed={1}"\n'
NAMED = '[[axes]]\nname = "x"\ngateway = "pc-a"\n'
TWO = AXIS.format("a", 1) + AXIS.format("b", 2)
HEAD = 'job = "identify"\nconfirm = "yes"\n'


def fleet(folder: Path, text: str, head: str = HEAD) -> Fleet:
    path = folder / "line.toml"
    path.write_text(head + text, "utf-8")
    return load_fleet(path)


BAD = {
    "unknown key": ('jobb = "x"\n' + TWO, "jobb", "did you mean 'job'"),
    "unknown key of an axis": (TWO + "travle = 1.0\n", "travle", "did you mean 'travel'"),
    "unknown key of a section": (TWO + "limits = { sped = 1.0 }\n", "sped", "speed"),
    "unknown default": ("[defaults]\nfracton = 0.5\n" + TWO, "fracton", "fraction"),
    "no axes": ("", "axes", ""),
    "an axis twice": (AXIS.format("a", 1) + AXIS.format("a", 2), "'a' is named twice", ""),
    "twice, but for its capitals": (AXIS.format("a", 1) + AXIS.format("A", 2), "twice", ""),
    "one drive": (AXIS.format("a", 1) + AXIS.format("b", 1), "'a' and 'b' are one drive", ""),
    "a circle": (
        AXIS.format("a", 1) + 'after = ["c"]\n' + AXIS.format("b", 2) + 'after = ["a"]\n'
        + AXIS.format("c", 3) + 'after = ["b"]\n', "circle", "a after c after b after a",
    ),
    "after itself": (AXIS.format("a", 1) + 'after = ["a"]\n', "circle", "a after a"),
    "after nobody": (TWO + 'after = ["aa"]\n', "'aa'", "did you mean 'a'"),
    "undeclared group": (TWO + 'group = "gantry"\n', "'gantry' is declared nowhere", "[groups."),
    "undeclared zone": (TWO + 'zone = "cell"\n', "'cell' is declared nowhere", "[zones."),
    "zone of a group": (
        '[zones.z]\n[zones.y]\n[groups.g]\nzone = "z"\n' + TWO + 'group = "g"\nzone = "y"\n',
        "zone 'y'", "zone 'z'",
    ),
    "a glob without a match": ('[[axes]]\nfile = "axes/*.toml"\n', "no file matches", ""),
    "a glob with a serial": (
        '[[axes]]\nfile = "axes/*.toml"\nserial = "0x1"\n', "several axes", "serial",
    ),
    "a glob with a name": ('[[axes]]\nfile = "*.toml"\nname = "x"\n', "several axes", "name"),
    "neither file nor link": ('[[axes]]\nname = "x"\n', "needs a file, or a link", ""),
    "a link without a name": ('[[axes]]\nlink = "virtual://bench"\n', "needs a name", ""),
    "no such gateway": (NAMED, "pc-a", ""),
    "described here, and by a gateway": (TWO + 'gateway = "pc-a"\n', "link", ""),
    "two baud rates": (
        ('[[axes]]\nname = "a"\nlink = "modbus-rtu:///dev/ttyUSB0?unit=1&baudrate=9600"\n'
        '[[axes]]\nname = "b"\nlink = "modbus-rtu:///dev/../dev/ttyUSB0?unit=2&baudrate=19200"\n'),
        "one bus", "baudrate=9600 and baudrate=19200",
    ),
    "a unit in two spellings": (
        ('[[axes]]\nname = "a"\nlink = "modbus-tcp://127.0.0.1:502?unit=1"\n'
        '[[axes]]\nname = "b"\nlink = "modbus-tcp://localhost?unit=1"\n'), "one drive", "",
    ),
    "a group without a name": ('[groups.""]\n' + TWO + 'group = ""\n', "must not be empty", ""),
    "rad and m": (
        "[defaults]\nmax_speed = 1.0\n" + TWO + '[[axes]]\nname = "l"\nlink = "virtual://emps"\n',
        "rad or N.m for 'b', and in m or N for 'l'", "speed",
    ),
    "a link that is none": (
        TWO + '[[axes]]\nname = "c"\nlink = "virtal://x"\n', "number 3 (c)", "no link",
    ),
    "an option that is none": (AXIS.format("a", 1).replace("seed", "sed"), "number 1 (a)", "sed"),
    "no number of repeats": (TWO + "repeat = 0\n", "repeat", "greater than or equal to 1"),
    "no method": (TWO + 'method = "magic"\n', "method", "auto"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_what_is_wrong_is_said_in_one_line(kind: str, tmp_path: Path) -> None:
    text, *said = BAD[kind]
    (tmp_path / "line.toml").write_text(HEAD + text, "utf-8")
    done = in_this_process("fleet", "run", str(tmp_path / "line.toml"))
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    for part in said:
        assert part in done.stderr


def test_links_in_two_spellings_are_one_bus(tmp_path: Path) -> None:
    found = fleet(
        tmp_path,
        '[[axes]]\nname = "a"\nlink = "modbus-tcp://127.0.0.1:502?unit=1"\n'
        '[[axes]]\nname = "b"\nlink = "modbus-tcp://localhost?unit=2"\n'
        '[[axes]]\nname = "c"\nlink = "modbus-rtu-tcp://127.0.0.1:0502?unit=3"\n'
        '[[axes]]\nname = "d"\nlink = "modbus-tcp://127.0.0.1:503?unit=1"\n',
    )
    a, b, c, d = (one.bus for one in found.axes)
    assert a == b == c
    assert a != d


def test_who_says_more_closely_is_right(tmp_path: Path) -> None:
    """[[axes]] above the axis file above [defaults], section by section."""
    (tmp_path / "x.toml").write_text(
        'link = "virtual://bench"\ntravel = 2.0\ncycle = 0.002\n'
        "[limits]\ntorque = 0.5\nspeed = 9.0\n"
    )
    found = fleet(
        tmp_path,
        "[defaults]\ntravel = 1.0\ncycle = 0.001\nfraction = 0.7\nrepeat = 3\n"
        "[defaults.limits]\nspeed = 5.0\nduration = 60.0\n"
        '[[axes]]\nfile = "x.toml"\ncycle = 0.004\nrepeat = 2\nlimits = { torque = 0.4 }\n',
    )
    (one,) = found.axes
    assert one.axis is not None
    assert (one.name, one.axis.travel, one.axis.cycle) == ("x", 2.0, 0.004)
    assert (one.options.fraction, one.options.repeat) == (0.7, 2)
    limits = one.axis.limits
    assert (limits.torque, limits.speed, limits.duration) == (0.4, 9.0, 60.0)


@pytest.mark.parametrize(
    ("file", "entry", "default", "torque"),
    [
        ("[limits]\ntorque = 0.3\n", "", "max_torque = 1.0\n", 0.3),
        ("[limits]\ntorque = 0.3\n", "max_torque = 0.2\n", "", 0.2),
        ("", "limits = { torque = 0.2 }\n", "max_torque = 1.0\n", 0.2),
        ("", "", "max_torque = 1.0\n", 1.0),
    ],
)
def test_a_limit_is_one_by_whichever_name(
    file: str, entry: str, default: str, torque: float, tmp_path: Path
) -> None:
    """`max_torque` of a job and `limits.torque` of an axis are one quantity."""
    (tmp_path / "x.toml").write_text('link = "virtual://bench"\n' + file)
    found = fleet(tmp_path, f'[defaults]\n{default}[[axes]]\nfile = "x.toml"\n{entry}')
    (one,) = found.axes
    assert one.axis is not None
    assert one.axis.limits.torque == torque
    assert one.options.max_torque is None


def test_a_thousand_axes_one_after_the_other(tmp_path: Path) -> None:
    text = AXIS.format("a0", 0)
    for n in range(1, 1000):
        text += AXIS.format(f"a{n}", n) + f'after = ["a{n - 1}"]\n'
    assert len(fleet(tmp_path, text).axes) == 1000


def test_groups_of_file_and_entry_agree(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text('link = "virtual://bench"\ngroup = "g"\n')
    entry = '[groups.g]\n[groups.h]\n[[axes]]\nfile = "x.toml"\n'
    assert fleet(tmp_path, entry).axes[0].group == "g"
    with pytest.raises(UsageError, match=r"group is 'h', and 'g' in"):
        fleet(tmp_path, entry + 'group = "h"\n')


def test_a_glob_is_sorted_and_named_by_its_files(tmp_path: Path) -> None:
    for name in ("c", "a", "b"):
        (tmp_path / f"{name}.axis.toml").write_text(f'link = "virtual://bench?seed={ord(name)}"\n')
    found = fleet(tmp_path, '[[axes]]\nfile = "*.axis.toml"\ntravel = 1.5\n')
    assert [one.name for one in found.axes] == ["a.axis", "b.axis", "c.axis"]
    assert {one.axis and one.axis.travel for one in found.axes} == {1.5}


def test_a_broken_axis_file_is_that_axis_alone(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text("link = 3\n")
    found = fleet(tmp_path, TWO + '[[axes]]\nfile = "x.toml"\n')
    broken = [one for one in found.axes if one.broken is not None]
    assert [one.name for one in broken] == ["x"]
    assert "x.toml" in str(broken[0].broken)


@pytest.mark.parametrize(
    ("only", "names"),
    [
        ("a", "a"), ("a,c", "ac"), ("?", "abc"), ("!b", "ac"), ("group=g", "bc"),
        ("group=g,!c", "b"), ("zone=z", "a"), ("[bc]", "bc"),
    ],
)  # fmt: skip
def test_only_names_globs_groups_and_zones(only: str, names: str, tmp_path: Path) -> None:
    found = fleet(
        tmp_path,
        "[groups.g]\n[zones.z]\n" + AXIS.format("a", 1) + 'zone = "z"\n'
        + "".join(AXIS.format(name, n) + 'group = "g"\n' for n, name in ((2, "b"), (3, "c"))),
    )  # fmt: skip
    assert "".join(chosen(found, only)) == names


@pytest.mark.parametrize("only", ["", " , ", "d", "group=h", "zone=y", "a,!a", "!d"])
def test_only_what_is_there(only: str, tmp_path: Path) -> None:
    with pytest.raises(TwoRelayError):
        chosen(fleet(tmp_path, TWO), only)


def test_what_has_changed_is_named() -> None:
    old = {"axes": {"a": {"travel": 1.0, "link": "x"}, "b": {}}, "job": "identify"}
    new = {"axes": {"a": {"travel": 2.0, "link": "x"}, "c": {}}, "job": "identify"}
    assert list(differences(old, new)) == [
        "axes.a.travel is 2.0, was 1.0",
        "axes.b is gone",
        "axes.c is new",
    ]


def test_the_demo_s_fleet_is_of_eight_axes_on_five_buses(tmp_path: Path) -> None:
    """`make demo-fleet` runs it, in half a minute; here it is read, and its twins are made."""
    path = tmp_path / "demo.toml"
    path.write_text(demo_file({}), "utf-8")
    found = load_fleet(path)
    twins = twins_of(found, tmp_path)
    assert len(found.axes) == len(twins.names) == 8
    assert [len(bus.drives) for bus in twins.buses] == [2, 2, 2, 1, 1]
    assert twins.names == [one.name for one in found.axes]
    served = {one.name: f"modbus-tcp://127.0.0.1:{5000 + n}" for n, one in enumerate(found.axes)}
    path.write_text(demo_file(served), "utf-8")
    assert {one.link for one in load_fleet(path).axes} == set(served.values())


def test_the_twin_of_an_axis_that_was_measured_is_what_was_measured(tmp_path: Path) -> None:
    """Its last run that can be trusted, on the drive that the file wants, with the same gear."""
    result = replace(recorded("good")[0], axis="x")
    with Journal(home()) as journal:
        for serial in ("0x1", "0x2"):
            run = journal.begin(
                axis="x", link="modbus-tcp://127.0.0.1:502", profile="virtual-modbus",
                profile_hash="h", serial=serial,
                context=RunContext(Axis(name="x").model_dump_json()),
            )  # fmt: skip
            f = Quantity(0.1 * int(serial, 16), None, None, "N.m")
            friction = replace(result.friction, coulomb=f)
            RunFolder.of(journal, run).save(replace(result, run=run, friction=friction))

    def coulomb(more: str) -> float:
        path = tmp_path / "fleet.toml"
        path.write_text(
            'job = "identify"\nconfirm = "yes"\n[[axes]]\nname = "x"\ntravel = 1\n'
            f'link = "modbus-tcp://127.0.0.1:502"\n{more}'
        )
        (bus,) = twins_of(load_fleet(path), tmp_path).buses
        return bus.drives[0].axis.coulomb

    assert coulomb("") == pytest.approx(0.2)
    assert coulomb('serial = "0x1"') == pytest.approx(0.1)
    assert coulomb('twin = "bench?coulomb=0.4"') == 0.4
    assert coulomb("mechanics = { gear = 5.0 }") != pytest.approx(0.2), "it is another axis now"
