"""What other tools write: the same recording in every form that was met, and what is refused.

J 0.02, B 0.05, C 0.3, offset 0.05 in SI, by an integration of its own.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from commissioning.recordings.files import table_of
from commissioning.recordings.reading import Recording, Scales, column_of, read
from profiles.errors import UsageError
from tests.raising import raises

N, STEP = 400, 0.002
TIME = np.arange(N) * STEP
POSITION = 0.7 * np.sin(9 * TIME) + 0.1 * TIME
TORQUE = np.where(np.sin(9 * TIME) > 0, 0.95, -1.05)


def rows(form: str = "{:.6f}", comma: bool = False) -> list[list[str]]:
    found = [[form.format(x) for x in row] for row in zip(TIME, POSITION, TORQUE, strict=True)]
    return [[cell.replace(".", ",") for cell in row] for row in found] if comma else found


def lines(separator: str = ",", *, comma: bool = False, quote: str = "") -> list[str]:
    return [separator.join(f"{quote}{cell}{quote}" for cell in row) for row in rows(comma=comma)]


HEAD = "time_s,position_rad,torque_Nm"


def clock(t: float, day: str) -> str:
    seconds = 86399.5 + t  # past midnight
    date = day if seconds < 86400 else "2026-11-27"
    s = seconds % 86400
    stamp = f"{int(s // 3600):02d}:{int(s % 3600 // 60):02d}:{s % 60:09.6f}"
    return f"{date}T{stamp}" if day else stamp


def stamped(day: str) -> list[str]:
    return [",".join([clock(t, day), *row[1:]]) for t, row in zip(TIME, rows(), strict=True)]


TEXTS: dict[str, tuple[list[str], str]] = {
    "plain": ([HEAD, *lines()], "utf-8"),
    "utf-16": ([HEAD, *lines()], "utf-16"),
    "utf-16 without a mark": ([HEAD, *lines()], "utf-16-le"),
    "latin-1": (["# Prüfstand 3 – Messung", HEAD, *lines()], "cp1252"),
    "semicolons and commas": ([HEAD.replace(",", ";"), *lines(";", comma=True)], "utf-8"),
    "quoted, decimal comma": ([HEAD, *lines(",", comma=True, quote='"')], "utf-8"),
    "trailing separators": ([f"{HEAD},", *(f"{line}," for line in lines())], "utf-8"),
    "tabs": ([HEAD.replace(",", "\t"), *lines("\t")], "utf-8"),
    "aligned spaces": (
        ["  time_s   position_rad   torque_Nm", *(f"  {line}" for line in lines("    "))], "utf-8"
    ),
    "a drawn table": (
        ["| time_s | position_rad | torque_Nm |", "|---|---|---|",
         *(f"| {line} |" for line in lines(" | "))], "utf-8"
    ),
    "a commented header": (["# made by a logger", f"# {HEAD}", *lines()], "utf-8"),
    "units in brackets": (["t [s];Lage [rad];Moment [N·m]", *lines(";")], "utf-8"),
    "units below": (["t,Lage,Moment", "s,rad,Nm", *lines()], "utf-8"),
    "units above": (["s,rad,Nm", "t,Lage,Moment", *lines()], "utf-8"),
    "a text column": (
        ["time_s,state,position_rad,torque_Nm",
         *(",".join([r[0], "RUN", r[1], r[2]]) for r in rows())], "utf-8"
    ),
    "a name twice": ([f"{HEAD},spare,spare", *(f"{line},0,0" for line in lines())], "utf-8"),
    "dates": (["stamp,position_rad,torque_Nm", *stamped("2026-11-26")], "utf-8"),
    "times of day past midnight": (["stamp,position_rad,torque_Nm", *stamped("")], "utf-8"),
    "a column that is named and empty": (
        ["time_s;position_rad;torque_Nm;event", *(f"{line};" for line in lines(";"))], "utf-8"
    ),
    "a footer": ([HEAD, *lines(), "", "Mean;0.1", "end of data"], "utf-8"),
    "a short last row": ([HEAD, *lines(), "0.8,0.1"], "utf-8"),
}  # fmt: skip


def found_in(path: Path, scales: Scales | None = None, **named: str) -> Recording:
    table = table_of(path)
    columns = {q: column_of(text, q, table.scalars) for q, text in named.items()}
    return read(table, columns, scales)


def is_the_same(found: Recording, rel: float = 1e-4) -> None:
    assert found.position is not None
    assert len(found.time) == N
    assert np.allclose(found.time - found.time[0], TIME, atol=1e-6)
    assert np.allclose(found.position, POSITION, atol=rel)
    assert np.allclose(found.torque, TORQUE, atol=rel)


@pytest.mark.parametrize("name", TEXTS)
def test_one_recording_in_every_form_of_text(tmp_path: Path, name: str) -> None:
    text, encoding = TEXTS[name]
    path = tmp_path / "x.csv"
    path.write_bytes("\n".join(text).encode(encoding))
    is_the_same(found_in(path))


def test_columns_by_number_where_there_is_no_header(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("\n".join(lines()))
    is_the_same(found_in(path, time="1:s", position="2:rad", torque="3:Nm"))
    with raises(UsageError, "usage") as caught:
        found_in(path)
    assert "There are: 1, 2, 3" in str(caught.value)


def test_a_period_where_there_is_no_time(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("\n".join(["position_rad,torque_Nm", *(",".join(r[1:]) for r in rows())]))
    is_the_same(found_in(path, Scales(period=STEP)))
    with raises(UsageError, "usage") as caught:
        found_in(path)
    assert "--period 2ms" in str(caught.value)


def test_counts_currents_and_shares_by_their_bases(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    counts = np.round(POSITION / (2 * np.pi) * 8192).astype(int)
    body = [f"{q};{1000 * u / 0.05:.4f}" for q, u in zip(counts, TORQUE, strict=True)]
    path.write_text("\n".join(["pos [inc];I [mA]", *body]))
    scales = Scales(encoder=8192, torque_constant=0.05, period=STEP)
    is_the_same(found_in(path, scales), 1e-3)
    column = {"position": "pos [inc]:8192 counts", "torque": "I [mA]:0.05 mA"}
    is_the_same(found_in(path, Scales(period=STEP), **column), 1e-3)
    with raises(UsageError, "usage") as caught:
        found_in(path, Scales(period=STEP))
    assert "--encoder" in str(caught.value)
    body = [
        f"{1000 * t:g};{q};{100 * u / 1.27:.6f}"
        for t, q, u in zip(TIME, POSITION, TORQUE, strict=True)
    ]
    path.write_text("\n".join(["t (ms);x in rad;M [%]", *body]))
    is_the_same(found_in(path, Scales(rated_torque=1.27)))


@pytest.mark.parametrize("unit", ["deg", "rev", "mrad"])
def test_positions_of_any_unit(tmp_path: Path, unit: str) -> None:
    factor = {"deg": 180 / np.pi, "rev": 0.5 / np.pi, "mrad": 1000.0}[unit]
    path = tmp_path / "x.csv"
    body = [f"{t},{factor * q},{u}" for t, q, u in zip(TIME, POSITION, TORQUE, strict=True)]
    path.write_text("\n".join([f"t_s,x [{unit}],M_Nm", *body]))
    is_the_same(found_in(path))


def saved_v7(path: Path) -> None:
    log = {"time_s": TIME, "position_rad": POSITION, "torque_Nm": TORQUE, "note": "x"}
    scipy.io.savemat(path, {"log": log}, do_compression=True)


def saved_matrix(path: Path) -> None:
    scipy.io.savemat(path, {"data": np.column_stack([TIME, POSITION, TORQUE])})


def saved_v73(path: Path) -> None:
    hdf5: Any = importlib.import_module("h5py")
    with hdf5.File(path, "w", userblock_size=512) as file:
        for name, values in (("time_s", TIME), ("position_rad", POSITION), ("torque_Nm", TORQUE)):
            file[f"log/{name}"] = values.reshape(1, -1)


def saved_npz(path: Path) -> None:
    np.savez_compressed(path, time_s=TIME, position_rad=POSITION, torque_Nm=TORQUE)


NAMES = {"time": "log.time_s:s", "position": "log.position_rad:rad", "torque": "log.torque_Nm:Nm"}
NUMBERS = {"time": "data(1):s", "position": "data(2):rad", "torque": "data(3):Nm"}


@pytest.mark.parametrize(
    ("name", "save", "named"),
    [
        ("struct.mat", saved_v7, NAMES), ("matrix.mat", saved_matrix, NUMBERS),
        ("v73.mat", saved_v73, NAMES), ("x.npz", saved_npz, {}),
    ],
)  # fmt: skip
def test_arrays_of_every_kind(
    tmp_path: Path, name: str, save: Callable[[Path], None], named: dict[str, str]
) -> None:
    path = tmp_path / name
    save(path)
    is_the_same(found_in(path, **named), 1e-9)


def test_a_row_that_is_none_in_the_middle_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    body = lines()
    body[100] = "0.2,here,0.5"
    path.write_text("\n".join([HEAD, *body]))
    with raises(UsageError, "usage") as caught:
        table_of(path)
    assert "row 102, column 'position_rad': 'here' is no number" in str(caught.value)


def test_what_was_left_out_is_said(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("\n".join([HEAD, *lines(), "end of data"]))
    assert "left out: 1" in table_of(path).notes[0]


def test_a_column_that_is_nearly_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("\n".join([HEAD, *lines()]))
    with raises(UsageError, "usage") as caught:
        found_in(path, torque="torqe_Nm:Nm")
    assert "Did you mean 'torque_Nm'?" in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"\x93NUMPY", b"\x89HDF\r\n\x1a\n" + b"x" * 600]
)
@pytest.mark.parametrize("ending", ["csv", "mat", "npz", "npy"])
def test_what_is_no_recording_is_refused_in_one_line(
    tmp_path: Path, content: bytes, ending: str
) -> None:
    path = tmp_path / f"x.{ending}"
    path.write_bytes(content)
    with raises(UsageError, "usage") as caught:
        table_of(path)
    assert "\n" not in str(caught.value)


def test_nothing_of_a_pickle_is_executed(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    evil: Any = np.array([print], dtype=object)
    np.savez(path, x=evil)
    with raises(UsageError, "usage"):
        table_of(path)


def test_groups_of_thousands_are_not_taken_for_decimals(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    body = [f"{n},5;{'1.234' if n == 90 else n};{n % 2},5" for n in range(100)]
    path.write_text("\n".join(["t_ms;pos_inc;M_Nm", *body]))
    with raises(UsageError, "usage") as caught:
        table_of(path)
    assert "'1.234' has a point, and others have decimal commas" in str(caught.value)


def test_a_header_that_promises_too_much_is_refused(tmp_path: Path) -> None:
    path, header = (
        tmp_path / "x.npy",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 3), }",
    )
    padded = header.ljust(117) + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded)
    with raises(UsageError, "usage"):
        table_of(path)


def test_a_torque_at_the_motor_is_a_force_by_the_feed(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    body = [
        f"{t:.4f};{q:.6f};{u:.4f}" for t, q, u in zip(TIME, 1000 * POSITION, TORQUE, strict=True)
    ]
    path.write_text("\n".join(["t_s;pos_inc;I_A", *body]))
    found = found_in(path, Scales(encoder=4096, feed=0.01, torque_constant=0.12))
    assert found.linear
    assert np.allclose(found.torque, TORQUE * 0.12 * 2 * np.pi / 0.01, rtol=1e-3)
