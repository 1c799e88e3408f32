"""A value of the drive by name: its unit, its range, and who may write it."""

from __future__ import annotations

import struct
from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Tag, model_validator

from profiles.address import (
    _LARGEST_F32,
    FLOAT,
    CanopenAddress,
    MailboxAddress,
    ModbusAddress,
    kind_of_address,
)
from profiles.strict import Strict

__all__ = ["Access", "Parameter", "Protection", "Trust", "Unit"]


class Unit(StrEnum):
    """What a raw value times its scale is measured in, before the drive's own bases are applied."""

    NONE = "1"
    RATED_TORQUE = "rated"  # share of the rated torque
    RATED_TORQUE_PER_SPEED = "rated/(rad/s)"
    TORQUE = "N.m"
    TORQUE_PER_SPEED = "N.m/(rad/s)"
    STIFFNESS = "N.m/rad"
    CURRENT = "A"  # of the motor; a torque by its torque constant
    REVOLUTION = "rev"
    INCREMENT = "increment"  # of the position encoder
    INCREMENT_PER_SECOND = "increment/s"
    SPEED = "rad/s"
    RPM = "rpm"
    RATED_TORQUE_PER_SECOND = "rated/s"
    PER_SECOND = "1/s"
    SECOND = "s"
    MINUTE = "min"
    DEGREE_CELSIUS = "degC"


class Access(StrEnum):
    """What the drive lets a master do with a parameter."""

    READ_ONLY = "ro"
    READ_WRITE = "rw"
    WRITE_ONLY = "wo"


class Protection(StrEnum):
    """What tworelay may do with a parameter."""

    READ = "read"  # never written
    COMMAND = "command"  # control and set-point: written by the drive's verbs only
    EXPERIMENT = "experiment"  # set for an experiment, put back after it
    COMPENSATION = "compensation"  # what `apply` writes
    GAIN = "gain"  # of a loop: what `apply --gains` writes
    MAINTENANCE = "maintenance"  # store, simulation clock: by its own procedure only


class Trust(StrEnum):
    """How far the statement about a parameter can be trusted."""

    VERIFIED = "verified"
    DERIVED = "derived"
    UNVERIFIED = "unverified"


class Parameter(Strict):
    """One parameter of the drive.

    The value in SI is its number times `scale`, times what `unit` stands for in this drive; the
    number is the raw value, or of an f32 the one whose bits the raw value has. `minimum`, `maximum`
    and `largest_step` are numbers, `forbidden` lists raw values that must never be written.
    """

    address: Annotated[
        Annotated[CanopenAddress, Tag("canopen")]
        | Annotated[ModbusAddress, Tag("modbus")]
        | Annotated[MailboxAddress, Tag("mailbox")],
        Discriminator(kind_of_address),
    ]
    title: str
    unit: Unit = Unit.NONE
    scale: float = 1.0
    minimum: int | float | None = None
    maximum: int | float | None = None
    forbidden: tuple[int, ...] = ()
    largest_step: int | None = None
    access: Access = Access.READ_WRITE
    protection: Protection = Protection.READ
    trust: Trust = Trust.UNVERIFIED
    nonvolatile: bool = False
    side: Literal["motor", "output"] = "motor"  # of the gear, where a speed or a torque is meant
    source: str = ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.scale == 0:
            raise ValueError("scale is 0: must be the value of one raw step")
        whole = isinstance(self.minimum, int | None) and isinstance(self.maximum, int | None)
        if not self.is_float and not whole:
            raise ValueError(f"minimum and maximum of a {self.address.type} are whole numbers")
        low, high = (-_LARGEST_F32, _LARGEST_F32) if self.is_float else self.address.raw_range
        lo, hi = self.range
        if lo > hi:
            raise ValueError(f"range is upside down: minimum {lo}, maximum {hi}")
        if lo < low or hi > high:
            raise ValueError(
                f"range {lo}…{hi} does not fit type {self.address.type} ({low:g}…{high:g})"
            )
        if self.access is Access.READ_ONLY and self.protection is not Protection.READ:
            raise ValueError(
                f"access 'ro' and protection '{self.protection}' contradict each other"
            )
        return self

    @property
    def is_float(self) -> bool:
        """Whether raw values are the bits of an IEEE 754 number."""
        return self.address.type == FLOAT

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest number that may be written."""
        low, high = (-_LARGEST_F32, _LARGEST_F32) if self.is_float else self.address.raw_range
        return (
            low if self.minimum is None else self.minimum,
            high if self.maximum is None else self.maximum,
        )

    def number(self, raw: float) -> float:
        """The number that a raw value stands for."""
        if not self.is_float:
            return raw
        value: float = struct.unpack("<f", struct.pack("<I", raw))[0]
        return value

    def nearest_raw(self, number: float) -> int:
        """The raw value of a number, or of the nearest one that the drive can hold."""
        if not self.is_float:
            return round(number)
        clipped = max(-_LARGEST_F32, min(_LARGEST_F32, number))
        raw: int = struct.unpack("<I", struct.pack("<f", clipped))[0]
        return raw

    def allows(self, raw: int) -> bool:
        """Whether a raw value may be written."""
        low, high = self.range
        return low <= self.number(raw) <= high and raw not in self.forbidden
