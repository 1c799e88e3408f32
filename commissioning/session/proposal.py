"""What would be written to a connected drive, and what the drive itself thinks of its friction."""

from __future__ import annotations

from dataclasses import replace

from commissioning.compensation import Change, Known, propose
from drivers.drive import Drive
from profiles.errors import AccessDenied, WriteFailed
from profiles.schema import Trust

__all__ = ["own_estimate", "proposal"]


def proposal(drive: Drive, known: Known, fraction: float, reasons: list[str]) -> list[Change]:
    """What would be written; what the drive cannot hold goes into `reasons` instead."""
    law = drive.profile.compensation
    if not law.terms:
        return []
    old = {name: drive.read_raw(name) for name in law.terms.values()}
    doubtful = [n for n in old if drive.profile.parameters[n].trust is Trust.UNVERIFIED]
    if doubtful:
        reasons.append(
            f"apply will refuse {', '.join(doubtful)}: unverified in profile '{drive.profile.name}'; check "
            "them in the drive's manual, mark them in a copy of the profile, and identify with that"
        )
    for attempt in (known, replace(known, viscous=None)):
        try:
            return propose(drive.profile, drive.scaling, attempt, old, fraction)
        except WriteFailed as error:
            reasons.append(f"not proposed: {error}")
    return []


def own_estimate(drive: Drive, coulomb: float) -> str:
    """The drive's own estimate of the friction beside ours (N.m or N), or '' where it has none."""
    name = drive.profile.own_estimates.get("coulomb")
    if name is None:
        return ""
    try:
        own = abs(drive.read(name))
    except AccessDenied:
        return ""
    if not own > 0:
        return ""
    unit = drive.scaling.unit_text(drive.profile.parameters[name])
    return (
        f"the drive's own estimate of the Coulomb friction ({name}) is {own:.4g} {unit}: "
        f"{100 * (own / coulomb - 1):+.0f} % against the one found here"
    )
