"""Friction estimate → parameter changes, by the drive's own law."""

from __future__ import annotations

from commissioning.result.changes import Change, Host
from commissioning.result.found import Found
from drivers.described import Described, Parameters
from drivers.errors import WriteFailed
from drivers.writing import reasons_not_written
from profiles.law import Amount, Compensation, TermValue

__all__ = ["host_terms", "propose"]

DEFAULT_FRACTION = 0.85  # over-compensation makes an axis hunt
_LEAST_TRUST = 0.3  # relative half-width above which viscous friction is not written


def propose(
    law: Compensation,
    parameters: Parameters,
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
    if not law.terms or found.coulomb is None:
        return []
    viscous, offset = found.viscous, found.offset
    known = viscous is not None and (bool(law.table) or viscous.half_width <= _LEAST_TRUST)
    amount = Amount(
        fraction * found.coulomb.value,
        offset.value if offset else None,
        fraction * max(viscous.value, 0.0) if viscous and known else None,
        f"{fraction * 100:g} %",
        parameters.motor_speed,
    )
    return [
        _change(parameters[name], wanted, old_raw[name])
        for name, wanted in law.values(amount).items()
    ]


def host_terms(
    law: Compensation, parameters: Parameters, found: Found, fraction: float = DEFAULT_FRACTION
) -> Host | None:
    """What the master of a drive without a compensation of its own adds; None: not this drive."""
    if law.host is None or found.coulomb is None:
        return None
    what = parameters[law.host]
    offset = found.offset.value if found.offset else 0.0
    coulomb = fraction * found.coulomb.value
    return Host(
        what.name, what.address, offset, coulomb, what.unit, what.raw(offset), what.raw(coulomb),
        what.raw_unit,
    )  # fmt: skip


def _change(what: Described, wanted: TermValue, old: int) -> Change:
    raw = what.checked_raw(wanted.value)
    for refused in reasons_not_written(what, raw, old):
        if refused.code == "write.step":
            raise WriteFailed(refused.text, code=refused.code, parameter=what.name)
    held = what.si(raw)
    return Change(
        what.name, held, what.unit, held - wanted.value, raw, what.raw_unit, what.si(old), old,
        wanted.why,
    )  # fmt: skip
