"""What the experiments of a method have shown, before it becomes a result."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, cast

import numpy as np

from commissioning.identification.critical_point import CriticalPoint, Lag
from commissioning.identification.estimate import Estimate
from commissioning.identification.limit_cycle import LimitCycle
from commissioning.identification.lock_in import LockIn
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.output_error import OutputErrorEstimate
from commissioning.identification.phase_locked import PhaseLocked
from commissioning.identification.reading import Explained
from commissioning.identification.reasons import Reason
from commissioning.identification.record import Record
from commissioning.identification.two_relay import FrictionEstimate
from commissioning.result.readings import MethodName
from commissioning.rig.ready import Ready

__all__ = ["Estimates", "Measured", "Oscillation", "Wished"]


class Estimates(Protocol):
    """What every method gives, N.m or N."""

    @property
    def coulomb(self) -> Estimate:
        """Coulomb friction."""

    @property
    def offset(self) -> Estimate:
        """Offset of the torque."""


@dataclass(frozen=True, slots=True)
class Oscillation:
    """One oscillation for the report.

    Attributes
    ----------
    name : for people
    cycle : its limit cycle; a hysteresis of nan where no relay made it
    span : begin and end, s
    """

    name: str
    cycle: LimitCycle
    span: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Wished:
    """A point at a phase that is wanted.

    Attributes
    ----------
    point : None where the axis has none, or where it is not known
    travel : that measuring it takes, on either side of the start, rad or m; None: not known
    why_not : why it was not measured, or is not there; '' where it was
    """

    point: CriticalPoint | None
    travel: float | None
    why_not: str


@dataclass
class Measured:
    """What was found, and by what.

    Attributes
    ----------
    ready : the axis as the oscillations were chosen for it
    relay : limit cycle of the relay at d1
    shown : one oscillation at d1 and one at d2
    record : what the chosen method read
    spans : begin and end of the stretches of it that were read, s; () : all of it
    by : what each method that was run has found
    preferred : the method whose numbers are better here; None: the finest that was run
    corrected, second : the plant read from the phasors of the relay's limit cycle, and of an
        oscillation of another amplitude at the same frequency
    points : the plant at the phases that tuning rules ask for
    """

    ready: Ready
    relay: LimitCycle
    shown: tuple[Oscillation, Oscillation]
    record: Record
    periods: int
    tests: int = 1
    by: dict[MethodName, Estimates] = field(default_factory=dict)
    preferred: MethodName | None = None
    spans: tuple[tuple[float, float], ...] = ()
    corrected: CriticalPoint | None = None
    second: CriticalPoint | None = None
    points: dict[str, Wished] = field(default_factory=dict)
    reasons: list[Reason] = field(default_factory=list)

    @property
    def method(self) -> MethodName:
        """The method that gives the numbers."""
        if self.preferred is not None:
            return self.preferred
        finest_first = [name for name in MethodName if name in self.by]
        of_another_law = [MethodName.OUTPUT_ERROR] if self.positions is None else []
        return next((n for n in finest_first if n not in of_another_law), finest_first[0])

    @property
    def found(self) -> Estimates:
        """Result of that method."""
        return self.by[self.method]

    @property
    def modulating(self) -> ModulatingEstimate | None:
        """What modulating functions have found."""
        return cast("ModulatingEstimate | None", self.by.get(MethodName.MODULATING))

    @property
    def output_error(self) -> OutputErrorEstimate | None:
        """What output error has found."""
        return cast("OutputErrorEstimate | None", self.by.get(MethodName.OUTPUT_ERROR))

    @property
    def positions(self) -> OutputErrorEstimate | None:
        """What output error has found, where that explains the positions."""
        found = self.output_error
        return found if found is not None and found.is_explained else None

    @property
    def lag(self) -> Lag:
        """What of the dead time is a lag of the torque, as far as that is known."""
        found = self.positions
        return Lag() if found is None else Lag(found.lag.value, found.period)

    @property
    def explained(self) -> Explained | None:
        """The law that explains the axis; None where no method has one."""
        return Explained.of(self.output_error) or Explained.of(self.modulating)

    @property
    def lock_in(self) -> LockIn | None:
        """What the exact balance has found."""
        return cast("LockIn | None", self.by.get(MethodName.LOCK_IN))

    @property
    def thesis(self) -> FrictionEstimate | PhaseLocked | None:
        """What the first of the thesis' methods has found."""
        kinds = FrictionEstimate, PhaseLocked
        return next((one for one in self.by.values() if isinstance(one, kinds)), None)

    def estimate(self, name: str) -> Estimate | None:
        """A quantity of the chosen method, None where the record does not show it."""
        found: Estimate | None = getattr(self.found, name, None)
        if found is None or name in ("coulomb", "offset"):
            return found
        cycle = float(np.median(np.diff(self.record.time)))
        half = (found.high - found.low) / 2
        if name == "dead_time":  # below zero by what the read comes after the command
            found = Estimate(max(found.value, 0.0), found.low, max(found.high, 0.0))
        allowed = {
            "viscous": 0.6 * max(found.value, 0.0),
            "inertia": 0.3 * max(found.value, 0.0),
            "dead_time": max(0.6 * found.value, 0.3 * cycle),
        }[name]
        return found if half <= allowed else None
