"""The whole job on one axis: write to RAM, prove, store once.

Or leave the drive as it was found.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace

from commissioning.desk import Desk
from commissioning.ending import ended, erring
from commissioning.errors import Interrupted
from commissioning.result.changes import Change
from commissioning.result.document import RunResult
from commissioning.result.endings import AxisState, Error
from commissioning.rig.expected import WRITING
from commissioning.runs import RunFolder
from commissioning.session.apply import apply
from commissioning.session.restore import leave_as_found
from commissioning.session.verify import Wishes, provable, verify
from drivers.errors import PreflightRefused
from profiles.errors import TwoRelayError
from profiles.library import load_profile

__all__ = ["prove_and_store"]

Show = Callable[[tuple[Change, ...]], None]


def prove_and_store(
    run: str,
    desk: Desk,
    show: Show,
    *,
    without_watchdog: bool,
    proving: Callable[[], None] = lambda: None,
) -> RunResult:
    """Write what `run` proposes, prove it, and store it once; returns the result.

    `show` gets the proposal; `proving` is called when it is written, and the proof begins.

    Raises
    ------
    TwoRelayError
        The proof was not reached, or does not help: the drive is as it was found, or the message
        names what is not, and the run stays open for `restore`.
    """
    folder = RunFolder.of(desk.journal, run)
    try:
        provable(load_profile(str(folder.profile_path()), lenient=True))
    except PreflightRefused as error:
        error.also(f"nothing was written; 'tworelay apply {run}' writes it unproved")
        _close(run, desk, folder, error, (f"not proved: {error}",), None)
        raise
    try:
        desk.watcher.step(WRITING)
        apply(run, None, desk, show, prove_first=True)
        proving()
        return verify(run, None, desk, Wishes(without_watchdog=without_watchdog), unproved=True)
    except BaseException as error:
        if isinstance(error, Interrupted) and error.noted and _is_proved(run, desk):
            raise  # it came after the last act
        with contextlib.suppress(Interrupted), desk.interruption.deferred():
            became, axis = leave_as_found(run, desk)
            notes = tuple(text for text in (f"not proved: {error}", became) if text)
            if became and isinstance(error, TwoRelayError):
                error.also(became)
            try:
                _close(run, desk, folder, error, notes, axis)
            except TwoRelayError as second:  # a full disk; the drive is as it is said to be
                if isinstance(error, TwoRelayError):
                    error.also(second)
        raise


def _is_proved(run: str, desk: Desk) -> bool:
    """Whether the last act was done to its end: the proof, and the one store."""
    result = RunFolder.of(desk.journal, run).result()
    return result.verification is not None and result.verification.kept is not None


def _close(
    run: str,
    desk: Desk,
    folder: RunFolder,
    error: BaseException,
    notes: tuple[str, ...],
    axis: AxisState | None,
) -> None:
    """What the run keeps of a proof that was not reached.

    `axis`: as the drive said it afterwards.
    """
    history = desk.journal.history(run)
    result = folder.result(history)
    result = replace(result, notes=result.notes + notes)
    said_by = None
    if isinstance(error, TwoRelayError):
        result, said_by = erring(result, error), error.said_by or None
        error.noted = True
    else:
        text = f"internal error ({type(error).__name__}: {error})"
        result = replace(result, status="failed", error=Error("internal", text))
    before = result.ending.axis if result.ending else AxisState.NOT_VERIFIED
    folder.save(ended(result, history, axis or before, said_by))
