"""Files made to exhaust whoever reads them: refused in one line, within little memory."""

from __future__ import annotations

import io
import json
import os
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commissioning.journal import Journal
from commissioning.recordings.files import table_of
from commissioning.recordings.reading import read
from commissioning.runs import RunFolder, resolve
from profiles.axis import load_axis
from profiles.eds import read_eds
from profiles.errors import TwoRelayError
from profiles.library import draft_from_csv, load_profile

_MEMORY = 400_000_000  # bytes
_HUGE = 1 << 36  # bytes, most of them a hole


def _run(path: Path) -> None:
    RunFolder(path.parent).result()


def _exported(path: Path) -> None:
    (path.parent / "run.json").write_text("{}")
    with Journal(path.parent / "home") as journal:
        resolve(journal, str(path.parent))


def _samples(path: Path) -> None:
    RunFolder(path.parent).samples()


def _recording(path: Path) -> None:
    read(table_of(path), {})


READERS: dict[str, Callable[[Path], Any]] = {
    "profile.toml": lambda path: load_profile(str(path)),
    "axis.toml": load_axis,
    "drive.eds": read_eds,
    "table.csv": draft_from_csv,
    "recording.csv": _recording,
    "recording.mat": _recording,
    "run.json": _run,
    "journal.json": _exported,
    "samples.npz": _samples,
}


@pytest.fixture
def little_memory() -> Iterator[None]:
    tracemalloc.start()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < _MEMORY, f"{peak / 1e6:.0f} MB"


def _refused(name: str, path: Path) -> None:
    with pytest.raises(TwoRelayError) as caught:
        READERS[name](path)
    text = str(caught.value)
    assert len(text.splitlines()) == 1
    assert len(text) < 500


@pytest.mark.parametrize("name", READERS)
@pytest.mark.usefixtures("little_memory")
def test_a_file_of_64_gigabytes(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(_HUGE)
    _refused(name, path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there is no /dev/zero")
@pytest.mark.parametrize("name", READERS)
@pytest.mark.usefixtures("little_memory")
def test_a_device_without_an_end(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.symlink_to("/dev/zero")
    _refused(name, path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize("name", READERS)
def test_a_pipe_into_which_nobody_writes(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    _refused(name, path)


@pytest.mark.parametrize("name", ["run.json", "journal.json"])
@pytest.mark.usefixtures("little_memory")
def test_brackets_within_brackets(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("[" * 1_000_000)
    _refused(name, path)


@pytest.mark.parametrize("name", ["profile.toml", "axis.toml"])
@pytest.mark.usefixtures("little_memory")
def test_tables_within_tables(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("x = " + "[" * 100_000)
    _refused(name, path)


@pytest.mark.usefixtures("little_memory")
def test_samples_that_inflate_a_thousandfold(tmp_path: Path) -> None:
    """Half a gigabyte of zeros in half a megabyte."""
    path = tmp_path / "samples.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", "position", "torque", "command"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                for _ in range(130):
                    member.write(bytes(1_000_000))
    _refused("samples.npz", path)


@pytest.mark.usefixtures("little_memory")
def test_samples_whose_header_promises_more_than_there_is(tmp_path: Path) -> None:
    path = tmp_path / "samples.npz"
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 40,)}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("time.npy", header.getvalue())
        archive.writestr("phases.npy", header.getvalue())
    _refused("samples.npz", path)


@pytest.mark.usefixtures("little_memory")
def test_a_mat_file_that_inflates_a_thousandfold(tmp_path: Path) -> None:
    import scipy.io

    path = tmp_path / "recording.mat"
    scipy.io.savemat(path, {"x": np.zeros((1, 30_000_000))}, do_compression=True)
    tracemalloc.reset_peak()
    assert path.stat().st_size < 1_000_000
    _refused("recording.mat", path)


def test_an_exported_run_whose_id_leads_elsewhere(tmp_path: Path) -> None:
    """Nothing of a file is used as a path."""
    (tmp_path / "run.json").write_text("{}")
    run = {
        "id": "../../elsewhere", "created": 0.0, "axis": "x", "link": "virtual://bench",
        "profile": "p",
        "profile_hash": "h", "serial": "0x1", "status": "completed", "context": {},
    }  # fmt: skip
    tree = {"schema": "tworelay.journal/1", "run": run, "intents": [], "events": []}
    (tmp_path / "journal.json").write_text(json.dumps(tree))
    with Journal(tmp_path / "home") as journal:
        run_id, _ = resolve(journal, str(tmp_path))
        with pytest.raises(TwoRelayError, match="is no run id"):
            RunFolder.of(journal, run_id)
    assert not (tmp_path.parent / "elsewhere").exists()


def test_a_text_that_only_looks_compressed(tmp_path: Path) -> None:
    path = tmp_path / "samples.npz"
    path.write_bytes(zlib.compress(bytes(1000)))
    _refused("samples.npz", path)


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("kind", ["cells", "struct"])
def test_a_mat_file_whose_small_cells_hold_a_thousandfold(tmp_path: Path, kind: str) -> None:
    """The shape says one by one; what is in it says nothing of its size."""
    import scipy.io

    path = tmp_path / "recording.mat"
    inner: Any = np.zeros((1, 8_000_000))
    for _ in range(3):
        if kind == "struct":
            inner = {"a": inner, "b": inner}
        else:
            cell = np.empty((1, 2), dtype=object)
            cell[0, 0] = cell[0, 1] = inner
            inner = cell
    scipy.io.savemat(path, {"time_s": np.arange(100.0), "x": inner}, do_compression=True)
    assert path.stat().st_size < 2_000_000
    del inner
    tracemalloc.reset_peak()
    table = table_of(path)
    assert list(table.columns) == ["time_s"]
