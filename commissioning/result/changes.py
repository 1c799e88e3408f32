"""What is changed in a drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from commissioning.result.kinds import Finite, Raw, Text

__all__ = ["Change", "Host", "Written"]


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter of the drive, before and after.

    Attributes
    ----------
    old, new : SI at the axis; `new` is what the drive holds, after rounding; old is None where not
        read
    old_raw, new_raw : as the drive counts, in `raw_unit`
    rounded_by : what the drive's resolution took or gave, SI
    """

    parameter: Text
    new: Finite
    unit: Text
    rounded_by: Finite
    new_raw: Raw
    raw_unit: Text = ""
    old: Finite | None = None
    old_raw: Raw | None = None
    why: Text = ""


@dataclass(frozen=True, slots=True)
class Host:
    """What a master adds in every cycle where the drive has no compensation.

    That is offset + coulomb · sign(v).
    """

    parameter: Text
    address: Text
    offset: Finite
    coulomb: Finite
    unit: Text
    offset_raw: Raw
    coulomb_raw: Raw
    raw_unit: Text


@dataclass(frozen=True, slots=True)
class Written:
    """A parameter that this run changed in the drive, not back as of the last act on it.

    Attributes
    ----------
    raw, value : as the drive counts, and SI; the value is None where its scale is not known
    certain : it was read back; False: the write was cut off, the drive has this value or the old
        one
    """

    parameter: Text
    kind: Literal["compensation", "gain"]
    raw: Raw
    value: Finite | None = None
    unit: Text = ""
    certain: bool = True
