"""What it is worth: the proof, and gains with their margins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from commissioning.result.changes import Change
from commissioning.result.kinds import Finite, Text

__all__ = ["LOOPS", "GainSet", "Loop", "Mark", "Source", "StepResponse", "Trial", "Verification"]

LOOPS = ("host", "drive")
Loop = Literal["host", "drive"]
Source = Literal["naive", "corrected"]


@dataclass(frozen=True, slots=True)
class Trial:
    """How the axis followed a slow sinusoid with one set of values in the drive; rad or m.

    Attributes
    ----------
    fraction : of the friction that is compensated
    reversal_error : after reversals, peak, its velocity lag left out
    low_speed_error : rms
    rest_swing : half-swing at rest
    kept : it stays in the drive
    """

    fraction: Finite
    reversal_error: Finite
    low_speed_error: Finite
    rest_swing: Finite
    hunts: bool
    kept: bool


@dataclass(frozen=True, slots=True)
class Verification:
    """Whether the compensation helps: without it, then with more and more.

    Attributes
    ----------
    kept_fraction : of the friction, that stays compensated; None: it does not help, the old values
        are back
    percent : that the error after reversals is less with it; None: it does not help
    """

    unit: Literal["rad", "m"]
    steps: Annotated[tuple[Trial, ...], Field(min_length=1)]
    kept_fraction: Finite | None = None
    percent: Finite | None = None

    @property
    def kept(self) -> Trial | None:
        """The step that stays."""
        return next((step for step in self.steps if step.kept), None)


@dataclass(frozen=True, slots=True)
class Mark:
    """The point of the plant that a rule was given: gain, degrees, s."""

    gain: Finite
    phase_deg: Finite
    period: Finite


@dataclass(frozen=True, slots=True)
class StepResponse:
    """A step with the friction that was found: shares and s; `error` and `hunting` in rad or m."""

    overshoot: Finite
    settling: Finite | None
    error: Finite
    hunting: Finite
    size: Finite = 0.0


@dataclass(frozen=True, slots=True)
class GainSet:
    """The gains of one rule from one reading of the plant, and what they are worth.

    Attributes
    ----------
    gains : by name, SI, None: infinite; empty where the rule gives none, and `why_not` says why
    why_not, why_not_code : why they are not proposed, for people and as a stable name; '' where
        they are
    ms : largest sensitivity
    crossover, bandwidth : rad/s
    parameters : the gains as the drive holds them, where its profile maps them
    """

    rule: Text
    loop: Loop
    source: Source
    point: Mark | None = None
    gains: dict[str, Finite | None] = field(default_factory=dict)
    phase_margin_deg: Finite | None = None
    gain_margin_db: Finite | None = None
    ms: Finite | None = None
    stable: bool | None = None
    crossover: Finite | None = None
    bandwidth: Finite | None = None
    step: StepResponse | None = None
    proposed: bool = False
    best: bool = False
    why_not: Text = ""
    why_not_code: Text = ""
    parameters: tuple[Change, ...] = ()

    def __post_init__(self) -> None:
        if not self.gains and (self.proposed or self.best):
            raise ValueError("gains where they are proposed")
        if self.gains and (self.ms is None or self.stable is None):
            raise ValueError("what the gains are worth")

    @property
    def name(self) -> str:
        """Loop, rule and source: what its step response is kept by."""
        return f"{self.loop}.{self.rule}.{self.source}"
