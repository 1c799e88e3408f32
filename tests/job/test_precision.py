"""How long a measurement is: as long as the interval that was asked for needs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.conftest import Tworelay


def test_the_interval_ends_the_measurement_and_the_report_shows_it(tworelay: Tworelay) -> None:
    done = tworelay("identify", "virtual://bench?encoder=2000", "--yes", "--json", "-")
    result = json.loads(done.stdout)
    assert result["experiment"]["periods"] == 4
    reading = result["methods"]["output-error"]
    assert len(reading["progress"]) == 3
    assert reading["progress"][-1]["periods"] == pytest.approx(reading["periods"], abs=0.2)
    lag = result["friction"]["lag"]
    assert lag["low"] <= 0 <= lag["value"] <= lag["high"] < 2e-3
    page = Path(tworelay("report", "last").stdout.strip()).read_text("utf-8")
    assert "What fewer periods would have given" in page
    assert "half of the interval in %" in page
    assert "Output error:" in page
    assert "of it a lag of the torque" in page


@pytest.mark.parametrize("asked", ["0", "0%", "-1%", "101%", "nan", "a bit", ""])
def test_a_precision_that_is_none_is_refused_in_one_line(tworelay: Tworelay, asked: str) -> None:
    done = tworelay("identify", "virtual://bench", "--precision", asked, "--yes")
    assert done.returncode == 2
    assert "--precision" in done.stderr
    assert "as in '1%'" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_method_by_name_gives_no_number_that_it_cannot_explain(tworelay: Tworelay) -> None:
    link = "virtual://bench?breakaway=0.15&stribeck=2"
    done = tworelay("identify", link, "--method", "output-error", "--yes", "--json", "-")
    assert done.returncode == 6
    assert "--method auto" in done.stderr
    result = json.loads(done.stdout)
    codes = {reason["code"]: reason["weight"] for reason in result["quality"]["reasons"]}
    assert codes["positions.unexplained"] == "contradiction"
    assert result["friction"]["coulomb"]["value"] is None
    assert result["methods"]["output-error"]["explained"] is False


def test_more_periods_than_the_duration_allows_are_not_run(tworelay: Tworelay) -> None:
    asked = ("--precision", "0.001%", "--duration", "3.2", "--yes", "--json", "-")
    done = tworelay("identify", "virtual://bench", *asked)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["experiment"]["periods"] == 4
    assert [r["code"] for r in result["quality"]["reasons"]] == ["interval.asked"]


def test_a_curve_that_looks_like_drag_is_not_good(tworelay: Tworelay) -> None:
    """Friction falls by a quarter within 50 mrad/s, behind an encoder that hardly shows it."""
    link = "virtual://bench?breakaway=0.13&stribeck=0.05&encoder=3000"
    result = json.loads(tworelay("identify", link, "--yes", "--json", "-").stdout)
    coulomb = result["friction"]["coulomb"]
    assert coulomb["low"] <= 0.1 <= coulomb["high"]
    assert result["friction"]["method"] == "modulating"
    assert "law.bends" in [r["code"] for r in result["quality"]["reasons"]]
