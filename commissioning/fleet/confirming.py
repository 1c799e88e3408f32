"""Who lets which axes move: nobody confirms forty motions, and nobody one that he does not see."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from commissioning.fleet.plan import Fleet, PlannedAxis
from commissioning.result.fleet import Room
from profiles.errors import Refused

__all__ = ["GOOD_FOR", "Asked", "check_in_advance", "question"]

_WRITES = {
    "identify": "Nothing is written for good.",
    "commission": "The compensation that proves to help is written and stored.",
    "verify": "The compensation of the last run is tried, and what proves to help is stored.",
}
GOOD_FOR = 900.0  # s: a confirmation of what starts within that, and is then asked again


@dataclass(frozen=True, slots=True)
class Asked:
    """A question about some axes; `word`: what is typed to let them move."""

    axes: tuple[str, ...]
    text: str
    word: str


def check_in_advance(
    fleet: Fleet, axes: Iterable[PlannedAxis], *, yes: bool, terminal: bool
) -> str | None:
    """How these axes are confirmed without a question; None: each is asked for.

    Raises Refused where nobody could be asked, or nobody may answer in advance.
    """
    real = [one.name for one in axes if one.is_real]
    if real and os.environ.get("CI") and (yes or fleet.confirm == "yes"):
        raise Refused(
            f"CI is set, and {_some(real)} would really move: nothing confirms that in advance "
            "from CI",
            code="refused.ci",
            hint='take confirm = "yes" and --yes away, and stand at the machine',
        )
    if real and fleet.confirm == "yes" and not yes:
        raise Refused(
            f'confirm = "yes" in {fleet.path} is not enough for real drives ({_some(real)})',
            code="refused.not-confirmed",
            hint='give --yes as well, or write confirm = "group"',
        )
    if real and yes and fleet.confirm != "yes":
        raise Refused(
            f"--yes is not enough for real drives ({_some(real)}): {fleet.path} says confirm = "
            f'"{fleet.confirm}"',
            code="refused.not-confirmed",
            hint='leave --yes away, or write confirm = "yes" into the file',
        )
    if yes:
        return "--yes" if fleet.confirm != "yes" else '--yes, and confirm = "yes" in the file'
    if fleet.confirm == "yes":
        return 'confirm = "yes" in the file'
    if not terminal:
        raise Refused(
            "this needs a confirmation and there is no terminal: give --yes",
            code="refused.no-terminal",
        )
    return None


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more


def _on(axis: PlannedAxis) -> str:
    return f" (on {axis.gateway})" if axis.gateway else ""


def question(
    fleet: Fleet,
    first: PlannedAxis,
    waiting: Sequence[tuple[PlannedAxis, Room]],
    seconds: float,
) -> Asked:
    """What is asked before `first` starts: of it alone, or of those of its group that soon follow.

    Parameters
    ----------
    waiting : axes that are still to start, with their room; `first` among them
    seconds : that each takes
    """
    together = [
        (axis, room)
        for axis, room in waiting
        if axis.name == first.name
        or (fleet.confirm == "group" and first.group and axis.group == first.group)
    ]
    soon = together[: max(1, int(GOOD_FOR / max(seconds, 1e-3)))]
    if all(axis.name != first.name for axis, _ in soon):
        soon = [pair for pair in together if pair[0].name == first.name]
    lines = [
        f"  '{axis.name}'{_on(axis)} up to ±{room.travel:.4g} {room.position_unit} about its "
        f"present position, with up to {room.torque:.4g} {room.effort_unit} and {room.speed:.4g} "
        f"{room.position_unit}/s"
        for axis, room in soon
    ]
    whose = f"Axes of group '{first.group}'" if len(soon) > 1 else f"Axis '{first.name}'"
    text = "\n".join(
        (
            f"{whose} will MOVE by itself:" if len(soon) == 1 else f"{whose} will MOVE, in turn:",
            *lines,
            _WRITES[fleet.job],
            "tworelay is not a safety function: keep people clear and the emergency stop in reach.",
        )
    )
    word = first.group if len(soon) > 1 and first.group else first.name
    return Asked(tuple(axis.name for axis, _ in soon), text, word)
