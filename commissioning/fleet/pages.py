"""The files of a fleet run: the page that goes along with it, and what stays of it."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from commissioning.report.fleet import acceptance, page
from commissioning.result.fleet import FleetResult
from commissioning.result.fleet_codec import fleet_text
from drivers.home import home
from profiles.files import replace

__all__ = ["Pages", "folder_of"]

_EVERY = 2.0  # s


def folder_of(run: str) -> Path:
    """Where the files of a fleet run lie."""
    return home() / "fleets" / run


class Pages:
    """Writes the page now and then; a folder that takes none ends no run."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._written = 0.0

    @property
    def going(self) -> str:
        """Where the page is."""
        return "" if self._folder is None else str(self._folder / "fleet.html")

    def open(self, run: str) -> None:
        """There is a run to be written about."""
        self._folder = folder_of(run)
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)

    def show(self, result: FleetResult) -> None:
        """Every two seconds, whole."""
        if self._folder is None or time.monotonic() - self._written < _EVERY:
            return
        self._written = time.monotonic()
        with contextlib.suppress(OSError):
            replace(self._folder / "fleet.html", page(result).encode())

    def write(self, result: FleetResult) -> list[Path]:
        """All files of a run, as it is now; returns those that could be written."""
        folder = folder_of(result.fleet_run)
        written = []
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
        for name, text in (
            ("fleet.html", page(result)),
            ("acceptance.html", acceptance(result)),
            ("fleet.json", fleet_text(result)),
        ):
            with contextlib.suppress(OSError):
                replace(folder / name, text.encode())
                written.append(folder / name)
        return written
