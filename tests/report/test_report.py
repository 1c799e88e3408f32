"""The report on paper and in two languages; what comes of long columns."""

from __future__ import annotations

import json
import re
import string
from pathlib import Path

import numpy as np
import pytest

from commissioning.report.reduced import reduced
from commissioning.result import words
from commissioning.result.german import GERMAN
from commissioning.result.language import digits, said, speaking, usual
from tests.command import ROOT
from tests.conftest import Tworelay

PACKAGE = ROOT / "commissioning"
GOOD = ("commission", "virtual://bench", "--yes")


def test_whatever_the_page_says_of_itself_is_translated() -> None:
    page = (PACKAGE / "report" / "report.html.j2").read_text("utf-8")
    asked = set(re.findall(r"""_\((?:"([^"]+)"|'([^']+)')\)""", page))
    code = "".join(path.read_text("utf-8") for path in (PACKAGE / "report").glob("*.py"))
    asked |= set(re.findall(r"""said\((?:"([^"]+)"|'([^']+)')\)""", code))
    texts = {a or b for a, b in asked}
    assert len(texts) > 50
    assert texts - GERMAN.keys() == set()


def test_a_translation_says_the_same_numbers_and_names() -> None:
    for text, german in GERMAN.items():
        fields = {name for _, name, _, _ in string.Formatter().parse(text) if name}
        assert {name for _, name, _, _ in string.Formatter().parse(german) if name} == fields
        for command in re.findall(r"'tworelay [^']*'", text):
            assert command in german


@pytest.mark.parametrize(
    ("text", "german"),
    [
        ("0.25 N·m", "0,25 N·m"), ("1.5 … 2.5", "1,5 … 2,5"), ("run 0.1.0", "run 0.1.0"),
        ("no number", "no number"), ("12 %", "12 %"),
    ],
)  # fmt: skip
def test_the_decimal_sign_is_that_of_the_language(text: str, german: str) -> None:
    assert digits(text) == text
    with speaking("de"):
        assert digits(text) == german
        assert said("good") == "gut"
        assert said("something else") == "something else"
    assert said("good") == "good"


@pytest.mark.parametrize(
    ("variables", "name"),
    [
        ({"LANG": "de_DE.UTF-8"}, "de"), ({"LANG": "fr_FR.UTF-8"}, "en"), ({}, "en"),
        ({"LANG": "de_AT.UTF-8", "LC_ALL": "C"}, "en"),
        ({"LANG": "en_GB", "TWORELAY_LANGUAGE": "de"}, "de"),
    ],
)  # fmt: skip
def test_the_language_of_this_computer(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], name: str
) -> None:
    for other in ("TWORELAY_LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"):
        monkeypatch.delenv(other, raising=False)
    for key, value in variables.items():
        monkeypatch.setenv(key, value)
    assert usual() == name


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (2.086e-8, -0.00014, 0.00014, "0 ± 0.00014 N·m"),
        (0.09999, 0.09992, 0.10006, "0.099990 ± 0.000070 N·m"),
        (20.83, 20.5, 21.16, "20.83 ± 0.33 N·m"), (2.59, 2.43, 3.1, "2.59 (2.43 … 3.10) N·m"),
        (2.2e-6, 2.1e-6, 2.3e-6, "(2.20 ± 0.10)·10⁻⁶ N·m"), (1.5, None, None, "1.5 N·m"),
        (512.0, 462.0, 562.0, "512 ± 50 N·m"),
    ],
)  # fmt: skip
def test_digits_follow_the_interval(
    value: float, low: float | None, high: float | None, text: str
) -> None:
    assert words.uncertain(value, low, high, "N·m") == text


def test_long_columns_keep_their_extremes() -> None:
    rng = np.random.default_rng(1)
    time, column = np.arange(100_000) / 1000, rng.standard_normal(100_000)
    column[54_321], column[77_777] = 50.0, -60.0
    times, (found,) = reduced(time, [column], 2000)
    assert len(times) == len(found) == 2000
    assert (found.max(), found.min()) == (50.0, -60.0)
    assert np.all(np.diff(times) >= 0)
    assert abs(times[np.argmax(found)] - 54.321) < 0.2
    same, (untouched,) = reduced(time[:10], [column[:10]], 2000)
    assert len(same) == len(untouched) == 10


def test_a_report_in_german_has_german_numbers(
    tworelay: Tworelay, after: Tworelay, tmp_path: Path
) -> None:
    assert after(*GOOD).returncode == 0
    done = tworelay("report", "last", "--language", "de", "--output", "-")
    assert done.returncode == 0, done.stderr
    text = done.stdout
    assert '<html lang="de">' in text
    for told in ("Verbesserung", "weniger Fehler nach Umkehr", "Achse in Ruhe und aus", "0,085"):
        assert told in text
    result = json.loads(
        (Path(tworelay("report", "last").stdout.strip()).parent / "run.json").read_text()
    )
    assert isinstance(result["friction"]["coulomb"]["value"], float)


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_a_pdf_needs_no_browser(
    tworelay: Tworelay, after: Tworelay, tmp_path: Path, paper: str
) -> None:
    assert after(*GOOD).returncode == 0
    path = tmp_path / "r.pdf"
    done = tworelay("report", "last", "--pdf", str(path), "--paper", paper, "--language", "de")
    assert done.returncode == 0, done.stderr
    data = path.read_bytes()
    assert data.startswith(b"%PDF-")
    size = re.search(rb"/MediaBox \[0 0 ([0-9.]+) ([0-9.]+)\]", data)
    assert size is not None
    wide = {"a4": 210 / 25.4 * 72, "letter": 8.5 * 72}[paper]
    assert float(size[1]) == pytest.approx(wide, abs=0.5)
    assert 2 <= data.count(b"/Type /Page\n") <= 4


def test_a_run_that_failed_has_paper_too(tworelay: Tworelay, tmp_path: Path) -> None:
    assert tworelay("identify", "virtual://bench?coulomb=1.5", "--yes").returncode == 6
    done = tworelay("report", "last", "--output", str(tmp_path / "r.pdf"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "r.pdf").read_bytes().startswith(b"%PDF-")


@pytest.mark.parametrize(
    "arguments", [("--output", "r.docx"), ("--pdf", "r.html"), ("--output", "r")]
)
def test_an_ending_that_is_not_ours_is_refused(
    tworelay: Tworelay, after: Tworelay, arguments: tuple[str, str]
) -> None:
    assert after(*GOOD).returncode == 0
    done = tworelay("report", "last", *arguments)
    assert done.returncode == 2
    assert "ends with" in done.stderr
