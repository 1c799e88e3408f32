"""--junit of single acts, as CI reads it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from tests.conftest import Tworelay

ACTS = {
    "identify": (("identify", "virtual://bench"), 0, None),
    "rejected": (("identify", "virtual://bench?coulomb=2.5"), 6, "failure"),
    "refused": (("identify", "virtual://bench", "--travel", "1e-6"), 3, "error"),
    "unreachable": (("identify", "modbus-tcp://127.0.0.1:9"), 4, "error"),
    "usage": (("identify", "bench"), 2, "error"),
    "no such run": (("apply", "nosuch"), 2, "error"),
}


def case_of(path: Path) -> ET.Element:
    (case,) = ET.parse(path).getroot().iter("testcase")
    return case


@pytest.mark.parametrize("name", ACTS)
def test_what_became_of_an_act(name: str, tworelay: Tworelay, tmp_path: Path) -> None:
    words, code, kind = ACTS[name]
    file = tmp_path / "act.xml"
    done = tworelay(*words, "--yes", "--junit", str(file))
    assert done.returncode == code, done.stderr
    case = case_of(file)
    assert case.get("classname") == "tworelay"
    assert [child.tag for child in case if child.tag in ("failure", "error", "skipped")] == (
        [kind] if kind else []
    )
    if kind:
        message = next(child for child in case if child.tag == kind).get("message")
        assert message is not None
        assert done.stderr.strip().endswith(message.strip())
    else:
        numbers = {p.get("name"): float(p.get("value") or 0) for p in case.iter("property")}
        assert numbers["coulomb [N.m]"] == pytest.approx(0.1, rel=0.01)
        assert numbers["coulomb_low [N.m]"] < 0.1 < numbers["coulomb_high [N.m]"]
        said = case.findtext("system-out") or ""
        told = re.search(r"coulomb ([0-9.]+) N\.m", said)
        assert told is not None
        assert float(told[1]) == pytest.approx(numbers["coulomb [N.m]"], rel=1e-3)
        assert "axis at rest and off" in said
        assert case.get("name") == "bench: identify"


def test_each_act_on_a_run_has_one(tworelay: Tworelay, tmp_path: Path) -> None:
    axis = tmp_path / "press.toml"
    axis.write_text('link = "virtual://bench"\nprofile = "virtual-modbus"\ntravel = 3\ngroup = "g"')
    for words in (
        ("commission", str(axis), "--yes"), ("tune", "last"), ("apply", "last", "--yes"),
        ("verify", "last", "--yes"),
    ):  # fmt: skip
        file = tmp_path / f"{words[0]}.xml"
        done = tworelay(*words, "--junit", str(file))
        case = case_of(file)
        assert case.get("name") == f"press: {words[0]}", done.stderr
        assert done.returncode == 0, done.stderr
        assert not case.findall("error")
    commissioned = case_of(tmp_path / "commission.xml")
    assert commissioned.get("classname") == "tworelay.g"
    names = {p.get("name") for p in commissioned.iter("property")}
    assert "less_error [%]" in names


def test_a_file_that_cannot_be_written_is_seen_before(tworelay: Tworelay, tmp_path: Path) -> None:
    done = tworelay("identify", "virtual://bench", "--yes", "--junit", str(tmp_path / "a" / "b"))
    assert done.returncode == 2
    assert "--junit" in done.stderr
    assert not (tmp_path / "home" / "runs").exists()


def test_no_old_file_stays_when_the_command_was_not_understood(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    file = tmp_path / "act.xml"
    assert tworelay("identify", "virtual://bench", "--yes", "--junit", str(file)).returncode == 0
    for junit in (("--junit", str(file)), (f"--junit={file}",)):
        done = tworelay("identify", "virtual://bench", "--travl", "3", *junit)
        assert done.returncode == 2
        message = case_of(file).find("error").get("message")  # type: ignore[union-attr]
        assert message is not None
        assert "--travl" in message
        file.write_text("old")


def test_a_dry_run_is_skipped_and_standard_output_is_no_file(
    tworelay: Tworelay, tmp_path: Path
) -> None:
    file = tmp_path / "act.xml"
    tworelay("identify", "virtual://bench", "--dry-run", "--junit", str(file))
    assert case_of(file).find("skipped") is not None
    done = tworelay("identify", "virtual://bench", "--yes", "--junit", "-")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


@pytest.mark.parametrize(
    "words",
    [
        ("fleet", "run", "nofleet.toml"), ("fleet", "run", "examples/bench.toml"),
        ("identify", "nofile.toml", "--yes"),
    ],
)  # fmt: skip
def test_no_old_file_stays_when_nothing_was_begun(
    words: tuple[str, ...], tworelay: Tworelay, tmp_path: Path
) -> None:
    file = tmp_path / "act.xml"
    file.write_text("old")
    done = tworelay(*words, "--junit", str(file))
    assert done.returncode == 2
    assert case_of(file).find("error") is not None


def test_a_fleet_that_is_refused_keeps_a_case_an_axis(tworelay: Tworelay, tmp_path: Path) -> None:
    file = tmp_path / "fleet.xml"
    done = tworelay("fleet", "run", "examples/press-line-7.toml", "--junit", str(file))
    assert done.returncode == 3, done.stderr
    cases = [one.get("name") for one in ET.parse(file).getroot().iter("testcase")]
    assert cases == ["gantry-left: identify", "gantry-right: identify", "table: identify"]


def test_a_command_without_the_option_writes_no_file(tworelay: Tworelay, tmp_path: Path) -> None:
    file = tmp_path / "act.xml"
    assert tworelay("history", "list", "--junit", str(file)).returncode == 2
    assert not file.exists()
