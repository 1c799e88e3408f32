"""The runs of this computer in one table: what was measured when, and what is in the drive now."""

from __future__ import annotations

from dataclasses import dataclass

from commissioning.journal import Journal
from commissioning.processes import is_alive
from commissioning.records import History, RunRecord
from commissioning.result.document import RunResult
from commissioning.result.endings import CompensationState
from commissioning.result.found import Quantity
from commissioning.result.words import VERDICTS
from commissioning.runs import RunFolder, drive_state
from profiles.errors import UsageError

__all__ = ["Listed", "listed", "runs"]


@dataclass(frozen=True, slots=True)
class Listed:
    """One run.

    Attributes
    ----------
    began : s since 1970, by the computer's clock then
    verdict : of the measurement, or what became of the run instead
    coulomb : None where none was measured
    drive : what the run has left in the drive, in words
    adopted : it was measured on another computer
    """

    run: str
    axis: str
    began: float
    verdict: str
    coulomb: Quantity | None
    drive: str
    adopted: bool


def runs(journal: Journal, most: int | None) -> tuple[list[Listed], int]:
    """The last `most` runs in their order, and how many there are before."""
    found, before = journal.last_runs(most)
    return [listed(journal, run) for run in found], before


def listed(journal: Journal, run: str) -> Listed:
    """One run."""
    history = journal.history(run, of_drive=False)
    record = history.run
    result: RunResult | None = None
    coulomb: Quantity | None = None
    try:
        result = RunFolder.of(journal, record.id).result(history)
        verdict, coulomb = _verdict(result, record), result.coulomb
    except UsageError:
        entry = journal.entry(record.id)  # its numbers outlive its files
        coulomb = entry.quantities.get("coulomb") if entry and entry.measured else None
        gone = any(event.text == "files deleted" for event in history.events)
        there = (journal.folder / "runs" / record.id / "run.json").exists()
        verdict = "files damaged" if there else "files deleted" if gone else "files missing"
    return Listed(
        record.id, history.named, record.created, verdict, coulomb, _in_drive(result, history),
        record.adopted,
    )  # fmt: skip


def _verdict(result: RunResult, record: RunRecord) -> str:
    verdict, proved = VERDICTS[result.quality.verdict], result.verification
    if result.ending is None:
        alive = is_alive(record.context.pid, record.context.started) and not record.adopted
        now = "in progress" if record.status == "running" and alive else "cut off"
        return f"{verdict}, then {now}" if result.measured else now
    if not result.measured:
        return result.status if result.status != "completed" else verdict
    if result.status != "completed":
        useless = proved is not None and proved.kept is None
        return f"{verdict}, does not help" if useless else f"{verdict}, then {result.status}"
    return verdict


_MEMORY = {True: ", stored", False: ", not stored", None: ", not known to be stored"}


def _in_drive(result: RunResult | None, history: History) -> str:
    """What the run has left there, in a few words."""
    left = [intent for intent in history.intents if intent.is_open]
    if any(not intent.lasts for intent in left):
        also = ", values of this run" if any(intent.lasts for intent in left) else ""
        return f"settings not put back{also}"
    if result is None:
        return "values of this run" if left else "as found"
    state = drive_state(result, history)
    if state.compensation is CompensationState.OF_OTHER:
        return "another run's"
    if state.compensation is CompensationState.AS_FOUND:
        gains = any(one.kind == "gain" for one in result.written)
        memory = "" if state.stored is None else ", not stored"
        return "gains of this run" if gains else f"as found{memory}"
    if state.compensation is CompensationState.NOT_KNOWN:
        return "not known"
    whole = state.compensation is CompensationState.OF_RUN
    return ("this run's" if whole else "partly this run's") + _MEMORY[state.stored]
