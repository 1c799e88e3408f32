"""Settings of drives are put back on the gateway that has them, by its own command."""

from __future__ import annotations

import subprocess

from commissioning.fleet.gateway.messages import PutBack, Restore
from commissioning.processes import start

__all__ = ["put_back"]

_PATIENCE = 240.0  # s


def put_back(asked: Restore) -> PutBack:
    """'tworelay fleet restore' of a fleet run; the client has asked whoever sits there."""
    words = ["fleet", "restore", asked.run, "--yes"]
    if asked.everything:
        for axis in asked.axes:
            words += ["--axis", axis]
    words += ["--force"] if asked.force else []
    words += ["--dry-run"] if asked.act == "show" else []
    process = start(
        "commissioning", *words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )  # fmt: skip
    try:
        said, _ = process.communicate(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:  # it goes on: half a write is worse than a late one
        return PutBack(7, (f"still under way after {_PATIENCE:.0f} s on the gateway",))
    return PutBack(process.returncode, tuple(said.decode("utf-8", "replace").splitlines()))
