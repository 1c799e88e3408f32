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
    for method in ("auto", "lock-in", "modulating"):
        done = tworelay("analyze", path, "--method", method, "--json", "-")
        assert done.returncode == 0, done.stderr
        result = json.loads(done.stdout)
        assert set(result["methods"]) == {"output-error" if method == "auto" else method}
        assert result["friction"]["coulomb"]["value"] == pytest.approx(value, rel=0.01)
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
        (HEADER, lambda r: r, ["--torque", "torque_Nm:0.1 V"], 2, "no unit of it; there are N.m"),
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
        (["time_s", "time_s", "torque_Nm"], lambda r: r, [], 2,
         "There are: time_s, time_s (2), torque_Nm"),
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


def test_one_oscillation_only_is_read_with_its_doubt(tworelay: Tworelay, tmp_path: Path) -> None:
    record = relay_tests(amplitudes=(0.25,), periods=14)
    rows = [list(row) for row in zip(record.time, record.position, record.command, strict=True)]
    done = tworelay("analyze", written(tmp_path / "one.csv", HEADER, rows), "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    jsonschema.validate(result, SCHEMA)
    assert result["quality"]["verdict"] == "usable"
    reasons = {reason["code"]: reason for reason in result["quality"]["reasons"]}
    assert reasons["recording.one-oscillation"]["weight"] == "doubt"
    coulomb = result["friction"]["coulomb"]
    assert coulomb["low"] <= 0.1 <= coulomb["high"]


def test_one_sine_is_read(tworelay: Tworelay, tmp_path: Path) -> None:
    """J 0.54, B 2.2, C 1.4, offset 0.02, and 2 % of noise: 0.1 Hz, 1.5 rad.

    A sine's friction is in its harmonics, its viscous friction is not.
    """
    rng, t, w = np.random.default_rng(1), np.arange(0, 60, 0.01), 2 * np.pi / 10
    y, v, a = 1.5 * np.sin(w * t), 1.5 * w * np.cos(w * t), -1.5 * w * w * np.sin(w * t)
    u = 0.54 * a + 2.2 * v + 1.4 * np.sign(v) + 0.02 + 0.05 * rng.standard_normal(len(t))
    rows = [list(row) for row in zip(t, y, u, strict=True)]
    done = tworelay("analyze", written(tmp_path / "sine.csv", HEADER, rows), "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["quality"]["verdict"] == "usable"
    for name, truth in (("coulomb", 1.4), ("viscous", 2.2), ("inertia", 0.54), ("offset", 0.02)):
        found = result["friction"][name]
        assert found["low"] <= truth <= found["high"], name
    assert result["friction"]["coulomb"]["value"] == pytest.approx(1.4, rel=0.02)
    assert result["methods"]["modulating"]["law"]["terms"] == ["coulomb", "viscous"]


@pytest.mark.parametrize(
    ("link", "options", "stretches"),
    [
        ("virtual://bench", (), 1),
        ("virtual://bench", ("--precision", "0,001 %"), 2),
        ("virtual://epos-screw", (), 1),
    ],
)
def test_a_run_s_own_export_gives_its_own_number(
    tworelay: Tworelay, tmp_path: Path, link: str, options: tuple[str, ...], stretches: int
) -> None:
    """Of the oscillations alone, and of all samples: the file says what was analysed."""
    measured = json.loads(tworelay("identify", link, *options, "--yes", "--json", "-").stdout)
    assert len(measured["experiment"]["analysed"]) == stretches
    assert tworelay("export", "last", str(tmp_path / "run")).returncode == 0
    for name in ("oscillations.csv", "samples.csv"):
        done = tworelay("analyze", str(tmp_path / "run" / name), "--json", "-")
        assert done.returncode == 0, done.stderr
        again = json.loads(done.stdout)
        for number in ("coulomb", "inertia", "viscous", "offset"):
            first, second = measured["friction"][number], again["friction"][number]
            assert second["value"] == pytest.approx(first["value"], rel=1e-4, abs=1e-7), name
            assert second["low"] == pytest.approx(first["low"], rel=1e-2, abs=1e-6)


def test_what_rests_is_no_speed(tworelay: Tworelay, tmp_path: Path) -> None:
    """C 1, B 0.05; in three of ten recordings the axis stops and rests under a smaller torque.

    Its position jitters by a count.
    """
    rng, files = np.random.default_rng(3), []
    for n, w in enumerate((-8, -5, -3, -2, -1, 1, 2, 3, 5, 8)):
        t = np.arange(0, 4, 0.01)
        moves = t < (2.5 if 3 <= n < 6 else 9)
        jitter = np.where(np.arange(len(t)) % 7 == 0, 1e-4 * np.sign(w), 0.0)
        v = np.where(moves, w, jitter)
        u = np.where(moves, np.sign(w) + 0.05 * w, 0.2 * np.sign(w))
        u = u + 0.01 * rng.standard_normal(len(t))
        rows = [list(row) for row in zip(t, v, u, strict=True)]
        header = ["time_s", "velocity_rad/s", "torque_Nm"]
        files.append(written(tmp_path / f"s{n}.csv", header, rows))
    done = tworelay("analyze", "--steady", *files, "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["friction"]["coulomb"]["value"] == pytest.approx(1.0, abs=0.01)
    assert len(result["methods"]["steady"]["points"]) == 10
    rests = next(r for r in result["quality"]["reasons"] if r["code"] == "axis.rests")
    assert "3 of 10 recordings" in rests["text"]
    assert result["quality"]["verdict"] == "good"


def test_constant_speeds_that_are_no_curve_are_rejected(tworelay: Tworelay, tmp_path: Path) -> None:
    rng, files = np.random.default_rng(5), []
    for n, w in enumerate((-8, -6, -5, -4, -3, -1, 1, 3, 4, 5, 6, 8)):
        t = np.arange(0, 3, 0.01)
        u = np.sign(w) * (1 + 0.6 * rng.standard_normal()) + 0.01 * rng.standard_normal(len(t))
        rows = [list(row) for row in zip(t, np.full(len(t), float(w)), u, strict=True)]
        header = ["time_s", "velocity_rad/s", "torque_Nm"]
        files.append(written(tmp_path / f"s{n}.csv", header, rows))
    done = tworelay("analyze", "--steady", *files)
    assert done.returncode == 6
    assert "speeds that were left out of the fit are met to" in done.stderr


@pytest.mark.parametrize("factor", [1e-250, 1e6, 0.0])
def test_no_library_s_words_reach_the_user(
    tworelay: Tworelay, tmp_path: Path, factor: float
) -> None:
    """Numbers that no least squares solve."""
    record = relay_tests()
    rows = [
        [t, y * factor, u]
        for t, y, u in zip(record.time, record.position, record.command, strict=True)
    ]
    rows[len(rows) // 2][2] = 9e6
    done = tworelay("analyze", written(tmp_path / "axis.csv", HEADER, rows))
    assert done.returncode in (2, 6), done.stderr
    for word in ("SVD", "converge", "Traceback", "singular", "overflow", "RuntimeWarning", "nan"):
        assert word not in done.stderr, done.stderr


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.csv", b"", "no rows of numbers"),
        ("x.csv", b"\0\1\2" * 100, "is no text"),
        ("x.csv", b"a,b\n" * 50, "no rows of numbers"),
        ("x.csv", b"1,2,3\n" * 50, "There are: 1, 2, 3"),
        (
            "x.csv",
            b"time_s,position_rad,torque_Nm\n" + b"0,1,2\n" * 9 + b'"' + b"1,2,3\n" * 50000,
            "row 11 has 1 cells, the others 3",
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


def test_a_belt_that_jumps_a_tooth_is_the_one_reason(
    tworelay: Tworelay, tmp_path: Path, rows: list[list[float]]
) -> None:
    """Not a record of two axes, which its halves look like."""
    half = len(rows) // 2
    jumped = [[t, y + (0.1 if n > half else 0.0), u] for n, (t, y, u) in enumerate(rows)]
    done = tworelay("analyze", written(tmp_path / "axis.csv", HEADER, jumped))
    assert done.returncode == 6
    assert "the position jumps by" in done.stderr
    assert "two axes" not in done.stderr
