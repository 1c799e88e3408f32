"""The whole job on one axis: write to RAM, prove, store once; or leave the drive as it was found."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

from commissioning.runs import RunFolder
from commissioning.session.apply import apply, leave_as_found
from commissioning.session.desk import Desk
from commissioning.session.verify import provable, verify
from profiles.errors import Interrupted, PreflightRefused, TwoRelayError
from profiles.library import load_profile

__all__ = ["prove_and_store"]

Show = Callable[[list[dict[str, Any]]], None]


def prove_and_store(run: str, desk: Desk, show: Show, limits: dict[str, Any]) -> dict[str, Any]:
    """Write what `run` proposes, prove it, and store it once; returns the result JSON.

    `show` gets the proposal; `limits` as for `verify`.

    Raises
    ------
    TwoRelayError
        The proof was not reached, or does not help: the drive is as it was found, or the message names what
        is not, and the run stays open for `restore`.
    """
    folder = RunFolder.of(desk.journal, run)
    try:
        provable(load_profile(str(folder.profile_path()), lenient=True))
    except PreflightRefused as error:
        error.args = (f"{error}. Nothing was written; 'tworelay apply {run}' writes it unproved",)
        raise
    try:
        apply(run, None, desk, show, prove_first=True)
        return verify(run, None, desk, limits, unproved=True)
    except BaseException as error:
        with contextlib.suppress(Interrupted), desk.interruption.deferred():
            became, left = leave_as_found(run, desk)
            _note(folder, [f"not proved: {error}", became], left)
        if became and isinstance(error, TwoRelayError):
            error.args = (f"{error}; {became}",)
        raise


def _note(folder: RunFolder, texts: list[str], left: tuple[str, ...]) -> None:
    """What the result keeps of a proof that was not reached; `left`: parameters that are not back."""
    result = folder.result()
    for item in result["compensation"]:
        item["written"] = item["parameter"] in left
    result.setdefault("notes", []).extend(text for text in texts if text)
    folder.save(result, None, None)
