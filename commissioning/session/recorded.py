"""A recording of an axis becomes a run with a proposal for its drive, which is read and not written."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from commissioning.compensation import Known, host_terms
from commissioning.identification.estimate import Estimate
from commissioning.runs import RunFolder
from commissioning.session.desk import Desk, begin_run, connect
from commissioning.session.proposal import own_estimate, proposal
from commissioning.session.result import blank, changes_json
from profiles.axis import Axis
from profiles.errors import UsageError
from profiles.library import source_text

__all__ = ["for_drive"]


def for_drive(result: dict[str, Any], axis: Axis, fraction: float, desk: Desk) -> dict[str, Any]:
    """The result of a recording with what would be written to the drive of `axis`, as a run of the journal.

    Raises UsageError, LinkError, IdentityMismatch, PreflightRefused.
    """
    if result["units"]["position"] != axis.position_unit:
        raise UsageError(
            f"the recording is in {result['units']['position']} and {result['units']['effort']}, axis "
            f"'{axis.name}' in {axis.position_unit} and {axis.effort_unit}: say its mechanics in an axis "
            "file"
        )
    with connect(axis, None, desk, "analyze") as drive:
        identity = drive.identity()
        desk.tell(f"drive: {identity}; profile {drive.profile.name} {drive.profile.version}")
        known, reasons = _known(result), result["quality"]["reasons"]
        result["compensation"] = changes_json(proposal(drive, known, fraction, reasons))
        reasons += filter(None, [own_estimate(drive, known.coulomb)])
        added = host_terms(drive.profile, drive.scaling, known, fraction)
        result["host_compensation"] = asdict(added) if added else None
        named = blank(axis, drive.link, drive.profile, identity)
        result |= {key: named[key] for key in ("axis", "link", "profile", "identity")}
        result["run"] = begin_run(desk, drive, identity, axis, fraction)
        text = source_text(axis.profile or drive.profile.name)
    RunFolder.of(desk.journal, result["run"]).save(result, None, text)
    desk.journal.finish(result["run"], result["status"])
    return result


def _known(result: dict[str, Any]) -> Known:
    friction = result["friction"]
    viscous = friction["viscous"]
    spread = 0.0
    if viscous["value"] is not None and viscous["low"] is not None:
        spread = Estimate(viscous["value"], viscous["low"], viscous["high"]).half_width
    return Known(
        friction["coulomb"]["value"], friction["offset"]["value"], viscous["value"], spread
    )
