"""A drive is a handful of verbs; a bus is what a driver gives to make them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

from drivers.sample import Sample
from drivers.scaling import Scaling
from profiles.address import Address
from profiles.commands import SET
from profiles.identity import Identity
from profiles.procedures import Mode
from profiles.schema import Profile

if TYPE_CHECKING:
    from drivers.serial_port import SerialPort, Stream

__all__ = ["GUARDS", "SET", "Bus", "Drive", "Exchange", "StopFrames", "StopReport"]

GUARDS = 4  # signs of life within the time-out of a drive's watchdog


@dataclass(frozen=True, slots=True)
class StopReport:
    """What the stop path reached.

    `deenergised` and `reason` are as read from the drive after the stop; None: it did not answer.
    """

    deenergised: bool | None
    failures: tuple[str, ...] = ()

    def __str__(self) -> str:
        state = {
            True: "axis stopped and de-energised",
            False: "the drive is STILL ENERGISED: use the emergency stop",
            None: "stop was sent but the drive does not answer: it is NOT verified that the axis "
            "is at rest; use the emergency stop",
        }[self.deenergised]
        return "; ".join([state, *self.failures[:1]])


@dataclass(frozen=True, slots=True)
class StopFrames:
    """What stops a drive on a port that has one owner: bytes, and how long to wait after each, s.

    The port by its open descriptor, where that can be inherited, and by what opens it, where it is serial.
    """

    descriptor: int | None
    frames: tuple[tuple[bytes, float], ...]
    port: SerialPort | None = None


class Drive(Protocol):
    """What commissioning asks of a drive. Names are the profile's, values SI at the axis.

    Every verb raises LinkError when the drive cannot be talked to.
    """

    profile: Profile
    scaling: Scaling
    link: str
    cycle: float
    in_real_time: bool  # its cycle is the clock's, and not counted

    dispensable: frozenset[str]  # parameters that are set where the drive takes them
    lacking: tuple[str, ...]  # what it does not have of its profile, in words

    def identity(self) -> Identity:
        """Who the drive says it is."""

    def read(self, name: str) -> float:
        """Value of a parameter, SI."""

    def write(self, name: str, value: float) -> None:
        """Write and read back; raises WriteFailed when it is not what was written."""

    def read_raw(self, name: str) -> int:
        """Value of a parameter as the drive counts."""

    def write_raw(self, name: str, raw: int) -> None:
        """Write a raw value and read it back; raises WriteFailed."""

    def watchdog_settings(self) -> dict[str, int]:
        """Raw value of each parameter that arms the drive-side watchdog."""

    def status_text(self) -> str:
        """State of the drive in words, with what it reported."""

    def is_energised(self) -> bool:
        """Whether the drive controls the axis."""

    def other_master(self) -> str:
        """What another master sent on the same bus, or ''."""

    def in_fault(self) -> bool:
        """Whether the drive reports a fault."""

    def fault_text(self) -> str:
        """Fault and its code in words, or 'no fault'."""

    def fault_of_another_kind(self) -> str:
        """An error code that is none of communication, in words; ''."""

    def reset_fault(self) -> None:
        """Acknowledge a fault; never enables."""

    def check_requirements(self) -> None:
        """Look whether the drive is set up as its profile requires; raises PreflightRefused."""

    def mode_codes(self) -> list[int]:
        """Values of `mode_of_operation` that a job may set, in the order in which it may leave them."""

    def exclusive_access(self) -> dict[str, int]:
        """Raw value of the parameter that locks other masters out, where the drive has one."""

    def preparations(self, mode: Mode) -> dict[str, int]:
        """Raw value of each parameter that `mode` needs set before it is enabled."""

    def check_set_points(self, mode: Mode, largest: float) -> None:
        """Raises PreflightRefused where ±`largest` (SI) does not fit the set-point of `mode`."""

    def power_changes(self) -> dict[str, tuple[int, ...]]:
        """Raw values that energising, stopping and the way back write to parameters that are put back."""

    def bus_changes(self) -> dict[str, tuple[int, int]]:
        """Objects of the bus' own that the cycle changes in the drive: what is there, and what will be."""

    def put_back_bus(self, old: dict[str, int]) -> bool:
        """Write back what `bus_changes` named. False: all was as before."""

    def store(self) -> None:
        """Make the parameters non-volatile; raises WriteFailed."""

    def enable(self, mode: Mode, rest: float = 0.0) -> None:
        """Energise in `mode` with the set-point `rest` in force, which `stop` falls back to."""

    def disable(self) -> None:
        """De-energise an axis at rest, brake first."""

    def exchange(self, set_point: float) -> Sample:
        """Put `set_point` in force and return the first sample latched after that."""

    def wait(self, seconds: float) -> None:
        """Let time pass without a command."""

    def refuse_rehearsal(self) -> None:
        """Raises PreflightRefused where the cycle must not be exchanged without an experiment."""

    def rehearse(self, count: int) -> Iterator[Exchange]:
        """`count` cycles of the exchange with every output at zero; the drive stays de-energised."""

    def stop_frames(self) -> StopFrames | None:
        """What another process writes to our port to stop the drive; None: it connects by itself."""

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on; None: through nothing, yet."""

    def stop(self, hurry: Callable[[], bool] = ...) -> StopReport:
        """Make the axis safe first, then say what was reached. Never raises."""

    def close(self) -> None:
        """Give the link back."""


class Exchange(NamedTuple):
    """One cyclic exchange, raw: the values of the profile's `cycle.in`, the times in s.

    `in_force` are the values of `cycle.out` that acted until the feedback was latched, and `sent` is
    when they left.
    """

    values: tuple[int, ...]
    in_force: tuple[int, ...]
    sent: float
    time: float
    lateness: float
    missed: int


class Bus(Protocol):
    """What a driver implements: raw access by address, and the cycle.

    `read` and `write` raise LinkError, or AccessDenied (WriteDenied) when the drive answers with a refusal.
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
        """Of the port, where it has one owner; None: others connect by themselves."""

    def port(self) -> SerialPort | None:
        """The serial port, where there is one."""

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on; None: through nothing, yet."""

    def frame(self, address: Address, raw: int) -> bytes:
        """What is written to the port for `post`."""

    def changes(self) -> dict[str, tuple[int, int]]:
        """Objects of the bus' own that `start` changes in the drive: what is there, and what will be."""

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

    def other_master(self) -> str:
        """What another master sent on the same bus, or ''."""

    def refused_posts(self) -> list[tuple[Address, int]]:
        """Posts that the drive has refused for now, since this was asked last."""

    def trouble(self) -> str:
        """Last thing that the drive reported by itself (an emergency), or ''."""

    def close(self) -> None:
        """Put back what the bus changed in the drive, and let go."""
