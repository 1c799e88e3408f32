"""tworelay analyze: recordings of any tool, good and spoiled."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from tests.command import ROOT
from tests.conftest import Tworelay
from tests.identification.spoiled import relay_tests

SCHEMA = json.loads((ROOT / "docs" / "run.schema.json").read_text("utf-8"))
HEADER = ["time_s", "position_rad", "torque_Nm"]


@pytest.fixture(scope="module")
def rows() -> list[list[float]]:
    record = relay_tests()
    return [
        [float(t), float(y), float(u)]
        for t, y, u in zip(record.time, record.position, record.command, strict=True)
    ]


def written(path: Path, header: list[str], rows: list[list[Any]], delimiter: str = ",") -> str:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(header)
        writer.writerows(rows)
    return str(path)


def test_a_csv_with_the_default_header(
    tworelay: Tworelay, tmp_path: Path, rows: list[list[float]]
) -> None:
    done = tworelay("analyze", written(tmp_path / "axis.csv", HEADER, rows), "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    jsonschema.validate(result, SCHEMA)
    assert result["status"] == "completed"
    assert result["axis"] == "axis"
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    assert result["friction"]["dead_time"]["value"] == pytest.approx(0.002, abs=2e-4)
    text = tworelay("analyze", str(tmp_path / "axis.csv"))
    assert "Coulomb friction" in text.stdout
    assert "good" in text.stdout


def test_a_proposal_for_a_drive_that_is_not_there_keeps_the_analysis(
    tworelay: Tworelay, tmp_path: Path, rows: list[list[float]]
) -> None:
    file, target = written(tmp_path / "axis.csv", HEADER, rows), tmp_path / "run.json"
    done = tworelay("analyze", file, "--for", "modbus-tcp://127.0.0.1:1", "--json", str(target))
    assert done.returncode == 4
    result = json.loads(target.read_text())
    jsonschema.validate(result, SCHEMA)
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    assert (result["status"], result["error"]["code"]) == ("failed", "link.connect")
    assert result["ending"] == {
        "axis": "not moved", "settings": None, "drive": None, "said_by": "the link",
    }  # fmt: skip


def test_units_columns_preamble_and_decimal_commas(
    tworelay: Tworelay, tmp_path: Path, rows: list[list[float]]
) -> None:
    path = tmp_path / "scope.csv"
    lines = ["Drive;ACME 9000", "Sampling period;1.000", "", "Zeit;Lage;Strom", "ms;deg;%"]
    lines += [
        f"{1000 * t:.3f};{math.degrees(y):.6f};{u / 0.005:.3f}".replace(".", ",")
        for t, y, u in rows
    ]
    path.write_text("\n".join(lines), "utf-8")
    done = tworelay("analyze", str(path), "--torque", "Strom:0.005 Nm", "--json", "-")
    assert done.returncode == 0, done.stderr
    friction = json.loads(done.stdout)["friction"]
    assert friction["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)
    assert friction["inertia"]["value"] == pytest.approx(1e-3, rel=0.01)


def test_an_exported_run_is_a_recording_like_any_other(tworelay: Tworelay, tmp_path: Path) -> None:
    measured = tworelay(
        "identify", "virtual://bench", "--method", "lock-in", "--yes", "--json", "-"
    )
    value = json.loads(measured.stdout)["friction"]["coulomb"]["value"]
    assert tworelay("export", "last", str(tmp_path / "run")).returncode == 0
    with (tmp_path / "run" / "samples.csv").open(encoding="utf-8") as file:
        samples = list(csv.reader(file))
    # the oscillations are the last part: the approach and the first look are no oscillation
    part = [list(map(float, row)) for row in samples[1:]]
    begin = part[-1][0] - 2.8
    path = written(tmp_path / "part.csv", samples[0], [row for row in part if row[0] > begin])
    done = tworelay("analyze", path, "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert set(result["methods"]) == {"lock-in", "modulating"}, "two oscillations of one period"
    assert result["methods"]["lock-in"]["coulomb"] == pytest.approx(value, rel=0.01)
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.1, rel=0.01)


def test_constant_speeds_in_one_file(tworelay: Tworelay, tmp_path: Path) -> None:
    rng, rows, time = np.random.default_rng(0), [], 0.0
    for speed in (2, 5, 10, 20, -2, -5, -10, -20):
        for _ in range(300):
            torque = math.copysign(1.0, speed) + 0.02 * speed + 0.1
            rows.append([time, speed + 0.02 * rng.standard_normal(), torque])
            time += 0.01
    path = written(tmp_path / "steps.csv", ["time_s", "velocity_rad/s", "torque_Nm"], rows)
    done = tworelay("analyze", "--steady", path, "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    jsonschema.validate(result, SCHEMA)
    assert result["friction"]["coulomb"]["value"] == pytest.approx(1.0, rel=0.01)
    assert result["friction"]["offset"]["value"] == pytest.approx(0.1, abs=0.01)
    assert result["friction"]["inertia"]["value"] is None


Spoil = Callable[[list[list[Any]]], list[list[Any]]]


def put(row: int, column: int, value: Any) -> Spoil:
    def spoil(rows: list[list[Any]]) -> list[list[Any]]:
        found = [list(line) for line in rows]
        found[row][column] = value
        return found

    return spoil


@pytest.mark.parametrize(
    ("header", "spoil", "options", "code", "words"),
    [
        (["t", "x", "u"], lambda r: r, [], 2, "no column 'time_s'; name yours: --time COLUMN:UNIT"),
        (HEADER, lambda r: r, ["--torque", "current:0.1 Nm"], 2, "no column 'current'; there are"),
        (HEADER, lambda r: r, ["--torque", "torque_Nm:0.1 A"], 2, "no unit of it; there are Nm"),
        (HEADER, lambda r: r, ["--torque", "torque_Nm:x Nm"], 2, "'x' is no number"),
        (HEADER, lambda r: r, ["--position", "position_rad:mm"], 2, "are mixed"),
        (HEADER, put(99, 1, "nan"), [], 2,
        "row 101, column 'position_rad': nan is no finite number"),
        (HEADER, put(99, 1, "oops"), [], 2, "row 101, column 'position_rad': 'oops' is no number"),
        (HEADER, put(99, 0, 0.0), [], 2, "row 101: time goes from"),
        (HEADER, lambda r: [[t, y, 0.2] for t, y, _ in r], [], 2, "torque is constant at 0.2"),
        (HEADER, lambda r: [[t, 1.0, u] for t, _, u in r], [], 2, "position never changes"),
        (HEADER, lambda r: [[1000 * t, y, u] for t, y, u in r], [], 2,
        "is the time in milliseconds?"),
        (HEADER, lambda r: [[t, 1e6 * y, u] for t, y, u in r], [], 2, "in counts or degrees?"),
        (HEADER, lambda r: [[t, y, 1e9 * u] for t, y, u in r], [], 2, "give its scale"),
        (HEADER, lambda r: r[:40], [], 2, "has 40 samples"),
        (HEADER, put(0, 0, -1.7e9), [], 2, "row 3: a gap of 1.7e+09 s"),
        (HEADER, lambda r: r[:300], [], 6, "velocity reversals"),
        (HEADER, lambda r: [[t, y, -u] for t, y, u in r], [], 6, "sign or unit wrong"),
        (HEADER, lambda r: r, ["--method", "lock-in"], 6, "two steady oscillations of one period"),
        (HEADER, lambda r: r, ["--steady"], 6, "needed"),
        (["time_s", "time_s", "torque_Nm"], lambda r: r, [], 2, "'time_s' stands there twice"),
    ],
)  # fmt: skip
def test_spoiled_recordings(
    tworelay: Tworelay,
    tmp_path: Path,
    rows: list[list[float]],
    header: list[str],
    spoil: Spoil,
    options: list[str],
    code: int,
    words: str,
) -> None:
    path = written(tmp_path / "spoiled.csv", header, spoil(rows))
    done = tworelay("analyze", path, *options)
    assert done.returncode == code, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert words in done.stderr


def test_one_oscillation_only_is_refused(tworelay: Tworelay, tmp_path: Path) -> None:
    record = relay_tests(amplitudes=(0.25,), periods=14)
    rows = [list(row) for row in zip(record.time, record.position, record.command, strict=True)]
    target = tmp_path / "result.json"
    done = tworelay("analyze", written(tmp_path / "one.csv", HEADER, rows), "--json", str(target))
    assert done.returncode == 6
    assert "one oscillation only" in done.stderr
    result = json.loads(target.read_text("utf-8"))
    jsonschema.validate(result, SCHEMA)
    assert result["status"] == "rejected"
    assert result["friction"]["coulomb"]["value"] is None


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.csv", b"", "no rows of numbers"),
        ("x.csv", b"\0\1\2" * 100, "is no text"),
        ("x.csv", b"a,b\n" * 50, "no rows of numbers"),
        ("x.csv", b"1,2,3\n" * 50, "no header"),
        (
            "x.csv",
            b"time_s,position_rad,torque_Nm\n" + b"0,1,2\n" * 9 + b'"' + b"1,2,3\n" * 50000,
            "no number",
        ),
        ("x (1).csv", b"time_s,position_rad,torque_Nm\n" + b"0,1,2\n" * 99, "time goes from"),
        ("x.mat", b"MATLAB 5.0 but not really" * 20, "cannot be read as .mat"),
        ("missing.csv", None, "cannot be read"),
    ],
)
def test_files_that_are_no_recording(
    tworelay: Tworelay, tmp_path: Path, name: str, content: bytes | None, words: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    done = tworelay("analyze", str(path))
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
