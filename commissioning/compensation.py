"""Friction estimate → parameter changes, by the drive's own law."""

from __future__ import annotations

from commissioning.result.changes import Change, Host
from commissioning.result.found import Found
from drivers.errors import WriteFailed
from drivers.scaling import Scaling
from profiles.parameter import Unit
from profiles.schema import Profile

__all__ = ["host_terms", "propose"]

DEFAULT_FRACTION = 0.85  # over-compensation makes an axis hunt
_LEAST_TRUST = 0.3  # relative half-width above which viscous friction is not written


def propose(
    profile: Profile,
    scaling: Scaling,
    found: Found,
    old_raw: dict[str, int],
    fraction: float = DEFAULT_FRACTION,
) -> list[Change]:
    """Changes that compensate `fraction` of the friction and the whole offset.

    Parameters
    ----------
    old_raw : present raw value of every parameter of the law

    Raises
    ------
    WriteFailed
        A value lies outside the drive's range.
    """
    law = profile.compensation
    share = f"{fraction * 100:g} %"
    wanted: dict[str, tuple[float, str]] = {}
    if not law.terms or found.coulomb is None:
        return []
    friction = fraction * found.coulomb.value
    if law.offset is not None and found.offset is not None:
        wanted[law.offset] = (
            found.offset.value,
            "the whole offset (load, and friction's asymmetry)",
        )
    if law.positive is not None and law.negative is not None:
        wanted[law.positive] = (friction, f"{share} of the Coulomb friction")
        wanted[law.negative] = (law.negative_sign * friction, f"{share} of the Coulomb friction")
    if law.gain is not None:
        wanted[law.gain] = (friction, f"{share} of the Coulomb friction")
    if (
        law.viscous is not None
        and found.viscous is not None
        and found.viscous.half_width <= _LEAST_TRUST
    ):
        wanted[law.viscous] = (
            fraction * max(found.viscous.value, 0.0),
            f"{share} of the viscous friction",
        )
    viscous = fraction * max(found.viscous.value, 0.0) if found.viscous else 0.0
    for point in law.table:
        speed = point.at * scaling.step_of(Unit.SPEED)
        wanted[point.speed] = (speed, "speed of a point of the table")
        wanted[point.torque] = (
            friction + viscous * speed,
            f"{share} of the friction at that speed",
        )
    if law.points is not None:
        wanted[law.points] = (float(len(law.table)), "points of the table")
    return [
        _change(profile, scaling, name, value, old_raw[name], why)
        for name, (value, why) in wanted.items()
    ]


def host_terms(
    profile: Profile, scaling: Scaling, found: Found, fraction: float = DEFAULT_FRACTION
) -> Host | None:
    """What the master of a drive without a compensation of its own adds; None: that is not this drive."""
    name = profile.compensation.host
    if name is None or found.coulomb is None:
        return None
    parameter = profile.parameters[name]
    offset = found.offset.value if found.offset else 0.0
    coulomb = fraction * found.coulomb.value
    return Host(
        name, str(parameter.address), offset, coulomb, scaling.unit_text(parameter),
        scaling.to_raw(parameter, offset), scaling.to_raw(parameter, coulomb), scaling.raw_unit(parameter),
    )  # fmt: skip


def _change(
    profile: Profile, scaling: Scaling, name: str, value: float, old: int, why: str
) -> Change:
    parameter = profile.parameters[name]
    raw = scaling.checked_raw(name, parameter, value)
    step = abs(parameter.number(raw) - parameter.number(old))
    if parameter.largest_step is not None and step > parameter.largest_step:
        raise WriteFailed(
            f"'{name}': the step from {old} to {raw} is larger than the {parameter.largest_step} "
            f"that profile '{profile.name}' allows at once; nothing was written"
        )
    held = scaling.to_si(parameter, raw)
    return Change(
        name,
        held,
        scaling.unit_text(parameter),
        held - value,
        raw,
        scaling.raw_unit(parameter),
        scaling.to_si(parameter, old),
        old,
        why,
    )
