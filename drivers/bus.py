"""What a driver gives for the verbs of a drive to be made of.

Raw access by address, and the cycle.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

from profiles.address import Address
from profiles.commands import SET
from profiles.identity import Identity

if TYPE_CHECKING:
    from drivers.serial_port import SerialPort, Stream

__all__ = ["GUARDS", "SET", "Bus", "Exchange", "StopFrames"]

GUARDS = 4  # signs of life within the time-out of a drive's watchdog


@dataclass(frozen=True, slots=True)
class StopFrames:
    """What stops a drive on a port that has one owner: bytes, and how long to wait after each, s.

    The port by its open descriptor, where that can be inherited, and by what opens it, where it is
    serial.
    """

    descriptor: int | None
    frames: tuple[tuple[bytes, float], ...]
    port: SerialPort | None = None


class Exchange(NamedTuple):
    """One cyclic exchange, raw: the values of the profile's `cycle.in`, the times in s.

    `in_force` are the values of `cycle.out` that acted until the feedback was latched, and `sent`
    is when they left.
    """

    values: tuple[int, ...]
    in_force: tuple[int, ...]
    sent: float
    time: float
    lateness: float
    missed: int


class Bus(Protocol):
    """What a driver implements: raw access by address, and the cycle.

    `read` and `write` raise LinkError, or AccessDenied (WriteDenied) when the drive answers with a
    refusal.
    """

    cycle: float
    in_real_time: bool
    lacking: tuple[str, ...]  # what the drive does not have of its profile, in words

    def identify(self) -> Identity:
        """Ask the drive who it is."""

    def read(self, address: Address) -> int:
        """Raw value."""

    def write(self, address: Address, raw: int) -> None:
        """Write a raw value and wait for the acknowledgement."""

    def post(self, address: Address, raw: int) -> None:
        """Write without waiting for anything, by every way the bus has. For the stop path."""

    def descriptor(self) -> int | None:
        """Descriptor of the port, where it has one owner; None: others connect by themselves."""

    def port(self) -> SerialPort | None:
        """The serial port, where there is one."""

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on.

        None: through nothing, yet.
        """

    def frame(self, address: Address, raw: int) -> bytes:
        """What is written to the port for `post`."""

    def changes(self) -> dict[str, tuple[int, int]]:
        """Objects of the bus' own that `start` changes in the drive.

        What is there, and what will be.
        """

    def put_back(self, old: dict[str, int]) -> bool:
        """Write back what `changes` named; the cycle ends with it. False: all was as before."""

    def start(self, idle: tuple[int, ...]) -> None:
        """Make the cycle ready; `idle` are the raw values of `cycle.out` that do nothing."""

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        """Send the raw values of `cycle.out`, get those of `cycle.in`; paced to the cycle."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""

    def now(self) -> float:
        """Time of the cycle's clock, s."""

    def answering_within(self, seconds: float) -> AbstractContextManager[None]:
        """Requests meanwhile may take so long to be answered, if that is more than usual."""

    def own_address(self) -> str:
        """IP address by which the drive knows this computer, or ''."""

    def other_master(self) -> str:
        """What another master sent on the same bus, or ''."""

    def refused_posts(self) -> list[tuple[Address, int]]:
        """Posts that the drive has refused for now, since this was asked last."""

    def trouble(self) -> str:
        """Last thing that the drive reported by itself (an emergency), or ''."""

    def close(self) -> None:
        """Put back what the bus changed in the drive, and let go."""
