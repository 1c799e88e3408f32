"""Raw values of a drive by the names of its profile, asked for with patience."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.bus import Bus
from drivers.errors import AccessDenied, NoAnswer, WriteFailed
from drivers.patience import patiently
from profiles.errors import UnknownName
from profiles.parameter import Access, Parameter
from profiles.schema import Profile

__all__ = ["POLL", "RawAccess"]

POLL = 0.005  # s between two looks at a state
_BUSY = 0.05  # s until a busy drive is asked again

T = TypeVar("T")


class RawAccess:
    """What is read from, and written to, the drive on `bus` that `profile` describes."""

    def __init__(self, bus: Bus, profile: Profile) -> None:
        self.bus = bus
        self.profile = profile

    def parameter(self, name: str) -> Parameter:
        """What the profile says of a parameter; raises UnknownName."""
        try:
            return self.profile.parameters[name]
        except KeyError:
            known = list(self.profile.parameters)
            raise UnknownName(f"parameter in {self.profile}", name, known) from None

    def read(self, name: str) -> int:
        """Raw value of a parameter; raises LinkError, AccessDenied."""
        parameter = self.parameter(name)
        if parameter.access is Access.WRITE_ONLY:
            raise WriteFailed(
                f"'{name}' ({parameter.address}) can only be written",
                code="read.write-only",
                parameter=name,
            )
        try:
            return self.patiently(lambda: self.bus.read(parameter.address))
        except AccessDenied as error:
            raise AccessDenied(f"'{name}': {error}", busy=error.busy) from None

    def optional(self, name: str) -> int | None:
        """Raw value of what not every drive has; None where this one has it not.

        Raises LinkError.
        """
        if name not in self.profile.parameters:
            return None
        try:
            return self.read(name)
        except AccessDenied as error:
            if error.busy:
                raise
            return None

    def write(self, name: str, raw: int) -> None:
        """Write a raw value, unseen; raises LinkError, WriteDenied."""
        address = self.parameter(name).address
        self.patiently(lambda: self.bus.write(address, raw))

    def write_surely(self, name: str, raw: int) -> None:
        """Write a raw value whose answer may be lost; raises LinkError, WriteDenied.

        What stands there tells whether it came. Once that is known nothing is on its way any more,
        and it is sent once more: to a drive without energy, or a setting.
        """
        try:
            self.write(name, raw)
        except NoAnswer:
            if self.parameter(name).access is Access.WRITE_ONLY:
                raise
            if self.read(name) != raw:
                self.write(name, raw)

    def verify(self, name: str, raw: int) -> None:
        """See that the drive took a raw value; raises WriteFailed, LinkError."""
        parameter = self.parameter(name)
        if parameter.access is Access.WRITE_ONLY:
            return
        there = self.patiently(lambda: self.bus.read(parameter.address))
        if there != raw:
            raise WriteFailed(
                f"'{name}' ({parameter.address}) reads back {there} after {raw} was written: "
                "the drive did not take it",
                code="write.not-taken",
                parameter=name,
                value=there,
                wanted=raw,
            )

    def patiently(self, action: Callable[[], T], patience: float | None = None) -> T:
        """What `action` gives, asked again while the drive says that it is busy.

        `patience` : s; default: the link's
        """
        longest = self.profile.link.patience if patience is None else patience
        return patiently(action, longest, lambda: self.pause(_BUSY))

    def pause(self, seconds: float) -> float:
        """Let time pass; says how much, s."""
        self.bus.wait(seconds)
        return seconds

    def comes(self, sign: Callable[[], bool], patience: float) -> bool:
        """Whether `sign` is given within `patience` s."""
        until = self.bus.now() + patience
        while not sign():
            if self.bus.now() >= until:
                return False
            self.bus.wait(POLL)
        return True
