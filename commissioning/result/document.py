"""The result of a run: what was found, what was changed, and how it ended. Frozen; changed by `replace`.

SI units at the axis, named in `Units`. What was not measured is None, never 0. `codec` reads and writes it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Annotated, ClassVar, Final, Literal

from pydantic import ConfigDict, Field

from commissioning.identification.reasons import Reason, Verdict
from profiles.errors import Status
from profiles.identity import Identity

__all__ = [
    "LOOPS",
    "POINTS",
    "QUANTITIES",
    "SCHEMA",
    "AxisState",
    "BalanceReading",
    "Bases",
    "Change",
    "CompensationState",
    "CriticalPoints",
    "Curve",
    "Cycle",
    "DriveState",
    "Ending",
    "Error",
    "Experiment",
    "FirstLook",
    "Found",
    "GainSet",
    "Host",
    "Limits",
    "Mark",
    "Mechanics",
    "Methods",
    "ModulatingReading",
    "Point",
    "ProfileMark",
    "Quality",
    "Quantity",
    "RunResult",
    "SettingsState",
    "Setup",
    "Speed",
    "SteadyReading",
    "StepResponse",
    "Tool",
    "Trial",
    "TwoRelayReading",
    "Units",
    "Verification",
    "Written",
]

SCHEMA: Final = "tworelay.run/2"
QUANTITIES = ("coulomb", "offset", "viscous", "inertia", "dead_time")
POINTS = ("naive", "hysteresis", "corrected", "measured", "at_180", "at_135")
LOOPS = ("host", "drive")

Finite = Annotated[float, Field(ge=-1e300, le=1e300)]
Positive = Annotated[float, Field(gt=0, le=1e300)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=0, lt=1 << 31)]
Raw = Annotated[int, Field(gt=-(1 << 63), lt=1 << 63)]
LONGEST_TEXT = 10_000  # characters
Text = Annotated[str, Field(max_length=LONGEST_TEXT)]
Pair = tuple[Finite, Finite]

Loop = Literal["host", "drive"]
Source = Literal["naive", "corrected"]


# -- who, what, when --------------------------------------------------------------------------------


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
class Units:
    """ASCII units of this axis' quantities."""

    position: Literal["rad", "m"] = "rad"
    effort: Text = "N.m"
    coulomb: Text = "N.m"
    offset: Text = "N.m"
    viscous: Text = "N.m.s/rad"
    inertia: Text = "kg.m2"
    dead_time: Text = "s"
    gain: Text = "rad/(N.m)"
    stiffness: Text = "N.m/rad"

    @classmethod
    def of(cls, position: Literal["rad", "m"]) -> Units:
        """Units of a rotary (rad, N.m) or a linear axis (m, N)."""
        if position == "rad":
            return cls()
        return cls("m", "N", "N", "N", "N.s/m", "kg", "s", "m/N", "N/m")

    def of_quantity(self, name: str) -> str:
        """Unit of one of QUANTITIES."""
        return str(getattr(self, name))


# -- what was found ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its interval, which holds the truth in 19 of 20 cases.

    Attributes
    ----------
    value, low, high : in `unit`; an end is None where it is not known
    raw : the value as the drive counts, in `raw_unit`; None where the drive has no such number
    """

    value: Finite
    low: Finite | None
    high: Finite | None
    unit: Text
    raw: Finite | None = None
    raw_unit: Text | None = None

    @property
    def half_width(self) -> float:
        """Half of the interval as a share of the value; infinite where it is not known."""
        if self.low is None or self.high is None or not self.value:
            return float("inf")
        return (self.high - self.low) / (2 * abs(self.value))


@dataclass(frozen=True, slots=True)
class Curve:
    """Friction against speed, the mean of both directions: columns of one length.

    Attributes
    ----------
    speed : rad/s or m/s
    friction : N.m or N
    low, high : its interval; empty where it is not known
    """

    speed: tuple[Finite, ...]
    friction: tuple[Finite, ...]
    low: tuple[Finite, ...] = ()
    high: tuple[Finite, ...] = ()

    def __post_init__(self) -> None:
        if len({len(self.speed), len(self.friction)}) != 1:
            raise ValueError("columns of one length")


@dataclass(frozen=True, slots=True)
class Found:
    """The numbers of a run, by the chosen method: what report, proposal, tuning and history go by.

    Attributes
    ----------
    method : name of the method; None where nothing was measured
    coulomb, offset : N.m or N
    viscous : N.m.s/rad or N.s/m
    inertia : kg.m2 or kg
    dead_time : s
    low_speed : friction just above rest, N.m or N
    """

    method: Text | None = None
    coulomb: Quantity | None = None
    offset: Quantity | None = None
    viscous: Quantity | None = None
    inertia: Quantity | None = None
    dead_time: Quantity | None = None
    low_speed: Quantity | None = None
    curve: Curve | None = None

    def quantity(self, name: str) -> Quantity | None:
        """One of QUANTITIES."""
        found: Quantity | None = getattr(self, name)
        return found


@dataclass(frozen=True, slots=True)
class Mechanics:
    """What the axis shows beside a rigid body: two masses, play.

    Attributes
    ----------
    motor_inertia, load_inertia : kg.m2 or kg
    stiffness : N.m/rad or N/m
    damping : N.m.s/rad or N.s/m
    resonance, antiresonance : Hz
    play : rad or m
    """

    verdict: Text
    reasons: tuple[Text, ...] = ()
    motor_inertia: Quantity | None = None
    load_inertia: Quantity | None = None
    stiffness: Quantity | None = None
    damping: Quantity | None = None
    resonance: Quantity | None = None
    antiresonance: Quantity | None = None
    play: Quantity | None = None


@dataclass(frozen=True, slots=True)
class Point:
    """A point of the plant's frequency response, with its interval.

    Attributes
    ----------
    gain : |position/torque|
    phase_deg : in (−360, 0]
    period : s, of the oscillation that it was read at
    ku : 1/gain where the phase is −180° within half a degree
    travel_needed : rad or m on either side of the start, to measure it
    """

    gain: Positive
    phase_deg: Finite
    period: Positive
    ku: Finite | None
    how: Literal["measured", "computed"]
    gain_low: Finite | None = None
    gain_high: Finite | None = None
    phase_low_deg: Finite | None = None
    phase_high_deg: Finite | None = None
    travel_needed: Finite | None = None


@dataclass(frozen=True, slots=True)
class CriticalPoints:
    """The plant at the relay's own frequency, read in several ways, and where tuning rules want it."""

    naive: Point | None = None
    hysteresis: Point | None = None
    corrected: Point | None = None
    measured: Point | None = None
    at_180: Point | None = None
    at_135: Point | None = None

    def point(self, name: str) -> Point | None:
        """One of POINTS."""
        found: Point | None = getattr(self, name)
        return found


# -- what each method read --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TwoRelayReading:
    """The thesis' balance: its complex friction, N.m or N, and both relay tests."""

    coulomb: Finite
    real: Finite
    imaginary: Finite
    modulus: Finite
    half_swing: Pair
    fundamental: Pair
    period: Pair
    periods: tuple[Count, Count]
    relay_amplitude: Pair
    hysteresis: Pair
    bias: Pair
    duty: Pair
    settled: tuple[bool, bool]


@dataclass(frozen=True, slots=True)
class BalanceReading:
    """A balance on measured phasors.

    Attributes
    ----------
    harmonics : friction at the harmonics 1, 3, 5, N.m or N
    rejected : harmonics that were too small to be read
    plant : real and imaginary part
    phase_deg : of both oscillations, by the phase-locked method
    """

    coulomb: Finite
    real: Finite
    imaginary: Finite
    modulus: Finite
    half_swing: tuple[Finite, ...]
    fundamental: tuple[Finite, ...]
    period: Finite
    periods: tuple[Finite, ...]
    offset: Finite | None = None
    viscous: Finite | None = None
    inertia: Finite | None = None
    dead_time: Finite | None = None
    hysteresis: Finite | None = None
    harmonics: dict[str, Finite] | None = None
    rejected: tuple[Finite, ...] = ()
    plant: Pair | None = None
    phase_deg: tuple[Finite, ...] | None = None


@dataclass(frozen=True, slots=True)
class Law:
    """The friction law that the record asks for."""

    terms: tuple[Text, ...]
    stribeck_speed: Finite | None = None
    soft_speed: Finite | None = None
    pitch: Finite | None = None
    coefficients: tuple[Finite, ...] = ()


@dataclass(frozen=True, slots=True)
class ModulatingReading:
    """Modulating functions: numbers, law, and what says how far to trust them; shares of the torque."""

    coulomb: Finite
    offset: Finite
    viscous: Finite
    inertia: Finite
    dead_time: Finite
    law: Law
    residual: Finite | None = None
    held_out: Finite | None = None
    rigid_residual: Finite | None = None
    condition: Finite | None = None
    halves: Finite | None = None
    widths: Finite | None = None
    noise: Finite | None = None
    periods: Finite | None = None
    windows: Finite | None = None
    reversals: Finite | None = None
    low_speed: Finite | None = None
    peak_speed: Finite | None = None


@dataclass(frozen=True, slots=True)
class Speed:
    """Torque at one constant speed, and its error."""

    speed: Finite
    torque: Finite
    error: Finite


@dataclass(frozen=True, slots=True)
class SteadyReading:
    """The friction curve from constant speeds."""

    coulomb: Finite
    offset: Finite
    viscous: Finite
    stribeck_level: Finite | None = None
    stribeck_speed: Finite | None = None
    rms: Finite | None = None
    held_out: Finite | None = None
    points: tuple[Speed, ...] = ()


@dataclass(frozen=True, slots=True)
class Methods:
    """What was run, each with its own reading; of a measurement that was repeated, of the last repeat."""

    two_relay: TwoRelayReading | None = None
    two_relay_delay: TwoRelayReading | None = None
    phase_locked: BalanceReading | None = None
    lock_in: BalanceReading | None = None
    modulating: ModulatingReading | None = None
    steady: SteadyReading | None = None

    def readings(
        self,
    ) -> list[tuple[str, TwoRelayReading | BalanceReading | ModulatingReading | SteadyReading]]:
        """Name and reading of each method that was run."""
        pairs = [(one.name.replace("_", "-"), getattr(self, one.name)) for one in fields(self)]
        return [(name, reading) for name, reading in pairs if reading is not None]


# -- how it was measured ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Cycle:
    """One oscillation: of a relay, or of an oscillator, which has no hysteresis.

    Attributes
    ----------
    relay_amplitude : half of the torque's swing, N.m or N
    hysteresis : half-width, rad or m
    half_swing, fundamental : rad or m
    begin, end : s since the record's begin
    """

    name: Text
    period: Positive
    begin: Finite
    end: Finite
    relay_amplitude: Finite | None = None
    hysteresis: Finite | None = None
    bias: Finite | None = None
    half_swing: Finite | None = None
    fundamental: Finite | None = None
    duty: Finite | None = None
    periods: Finite | None = None
    settled: bool | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """What the run was allowed: ± about its start, rad or m; N.m or N; rad/s or m/s."""

    travel: Positive
    torque: Positive
    speed: Positive


@dataclass(frozen=True, slots=True)
class FirstLook:
    """What short pushes told before the oscillations."""

    breakaway: Finite
    coulomb: Finite
    offset: Finite
    viscous: Finite
    inertia: Finite
    dead_time: Finite


@dataclass(frozen=True, slots=True)
class Bases:
    """What scales the drive's numbers: N.m, increments a revolution, N.m/A."""

    rated_torque: Finite
    increments_per_revolution: Finite
    torque_constant: Finite = 0.0


@dataclass(frozen=True, slots=True)
class Setup:
    """What the drive and the link were, where it takes a measurement to know it.

    Attributes
    ----------
    turnaround : s, from a sample to the command that answers it
    loop_lag : s, that the drive itself says of its torque
    resolution : of the position, rad or m
    """

    turnaround: Finite
    resolution: Finite
    bases: Bases
    first_look: FirstLook
    loop_lag: Finite = 0.0


@dataclass(frozen=True, slots=True)
class Experiment:
    """How long and how regularly the axis was watched.

    Attributes
    ----------
    periods : of all oscillations
    duration : s
    cycle : s
    late_share, lost_share : of the cycles
    travel : from end to end, rad or m
    limits : None for a recording
    cycles : one oscillation at each amplitude; empty where the run did not get there
    complex_coulomb : that puts the relay's locus on the plant, N.m or N
    tests : relay tests that the thesis' method took
    repeats : Coulomb friction of each repeat, N.m or N
    """

    periods: Finite
    duration: Finite
    cycle: Positive
    late_share: Finite
    lost_share: Finite
    travel: Finite
    limits: Limits | None = None
    cycles: tuple[Cycle, ...] = ()
    complex_coulomb: Pair | None = None
    tests: Count = 0
    repeats: tuple[Finite, ...] = ()
    setup: Setup | None = None


# -- what is changed --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter of the drive, before and after.

    Attributes
    ----------
    old, new : SI at the axis; `new` is what the drive holds, after rounding; old is None where not read
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
    """What a master adds in every cycle, offset + coulomb · sign(v), where the drive has no compensation."""

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
    """A parameter that this run changed in the drive and that is not back, as of the last act on it.

    Attributes
    ----------
    raw, value : as the drive counts, and SI; the value is None where its scale is not known
    certain : it was read back; False: the write was cut off, the drive has this value or the old one
    """

    parameter: Text
    kind: Literal["compensation", "gain"]
    raw: Raw
    value: Finite | None = None
    unit: Text = ""
    certain: bool = True


# -- what it is worth -------------------------------------------------------------------------------


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
    kept_fraction : of the friction, that stays compensated; None: it does not help, the old values are back
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


# -- how far to trust it, and how it ended ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Quality:
    """How far the numbers can be trusted; the verdict is None where nothing was measured to its end."""

    verdict: Verdict | None = None
    reasons: tuple[Reason, ...] = ()

    def has(self, code: str) -> bool:
        """Whether one of the reasons has this code, or a longer one that begins so."""
        return any(f"{reason.code}.".startswith(f"{code}.") for reason in self.reasons)


class AxisState(StrEnum):
    """What is known of the axis when an act ends."""

    AT_REST = "at rest and off"
    HELD = "held by its brake"
    NOT_MOVED = "not moved"
    ENABLED = "ENABLED"  # by somebody else, or by a job that died
    NOT_RECORDED = "not recorded"  # by versions before 0.2
    NOT_VERIFIED = "NOT VERIFIED"


@dataclass(frozen=True, slots=True)
class SettingsState:
    """The settings of the experiment in the drive; `names`: parameters that are not put back."""

    state: Literal["put back", "not put back"] = "put back"
    names: tuple[Text, ...] = ()


class CompensationState(StrEnum):
    """Whose compensation is in the drive."""

    AS_FOUND = "as it was found"
    OF_RUN = "of this run"
    PARTLY = "partly of this run"
    OF_OTHER = "of another run"
    NOT_KNOWN = "not known"


@dataclass(frozen=True, slots=True)
class DriveState:
    """What compensation is in the drive now.

    Attributes
    ----------
    stored : it is in the non-volatile memory, too; None: not known, or nothing was stored
    """

    compensation: CompensationState = CompensationState.AS_FOUND
    stored: bool | None = None


@dataclass(frozen=True, slots=True)
class Ending:
    """The last line of every act, and of every failure.

    Attributes
    ----------
    settings, drive : by the journal of the run; None where none was begun
    said_by : who ended it; None: it came to its end
    """

    axis: AxisState
    settings: SettingsState | None = None
    drive: DriveState | None = None
    said_by: Text | None = None


@dataclass(frozen=True, slots=True)
class Error:
    """What ended an act early."""

    code: Text
    text: Text
    hint: Text = ""
    numbers: dict[str, Finite] = field(default_factory=dict)


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
    mechanics: Mechanics | None = None
    methods: Methods = field(default_factory=Methods)
    critical_point: CriticalPoints | None = None
    tuning: tuple[GainSet, ...] = ()
    compensation: tuple[Change, ...] = ()
    host_compensation: Host | None = None
    written: tuple[Written, ...] = ()
    verification: Verification | None = None
    experiment: Experiment | None = None
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
