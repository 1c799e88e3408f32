"""May this be written? Asked in one place, and answered in one wording."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from drivers.described import Described
from profiles.parameter import Protection, Trust

__all__ = ["WhyNot", "reasons_not_written", "why_not_written"]

_FOR_GOOD = Protection.COMPENSATION, Protection.GAIN
_SETTINGS = Protection.EXPERIMENT, *_FOR_GOOD
_CHECK = (
    "check the drive's manual, and mark it verified in a copy of the profile (tworelay profile "
    "show), or in the register table (trust); derived, where other values confirm it"
)
_GEAR = (
    "give gear (motor revolutions per revolution of its output; 1 where there is none) in "
    "[mechanics] of the axis file, then measure or analyze again"
)
_BASE = "give torque_constant (N.m/A of the motor) in the axis file"


class WhyNot(NamedTuple):
    """Why something is not done: a stable name, one line, and the way out."""

    code: str
    text: str
    hint: str = ""


def why_not_written(
    what: Described,
    raw: int | None = None,
    *,
    old: int | None = None,
    kind: Protection | None = None,
    is_command: bool = False,
) -> WhyNot | None:
    """Why a parameter is not written; None: it may be.

    Parameters
    ----------
    raw : value that is to be written; None: not known yet
    old : value that is there, where it must be possible to go back to it
    kind : the protection that it must have
    is_command : it belongs to what commands the drive, and is put back like a setting
    """
    return next(reasons_not_written(what, raw, old, kind, is_command=is_command), None)


def reasons_not_written(
    what: Described,
    raw: int | None,
    old: int | None,
    kind: Protection | None = None,
    *,
    is_command: bool = False,
) -> Iterator[WhyNot]:
    """Every reason, the weightiest first."""
    says, name = what.parameter, f"'{what.name}'"
    by = f"in profile '{what.profile}'"
    if kind is not None and says.protection is not kind and not is_command:
        yield WhyNot("write.kind", f"{name} is no {kind} parameter {by}: it was left as it is")
    if says.protection not in _SETTINGS and not is_command:
        yield WhyNot(
            "write.protected", f"{name} has protection '{says.protection}' {by}: it is not written"
        )
    if says.protection in _FOR_GOOD:
        at = f"{name} ({what.address})"
        if says.trust is Trust.UNVERIFIED:
            yield WhyNot("write.unverified", f"{at} is unverified {by}", _CHECK)
        if what.doubtful_base:
            yield WhyNot(
                "write.base",
                f"{at} is a current, and the rated current ({what.doubtful_base}) is unverified "
                f"{by}",
                _BASE,
            )
        if what.lacks_gear:
            yield WhyNot(
                "write.gear",
                f"{at} counts at the output of the gear {by}, and its ratio is not said",
                _GEAR,
            )
    low, high = says.range
    if raw is not None and not says.allows(raw):
        yield WhyNot("write.range", f"{name}: raw value {raw} is not allowed ({low:g}…{high:g})")
    if old is None:
        return
    if not says.allows(old):
        yield WhyNot(
            "write.no-way-back",
            f"{name} reads {old}, which is not allowed to be written back {by} ({low:g}…{high:g}): "
            "it was left as it is",
        )
    step = 0.0 if raw is None else abs(says.number(raw) - says.number(old))
    if says.largest_step is not None and step > says.largest_step:
        yield WhyNot(
            "write.step",
            f"{name}: the step from {old} to {raw} is larger than the {says.largest_step} that is "
            f"allowed at once {by}; nothing was written",
        )
