"""Friction estimate → parameter changes, by the drive's own law."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.scaling import Scaling
from profiles.errors import WriteFailed
from profiles.schema import Profile, Unit

__all__ = ["Change", "HostTerms", "Known", "host_terms", "propose"]

DEFAULT_FRACTION = 0.85  # over-compensation makes an axis hunt
_LEAST_TRUST = 0.3  # relative half-width above which viscous friction is not written


@dataclass(frozen=True, slots=True)
class Known:
    """What the compensation is made from; None: not measured.

    Attributes
    ----------
    coulomb, offset : N.m or N
    viscous : N.m.s/rad or N.s/m
    viscous_uncertainty : relative half-width of its interval
    """

    coulomb: float
    offset: float | None
    viscous: float | None = None
    viscous_uncertainty: float = 0.0


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter, before and after.

    Attributes
    ----------
    parameter : name in the profile
    old, new : SI at the axis; `new` is what the drive will hold, after rounding
    old_raw, new_raw : as the drive counts
    unit, raw_unit : of them
    wanted : SI, before rounding
    why : one line
    """

    parameter: str
    old: float
    new: float
    old_raw: int
    new_raw: int
    unit: str
    raw_unit: str
    wanted: float
    why: str

    @property
    def rounded_by(self) -> float:
        """What the drive's resolution took or gave, SI."""
        return self.new - self.wanted


def propose(
    profile: Profile,
    scaling: Scaling,
    known: Known,
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
    friction = fraction * known.coulomb
    wanted: dict[str, tuple[float, str]] = {}
    if not law.terms:
        return []
    if law.offset is not None and known.offset is not None:
        wanted[law.offset] = (known.offset, "the whole offset (load, and friction's asymmetry)")
    if law.positive is not None and law.negative is not None:
        wanted[law.positive] = (friction, f"{share} of the Coulomb friction")
        wanted[law.negative] = (law.negative_sign * friction, f"{share} of the Coulomb friction")
    if law.gain is not None:
        wanted[law.gain] = (friction, f"{share} of the Coulomb friction")
    if (
        law.viscous is not None
        and known.viscous is not None
        and known.viscous_uncertainty <= _LEAST_TRUST
    ):
        wanted[law.viscous] = (
            fraction * max(known.viscous, 0.0),
            f"{share} of the viscous friction",
        )
    viscous = fraction * max(known.viscous or 0.0, 0.0)
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


@dataclass(frozen=True, slots=True)
class HostTerms:
    """What a master adds in every cycle: offset + coulomb * sign(v), SI at the axis and as the drive counts.

    Attributes
    ----------
    parameter, address : of the torque offset
    offset, coulomb : N.m or N
    offset_raw, coulomb_raw : steps of the drive, `raw_unit` each
    """

    parameter: str
    address: str
    offset: float
    coulomb: float
    unit: str
    offset_raw: int
    coulomb_raw: int
    raw_unit: str


def host_terms(
    profile: Profile, scaling: Scaling, known: Known, fraction: float = DEFAULT_FRACTION
) -> HostTerms | None:
    """What the master of a drive without a compensation of its own adds; None: that is not this drive."""
    name = profile.compensation.host
    if name is None:
        return None
    parameter = profile.parameters[name]
    offset, coulomb = known.offset or 0.0, fraction * known.coulomb
    return HostTerms(
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
    return Change(
        name,
        scaling.to_si(parameter, old),
        scaling.to_si(parameter, raw),
        old,
        raw,
        scaling.unit_text(parameter),
        scaling.raw_unit(parameter),
        value,
        why,
    )
