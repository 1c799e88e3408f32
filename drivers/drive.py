"""A drive is a handful of verbs, and what it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from drivers.described import Parameters
from drivers.line import Line
from drivers.preparation import Preparation
from drivers.rehearsal import Rehearsal
from drivers.sample import Sample
from drivers.scaling import Scaling
from profiles.identity import Identity
from profiles.law import Compensation, LoopGains
from profiles.procedures import Mode, Store, Watchdog
from profiles.schema import Profile

__all__ = ["Drive", "DriveSays", "StopReport", "Value"]


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


class Value(NamedTuple):
    """Value of a parameter: as the drive counts, and SI at the axis."""

    raw: int
    si: float


class DriveSays(NamedTuple):
    """What a drive says of itself at one look.

    Attributes
    ----------
    is_energised : whether it controls the axis
    in_fault : whether it reports a fault
    text : its state in words, with what it reported
    fault : fault and its code in words, or 'no fault'
    code : error code, 0: none; None: it was not told, or not asked for, since there is energy
    stranger : an error code that is none of communication, in words; ''
    """

    is_energised: bool
    in_fault: bool
    text: str
    fault: str
    code: int | None
    stranger: str


class Drive(Protocol):
    """What commissioning asks of a drive: twelve verbs, and what it is.

    Names are the profile's. Every verb raises LinkError when the drive cannot be talked to.
    """

    link: str
    cycle: float  # s, of the exchange
    in_real_time: bool  # its cycle is the clock's, and not counted
    lacking: tuple[str, ...]  # what it does not have of its profile, in words

    profile: Profile  # what it is, as a whole
    parameters: Parameters  # each of them, in SI
    scaling: Scaling
    watchdog: Watchdog
    moves: bool  # whether torque can be commanded
    tells_torque: bool  # in every cycle
    stop_time: float  # s, from a stop to rest, brake closed
    limits: Mapping[str, str]  # parameters with its own limits, by kind
    compensation: Compensation
    loops: LoopGains | None
    memory: Store | None  # how it is made to keep its parameters
    own_estimates: Mapping[str, str]  # parameters with what it has found itself
    conditions: Mapping[str, str]  # parameters with its temperatures and its time

    preparation: Preparation  # what a job will change in it
    rehearsal: Rehearsal  # its cycle, without an experiment
    line: Line  # the bus beneath

    def identity(self) -> Identity:
        """Who the drive says it is."""

    def state(self) -> DriveSays:
        """What the drive says of itself now."""

    def read(self, name: str) -> Value:
        """Value of a parameter; raises AccessDenied."""

    def write(self, name: str, raw: int) -> None:
        """Write a raw value and read it back.

        Raises WriteFailed when it is not what was written.
        """

    def store(self) -> None:
        """Make the parameters non-volatile; raises WriteFailed."""

    def reset_fault(self) -> None:
        """Acknowledge a fault; never enables."""

    def enable(self, mode: Mode, rest: float = 0.0) -> None:
        """Energise in `mode` with the set-point `rest` in force, which `stop` falls back to."""

    def disable(self) -> None:
        """De-energise an axis at rest, brake first."""

    def exchange(self, set_point: float) -> Sample:
        """Put `set_point` (SI) in force and return the first sample latched after that."""

    def wait(self, seconds: float) -> None:
        """Let time pass without a command."""

    def stop(self, hurry: Callable[[], bool] = ...) -> StopReport:
        """Make the axis safe first, then say what was reached. Never raises."""

    def close(self) -> None:
        """Give the link back."""
