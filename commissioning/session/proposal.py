"""What would be written to a connected drive, and what the drive itself thinks of its friction."""

from __future__ import annotations

from dataclasses import replace

from commissioning.compensation import host_terms, propose
from commissioning.identification.reasons import Reason, Weight
from commissioning.result.changes import Change
from commissioning.result.document import Quality, RunResult
from drivers.drive import Drive
from drivers.errors import AccessDenied, WriteFailed
from drivers.writing import why_not_written

__all__ = ["own_estimate", "with_proposal"]


def with_proposal(result: RunResult, drive: Drive, fraction: float) -> RunResult:
    """`result` with what would be written to the drive for it, and what the drive says itself."""
    if result.friction.coulomb is None:
        return result
    changes, reasons = _changes(result, drive, fraction)
    own = own_estimate(drive, result.friction.coulomb.value)
    quality = Quality(
        result.quality.verdict, (*result.quality.reasons, *reasons, *([own] if own else ()))
    )
    host = host_terms(drive.compensation, drive.parameters, result.friction, fraction)
    return replace(result, compensation=changes, host_compensation=host, quality=quality)


def _note(code: str, text: str) -> Reason:
    return Reason(code, Weight.NOTE, text)


def _changes(
    result: RunResult, drive: Drive, fraction: float
) -> tuple[tuple[Change, ...], list[Reason]]:
    """The proposal; what the drive cannot hold is among the reasons instead."""
    law, found, reasons = drive.compensation, result.friction, []
    if not law.terms:
        return (), []
    old = {name: drive.read(name).raw for name in law.terms.values()}
    whys = (why_not_written(drive.parameters[name]) for name in law.written)
    doubtful = [why for why in whys if why is not None]
    if doubtful:
        ways = "; ".join(dict.fromkeys(why.hint for why in doubtful if why.hint))
        text = "; ".join(why.text for why in doubtful)
        reasons.append(_note("proposal.unverified", f"apply will refuse: {text}; {ways}"))
    for attempt in (found, replace(found, viscous=None)):
        try:
            changes = propose(law, drive.parameters, attempt, old, fraction)
        except WriteFailed as error:
            reasons.append(_note("proposal.impossible", f"not proposed: {error}"))
        else:
            return tuple(changes), reasons
    return (), reasons


def own_estimate(drive: Drive, coulomb: float) -> Reason | None:
    """The drive's own estimate of the friction beside ours (N.m or N), where it has one."""
    name = drive.own_estimates.get("coulomb")
    if name is None:
        return None
    try:
        own = abs(drive.read(name).si)
    except AccessDenied:
        return None
    if not own > 0:
        return None
    unit = drive.parameters[name].unit
    return _note(
        "drive.estimate",
        f"the drive's own estimate of the Coulomb friction ({name}) is {own:.4g} {unit}: "
        f"{100 * (own / coulomb - 1):+.0f} % against the one found here",
    )
