"""A virtual drive served for many cases."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from pathlib import Path

from tests.faults.proxy import WIRES
from tests.serving import serve

__all__ = ["served"]


@contextlib.contextmanager
def served(wire: str, state: Path | None = None) -> Generator[list[str]]:
    """Its links: by Modbus TCP, and on the wire (which may be the same); `state`: its memory."""
    arguments, links = WIRES[wire].serve, 1
    if not WIRES[wire].is_own and wire != "modbus-tcp":
        arguments, links = WIRES["modbus-tcp"].serve + arguments, 2
    with serve("bench", *arguments, "--clock", "step", links=links, state=state) as found:
        yield found
