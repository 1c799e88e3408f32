"""The same axis in whatever position units its drive counts: J, B, f, Ku, and how far it went."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.serving import WIRES as SERVED
from tests.serving import serve

__all__ = ["units"]

_HABITS = (
    (), ("feed",), ("feed=10000",), ("gear",), ("old-factor",), ("polarity",), ("gear", "polarity"),
    ("feed", "wrap", "polarity"), ("modulo",),
)  # fmt: skip
_J, _B, _F = 1e-3, 2e-3, 0.1  # of `bench`


def units() -> list[str]:
    """A row for each combination of CiA 402's factors."""
    lines = [
        "# One axis, many position units",
        "",
        "Written by `make bench`: `identify --points --travel 20 --cycle 0.008` on `bench`, a twin of `cia402`",
        "(`virtual serve … --habit`), `clock=step`. In brackets the error against the axis' own figures; of Ku",
        "and the travel, against the first row.",
        "",
        "| habits | J, kg.m² | B, N.m.s/rad | f, N.m | Ku, N.m/rad | travel, rad |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    first: dict[str, float] = {}
    for habits in _HABITS:
        result = _measured(habits)
        friction = result["friction"]
        found = {
            "J": friction["inertia"]["value"], "B": friction["viscous"]["value"],
            "f": friction["coulomb"]["value"], "Ku": result["critical_point"]["at_180"]["ku"],
            "travel": result["experiment"]["travel"],
        }  # fmt: skip
        first = first or found
        true = {"J": _J, "B": _B, "f": _F, "Ku": first["Ku"], "travel": first["travel"]}
        cells = [f"{v:.4g} ({100 * (v / true[k] - 1):+.1f} %)" for k, v in found.items()]
        lines.append(f"| {' '.join(habits) or 'none'} | {' | '.join(cells)} |")
    return lines


def _measured(habits: tuple[str, ...]) -> dict[str, Any]:
    words = [word for habit in habits for word in ("--habit", habit)]
    twin = ("--profile", "cia402", "--clock", "step")
    with (
        serve("bench", *SERVED["socketcand"], *twin, *words) as links,
        tempfile.TemporaryDirectory() as folder,
    ):
        path = Path(folder) / "result.json"
        subprocess.run(
            [
                sys.executable, "-m", "commissioning", "identify", links[0], "--profile", "cia402",
                "--travel", "20", "--cycle", "0.008", "--points", "--yes", "--json", str(path),
            ],
            check=True, capture_output=True, env={**os.environ, "TWORELAY_HOME": folder},
        )  # fmt: skip
        found: dict[str, Any] = json.loads(path.read_text())
        return found
