"""What breaks in the middle of a record: another axis or torque, a clock, a belt that slips."""

from __future__ import annotations

import numpy as np

from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.record import Record

__all__ = ["of_jumps", "what_changed"]

Part = tuple[float, float]  # inertia and Coulomb friction of half a record

_ANOTHER = 0.1  # of the inertia: halves of a record that are not of one axis
_JUMP, _JUMP_COUNTS, _MOST_JUMPS = 3.0, 20.0, 5  # times the usual step and speed


def what_changed(parts: tuple[Part, Part], elastic: bool, effort: str) -> str:
    """What changed between the halves of a record, '' where nothing did.

    A torque that is another one scales inertia and friction alike, a clock that runs off the
    inertia alone; another axis has both of its own.
    """
    (j1, f1), (j2, f2) = parts
    if not min(j1, j2, f1, f2) > 0:
        return ""
    inertia, friction = j2 / j1, f2 / f1
    if abs(inertia - 1) < _ANOTHER:
        return ""
    told = (
        f"its second half shows an inertia {100 * (inertia - 1):+.0f} % and a friction "
        f"{100 * (friction - 1):+.0f} % from the first half's "
        f"({j1:.3g} → {j2:.3g}, {f1:.3g} → {f2:.3g} {effort})"
    )
    if abs(friction / inertia - 1) < _ANOTHER / 2:
        return told + ": the torque is not the one that was commanded: does the drive limit it?"
    if abs(friction - 1) < _ANOTHER / 2:
        return told + ": does the clock of the record run off, or was a load put on?"
    if elastic:  # or has play: its halves differ in swing
        return ""
    return told + ": a record of two axes, or an axis that was changed"


def of_jumps(record: Record, position_unit: str) -> list[Reason]:
    """Steps of the position within one sample that no torque makes."""
    steps = np.diff(record.position)
    speeds = steps / np.diff(record.time)
    usual = np.quantile(np.abs(steps), 0.99), np.quantile(np.abs(speeds), 0.99)
    odd = (np.abs(steps) > _JUMP * usual[0]) & (np.abs(speeds) > _JUMP * usual[1])
    at = np.flatnonzero(odd & (np.abs(steps) > _JUMP_COUNTS * record.resolution))
    if not len(at) or len(at) > _MOST_JUMPS:
        return []
    k = int(at[0])
    return [
        Reason(
            "position.jumps",
            Weight.CONTRADICTION,
            f"the position jumps by {steps[k]:+.3g} {position_unit} at "
            f"{record.time[k] - record.time[0]:.3g} s of the record"
            + (f", and {len(at) - 1} times more" if len(at) > 1 else "")
            + ", which no torque does: a belt or coupling that slipped, or an encoder that lost "
            "counts",
        )
    ]
