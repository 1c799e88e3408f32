"""The result of a run: what was found, what was changed, and how it ended.

Frozen; changed by `replace`.

SI units at the axis, named in `Units`. What was not measured is None, never 0. `codec` reads and
writes it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Final, Literal

from pydantic import ConfigDict

from commissioning.identification.reasons import Reason, Verdict
from commissioning.result.changes import Change, Host, Written
from commissioning.result.endings import Ending, Error
from commissioning.result.experiment import Conditions, Experiment
from commissioning.result.found import CriticalPoints, DriveTrain, Found, Quantity, Units
from commissioning.result.kinds import Text
from commissioning.result.readings import Methods
from commissioning.result.worth import GainSet, Verification
from profiles.errors import Status
from profiles.identity import Identity

__all__ = ["SCHEMA", "ProfileMark", "Quality", "RunResult", "Tool"]

SCHEMA: Final = "tworelay.run/2"


@dataclass(frozen=True, slots=True)
class Tool:
    """What made the result."""

    name: Text
    version: Text


@dataclass(frozen=True, slots=True)
class ProfileMark:
    """The profile that the drive was used by; `hash`: SHA-256 of its content."""

    name: Text
    version: Text
    hash: Text


@dataclass(frozen=True, slots=True)
class Quality:
    """How far the numbers can be trusted.

    The verdict is None where nothing was measured to its end.
    """

    verdict: Verdict | None = None
    reasons: tuple[Reason, ...] = ()

    def has(self, code: str) -> bool:
        """Whether one of the reasons has this code, or a longer one that begins so."""
        return any(f"{reason.code}.".startswith(f"{code}.") for reason in self.reasons)


@dataclass(frozen=True, slots=True)
class RunResult:
    """A run, from its header to its ending.

    Attributes
    ----------
    status : of the measurement, and of what was last done with it
    began, ended : ISO 8601 with zone; of the run, and of the last act on it
    host, operator : computer and user
    run : None where no run was begun
    link, profile, identity : None for a recording
    compensation : the proposal, or what stayed after its proof
    host_compensation : what the master has to do instead
    written : what this run has left in the drive
    conditions : what friction depends on beside wear, when it was measured
    notes : what else is to be told
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        strict=True, extra="ignore", allow_inf_nan=False
    )

    schema: Literal["tworelay.run/2"]
    status: Status
    axis: Text
    units: Units
    tool: Tool | None = None
    host: Text | None = None
    operator: Text | None = None
    began: Text | None = None
    ended: Text | None = None
    run: Text | None = None
    link: Text | None = None
    profile: ProfileMark | None = None
    identity: Identity | None = None
    friction: Found = field(default_factory=Found)
    mechanics: DriveTrain | None = None
    methods: Methods = field(default_factory=Methods)
    critical_point: CriticalPoints | None = None
    tuning: tuple[GainSet, ...] = ()
    compensation: tuple[Change, ...] = ()
    host_compensation: Host | None = None
    written: tuple[Written, ...] = ()
    verification: Verification | None = None
    experiment: Experiment | None = None
    conditions: Conditions | None = None
    quality: Quality = field(default_factory=Quality)
    ending: Ending | None = None
    error: Error | None = None
    notes: tuple[Text, ...] = ()

    @property
    def measured(self) -> bool:
        """Whether the run gave numbers that something can be made of."""
        return self.quality.verdict not in (None, "rejected")

    @property
    def coulomb(self) -> Quantity | None:
        """Coulomb friction, where the run measured one that can be trusted."""
        return self.friction.coulomb if self.quality.verdict in ("good", "usable") else None

    def of_loop(self, loop: str) -> list[GainSet]:
        """The sets of gains for one of LOOPS."""
        return [one for one in self.tuning if one.loop == loop]

    def wrote(self, changes: tuple[Change, ...]) -> bool:
        """Whether these values are in the drive, by this run."""
        there = {one.parameter: one.raw for one in self.written if one.certain}
        return bool(changes) and all(there.get(c.parameter) == c.new_raw for c in changes)
