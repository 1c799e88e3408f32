"""What would be written to a connected drive, and what the drive itself thinks of its friction."""

from __future__ import annotations

from dataclasses import replace

from commissioning.compensation import host_terms, propose
from commissioning.identification.reasons import Reason, Weight
from commissioning.result.changes import Change
from commissioning.result.document import Quality, RunResult
from drivers.drive import Drive
from drivers.errors import AccessDenied, WriteFailed
from profiles.parameter import Trust

__all__ = ["with_proposal"]


def with_proposal(result: RunResult, drive: Drive, fraction: float) -> RunResult:
    """`result` with what would be written to the drive for it, and what the drive says itself."""
    if result.friction.coulomb is None:
        return result
    changes, reasons = _changes(result, drive, fraction)
    own = _own_estimate(drive, result.friction.coulomb.value)
    quality = Quality(
        result.quality.verdict, (*result.quality.reasons, *reasons, *([own] if own else ()))
    )
    host = host_terms(drive.profile, drive.scaling, result.friction, fraction)
    return replace(result, compensation=changes, host_compensation=host, quality=quality)


def _note(code: str, text: str) -> Reason:
    return Reason(code, Weight.NOTE, text)


def _changes(
    result: RunResult, drive: Drive, fraction: float
) -> tuple[tuple[Change, ...], list[Reason]]:
    """The proposal; what the drive cannot hold is among the reasons instead."""
    law, found, reasons = drive.profile.compensation, result.friction, []
    if not law.terms:
        return (), []
    old = {name: drive.read_raw(name) for name in law.terms.values()}
    doubtful = [n for n in old if drive.profile.parameters[n].trust is Trust.UNVERIFIED]
    if doubtful:
        reasons.append(
            _note(
                "proposal.unverified",
                f"apply will refuse {', '.join(doubtful)}: unverified in profile '{drive.profile.name}'; "
                "check them in the drive's manual, mark them in a copy of the profile, and identify with "
                "that",
            )
        )
    for attempt in (found, replace(found, viscous=None)):
        try:
            changes = propose(drive.profile, drive.scaling, attempt, old, fraction)
        except WriteFailed as error:
            reasons.append(_note("proposal.impossible", f"not proposed: {error}"))
        else:
            return tuple(changes), reasons
    return (), reasons


def _own_estimate(drive: Drive, coulomb: float) -> Reason | None:
    """The drive's own estimate of the friction beside ours (N.m or N), where it has one."""
    name = drive.profile.own_estimates.get("coulomb")
    if name is None:
        return None
    try:
        own = abs(drive.read(name))
    except AccessDenied:
        return None
    if not own > 0:
        return None
    unit = drive.scaling.unit_text(drive.profile.parameters[name])
    return _note(
        "drive.estimate",
        f"the drive's own estimate of the Coulomb friction ({name}) is {own:.4g} {unit}: "
        f"{100 * (own / coulomb - 1):+.0f} % against the one found here",
    )
