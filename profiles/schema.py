"""What a drive is: the schema of a drive profile.

A profile is data: a TOML file that names parameters, where they are, in which unit, and the
procedures of the drive. It can name only parameters, never code. An unknown key is an error.
"""

from __future__ import annotations

import struct
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

__all__ = [
    "Address",
    "CanopenAddress",
    "Compensation",
    "CompensationLaw",
    "Condition",
    "Cycle",
    "Identity",
    "IdentityMatch",
    "LinkDefaults",
    "LoopGains",
    "Mailbox",
    "MailboxAddress",
    "ModbusAddress",
    "Mode",
    "Parameter",
    "Patience",
    "Power",
    "Profile",
    "Step",
    "Store",
    "TablePoint",
    "Unit",
    "Watchdog",
]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


_Integer = Literal["i8", "u8", "i16", "u16", "i32", "u32", "i64", "u64"]
FLOAT = "f32"  # IEEE 754; its raw value is the whole number that has the same 32 bits

WIDTH_BITS: dict[str, int] = {
    "i8": 8, "u8": 8, "i16": 16, "u16": 16, "i32": 32, "u32": 32, "i64": 64, "u64": 64, FLOAT: 32,
}  # fmt: skip


class CanopenAddress(_Strict):
    """An entry of the CANopen object dictionary (CiA 301)."""

    index: Annotated[int, Field(ge=0x1000, le=0xFFFF)]
    sub: Annotated[int, Field(ge=0, le=0xFF)] = 0
    type: _Integer

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        return type_range(self.type)

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub:02X}"


class MailboxAddress(_Strict):
    """A parameter behind the profile's mailbox of registers, by its number (PNU) and sub-index."""

    pnu: Annotated[int, Field(ge=0, le=0xFFFF)]
    sub: Annotated[int, Field(ge=0, le=0xFFFF)] = 0
    type: _Integer | Literal["f32"]

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        return type_range(self.type)

    def __str__(self) -> str:
        return f"PNU {self.pnu}:{self.sub}"


class ModbusAddress(_Strict):
    """Holding registers, counted from 0 as on the wire.

    `word_order` says which word of a wider value lies at the lower address. Where only some bits of a
    register are the parameter, `bits` is their mask, and the raw value is what stands in them; they are
    written by FC 22, or else read, changed and written back.
    """

    register_: Annotated[int, Field(ge=0, le=0xFFFF, alias="register")]
    type: _Integer | Literal["f32"]
    word_order: Literal["high-first", "low-first"] = "high-first"
    read_function: Literal[3, 4] = 3
    write_function: Literal[6, 16, 22] = 16
    bits: Annotated[int, Field(ge=1, le=0xFFFF)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.count > 1 and self.write_function == 6:
            raise ValueError(
                f"write_function 6 writes one register; {self.type} takes {self.count}"
            )
        if self.bits is not None and self.type != "u16":
            raise ValueError("bits: only of one register of type u16")
        if (self.bits is None) and self.write_function == 22:
            raise ValueError("write_function 22 writes bits: say which")
        return self

    @property
    def count(self) -> int:
        """Number of 16-bit registers that the value takes."""
        return max(1, WIDTH_BITS[self.type] // 16)

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        if self.bits is None:
            return type_range(self.type)
        return 0, self.bits // (self.bits & -self.bits)

    def __str__(self) -> str:
        where = f"register {self.register_:04X}h"
        return where if self.bits is None else f"{where} bits {self.bits:04X}h"


Address = CanopenAddress | ModbusAddress | MailboxAddress


def _kind_of_address(value: Any) -> str:
    """An address with an index is an object, one with a pnu is behind a mailbox, any other is a register."""
    for key, kind in (("index", "canopen"), ("pnu", "mailbox")):
        there = value.get(key) if isinstance(value, dict) else getattr(value, key, None)
        if there is not None and not callable(there):
            return kind
    return "modbus"


class Unit(StrEnum):
    """What a raw value times its scale is measured in, before the drive's own bases are applied."""

    NONE = "1"
    RATED_TORQUE = "rated"  # share of the rated torque
    RATED_TORQUE_PER_SPEED = "rated/(rad/s)"
    TORQUE = "N.m"
    CURRENT = "A"  # of the motor; a torque by its torque constant
    REVOLUTION = "rev"
    INCREMENT = "increment"  # of the position encoder
    INCREMENT_PER_SECOND = "increment/s"
    SPEED = "rad/s"
    RPM = "rpm"
    RATED_TORQUE_PER_SECOND = "rated/s"
    PER_SECOND = "1/s"
    SECOND = "s"


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


class Parameter(_Strict):
    """One parameter of the drive.

    The value in SI is its number times `scale`, times what `unit` stands for in this drive; the number is the
    raw value, or of an f32 the one whose bits the raw value has. `minimum`, `maximum` and `largest_step` are
    numbers, `forbidden` lists raw values that must never be written.
    """

    address: Annotated[
        Annotated[CanopenAddress, Tag("canopen")]
        | Annotated[ModbusAddress, Tag("modbus")]
        | Annotated[MailboxAddress, Tag("mailbox")],
        Discriminator(_kind_of_address),
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
        """The raw value that stands for a number, or for the nearest one that the drive can hold."""
        if not self.is_float:
            return round(number)
        clipped = max(-_LARGEST_F32, min(_LARGEST_F32, number))
        raw: int = struct.unpack("<I", struct.pack("<f", clipped))[0]
        return raw

    def allows(self, raw: int) -> bool:
        """Whether a raw value may be written."""
        low, high = self.range
        return low <= self.number(raw) <= high and raw not in self.forbidden


_LARGEST_F32 = 3.4028234663852886e38


def type_range(name: str) -> tuple[int, int]:
    """Smallest and largest raw value of a scalar type by its name."""
    bits = WIDTH_BITS[name]
    return (0, 2**bits - 1) if name[0] in "uf" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


class IdentityMatch(_Strict):
    """What the drive must say about itself (object 1018h, or Modbus FC 43/14).

    A profile without any of these matches every drive of its bus and is used only when asked for
    by name. `asked` false: the drive does not know FC 43/14; who it is stands in the parameters
    `product_code`, `revision_code` and `serial_number`, those that there are.
    """

    vendor: str | None = None
    product: str | None = None
    revisions: tuple[str, ...] = ()
    asked: bool = True

    def accepts(self, identity: Identity) -> bool:
        """Whether `identity` is one of the drives that this profile is for."""
        return (
            (self.vendor is None or self.vendor == identity.vendor)
            and (self.product is None or self.product == identity.product)
            and (not self.revisions or identity.revision in self.revisions)
        )

    @property
    def empty(self) -> bool:
        """Whether nothing is asked for."""
        return self.vendor is None and self.product is None and not self.revisions


class Identity(_Strict):
    """What a drive said about itself. Numbers are written as in CiA 301: `0x0000009A`."""

    vendor: str
    product: str
    revision: str
    serial: str

    def __str__(self) -> str:
        named = (
            ("", self.vendor),
            ("", self.product),
            ("rev ", self.revision),
            ("serial ", self.serial),
        )
        return " ".join(f"{what}{text}" for what, text in named if text) or "does not say who it is"


NOBODY = Identity(vendor="", product="", revision="", serial="")


class LinkDefaults(_Strict):
    """How the drive is reached when the LINK does not say it."""

    node: Annotated[int, Field(ge=1, le=127)] | None = None
    unit: Annotated[int, Field(ge=0, le=255)] | None = None
    bitrate: int | None = None
    baudrate: int | None = None
    parity: Literal["N", "E", "O"] | None = None
    stopbits: Literal[1, 2] | None = None
    silence: Annotated[float, Field(ge=0)] = (
        0.0  # s between two frames, where more than the standard's
    )
    sharing: Literal["shared", "exclusive"] = "shared"
    cycle: Annotated[float, Field(gt=0)] = 0.005  # s
    service_timeout: Annotated[float, Field(gt=0)] = 0.5  # s, one request outside motion
    patience: Annotated[float, Field(ge=0)] = 5.0  # s, for a drive that says it is busy
    longest_answer: Annotated[float, Field(gt=0)] = 0.1  # s; later, none comes on a serial line


class Mode(StrEnum):
    """Operating mode by the names of IEC 61800-7-201 (CiA 402)."""

    TORQUE = "torque"
    POSITION = "position"


class Step(_Strict):
    """One step of a procedure: write a raw value, or wait until bits of a parameter read so."""

    write: str | None = None
    raw: int | None = None
    until: str | None = None
    mask: int = -1
    equals: int | None = None
    within: Annotated[float, Field(gt=0)] = 1.0  # s

    @model_validator(mode="after")
    def _check(self) -> Self:
        writes = self.write is not None and self.raw is not None
        waits = self.until is not None and self.equals is not None
        if writes == waits:
            raise ValueError("a step is either { write, raw } or { until, mask, equals, within }")
        if self.equals is not None and self.equals & self.mask != self.equals:
            raise ValueError(
                f"mask {self.mask:#x} never leaves {self.equals:#x}: it can never read so"
            )
        return self


class Condition(_Strict):
    """Bits of a parameter that read `equals`, or one of the values `among`, or anything but `differs`."""

    parameter: str
    mask: int = -1
    equals: int | None = None
    among: tuple[int, ...] | None = None
    differs: int | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if sum(given is not None for given in (self.equals, self.among, self.differs)) != 1:
            raise ValueError("a condition has equals, among or differs, and only one of them")
        if self.among == ():
            raise ValueError("among is empty: nothing ever reads so")
        values = self.wanted or (self.differs,)
        for value in values:
            if value is not None and value & self.mask != value:
                raise ValueError(
                    f"mask {self.mask:#x} never leaves {value:#x}: it can never read so"
                )
        return self

    @property
    def wanted(self) -> tuple[int, ...]:
        """Values with which it holds; none where it is about the one with which it does not."""
        return self.among or (() if self.equals is None else (self.equals,))

    def holds(self, raw: int) -> bool:
        """Whether `raw` of the parameter fulfils it."""
        if self.differs is not None:
            return raw & self.mask != self.differs
        return raw & self.mask in self.wanted

    def __str__(self) -> str:
        """What it must read."""
        if self.differs is not None:
            return f"must not be {self.differs}"
        return f"must be {' or '.join(str(value) for value in self.wanted)}"


class Power(_Strict):
    """How a drive without the CiA 402 state machine is energised, and how it says so.

    Its energy is taken by the profile's `disable`. `stopping`: it brakes, and takes no commands any more;
    without that sign only the position tells when it has come to rest. `fault` and `stopping` are watched
    in every cycle where their parameter is in the cycle. `enable` is empty only where there is no torque
    command: such a drive is never energised.
    """

    enable: tuple[Step, ...] = ()
    enabled: Condition
    stopping: Condition | None = None
    fault: Condition | None = None
    reset: tuple[Step, ...] = ()


class ModeCode(_Strict):
    """How a mode is asked for: value for `mode_of_operation`, bit that says it is supported.

    `before` is written before the mode is enabled and put back after the experiment; it is all there is
    where a drive has no `mode_of_operation`.
    """

    code: int | None = None
    supported_bit: Annotated[int, Field(ge=0, le=31)] | None = None
    set_point: str
    before: tuple[Step, ...] = ()


class Cycle(_Strict):
    """What is exchanged every cycle.

    Modbus: one block of registers is written and one read (FC 23, or FC 16 or 6, then FC 3). Up to `gap`
    registers between two that are wanted are read along; further apart, each block is a transaction.
    CANopen: one RPDO out, SYNC, one TPDO in; each list is the PDO's mapping in order.
    """

    out: tuple[str, ...]
    in_: Annotated[tuple[str, ...], Field(alias="in")]
    function: Literal["fc23", "fc16+3", "fc6+3", "pdo"]
    gap: Annotated[int, Field(ge=0, le=100)] = 0
    rpdo: Annotated[int, Field(ge=1, le=4)] = 1
    tpdo: Annotated[int, Field(ge=1, le=4)] = 1


class Mailbox(_Strict):
    """Registers through which parameters are reached by number: fill in, execute, look, take the data.

    `request` takes `read_code` or `write_code`, and reads `done_code` when the data are there. Data have
    their length in bytes, and their low word first.
    """

    pnu: int
    sub: int
    elements: int
    request: int
    length: int
    data: int
    read_code: int
    write_code: int
    done_code: int
    within: Annotated[float, Field(gt=0)] = 0.5  # s


class Watchdog(_Strict):
    """The drive-side watchdog of communication and how it is armed.

    `parameter` takes the time-out; `kind` says what feeds it: the cyclic command, any request, a heartbeat,
    or the remote frames of life guarding (CiA 301, 7.2.8.2.2).
    """

    kind: Literal["cycle", "traffic", "heartbeat", "guarding", "none"]
    parameter: str | None = None
    timeout: Annotated[float, Field(gt=0)] = 0.05  # s
    node: Annotated[int, Field(ge=1, le=127)] = 127  # whose heartbeat it is: ours
    guard_time: str | None = (
        None  # parameters of life guarding, for a drive without a heartbeat consumer
    )
    life_factor: str | None = None
    reaction: str | None = None  # parameter that says what the drive does
    reaction_raw: int | None = None

    @property
    def deadline(self) -> float:
        """Time-out of one cyclic answer, s: three missed ones come before the drive's own time-out."""
        return self.timeout / 4


class Store(_Strict):
    """How parameters are made non-volatile, and how often the memory takes it."""

    steps: tuple[Step, ...]
    endurance: Annotated[int, Field(gt=0)] = 100_000


class CompensationLaw(StrEnum):
    """Shape of the friction compensation that the drive has (reference: compensation laws).

    NONE                  nothing to write: identify and report only
    OFFSET_ASYMMETRIC     T = offset + F+ or F- by direction
    SINGLE_GAIN           T = F * sign(v)
    SATURATED_LINEAR      T = F * clip(v / v0, -1, 1)
    COULOMB_VISCOUS       T = offset + F+ or F- by direction + B * v
    TABLE                 T = offset + torque over speed, interpolated between points, odd in v
    HOST                  nothing in the drive: the master adds T = offset + F * sign(v) in every cycle
    """

    NONE = "none"
    OFFSET_ASYMMETRIC = "offset+asymmetric"
    SINGLE_GAIN = "single-gain"
    SATURATED_LINEAR = "saturated-linear"
    COULOMB_VISCOUS = "coulomb+viscous"
    TABLE = "table"
    HOST = "host"


LAW_TERMS: dict[CompensationLaw, tuple[frozenset[str], frozenset[str]]] = {
    # law: (terms it must have, terms it may have)
    CompensationLaw.NONE: (frozenset(), frozenset()),
    CompensationLaw.HOST: (frozenset(), frozenset()),
    CompensationLaw.TABLE: (frozenset({"points"}), frozenset({"offset"})),
    CompensationLaw.OFFSET_ASYMMETRIC: (frozenset({"positive", "negative"}), frozenset({"offset"})),
    CompensationLaw.SINGLE_GAIN: (frozenset({"gain"}), frozenset({"offset"})),
    CompensationLaw.SATURATED_LINEAR: (frozenset({"gain", "speed"}), frozenset({"offset"})),
    CompensationLaw.COULOMB_VISCOUS: (
        frozenset({"positive", "negative", "viscous"}),
        frozenset({"offset"}),
    ),
}


class TablePoint(_Strict):
    """One point of a friction table: the parameters that hold it, and the speed to give it (rad/s, motor)."""

    speed: str
    torque: str
    at: Annotated[float, Field(gt=0)]


class Compensation(_Strict):
    """Where the friction compensation of the drive is written.

    The terms name parameters. `negative_sign` is the sign with which the drive stores the
    compensation of the negative direction. `acts_in` lists the modes in which it has an effect. `host`
    names the torque offset that a master writes in every cycle (60B2h); tworelay never leaves one behind.
    `acts_stored`: a value has no effect until it is stored, so that it cannot be proved before.
    """

    law: CompensationLaw
    offset: str | None = None
    positive: str | None = None
    negative: str | None = None
    gain: str | None = None
    speed: str | None = None
    viscous: str | None = None
    points: str | None = None  # how many points the table has
    table: tuple[TablePoint, ...] = ()
    host: str | None = None
    negative_sign: Literal[-1, 1] = 1
    acts_in: tuple[Mode, ...] = (Mode.POSITION,)
    acts_stored: bool = False
    note: str = ""  # what a technician has to know before it is written

    @property
    def terms(self) -> dict[str, str]:
        """Parameter name of each term of the law that the drive has."""
        names = ("offset", "positive", "negative", "gain", "speed", "viscous", "points")
        found = {name: value for name in names if (value := getattr(self, name)) is not None}
        for n, point in enumerate(self.table, 1):
            found |= {f"speed_{n}": point.speed, f"torque_{n}": point.torque}
        return found

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.law is CompensationLaw.TABLE) != bool(self.table):
            raise ValueError("law 'table' has its points in table, and no other law does")
        speeds = [point.at for point in self.table]
        if speeds != sorted(set(speeds)):
            raise ValueError("the speeds of table must rise from point to point")
        must, may = LAW_TERMS[self.law]
        there = {name for name in self.terms if not name[-1].isdigit()}
        if missing := must - there:
            raise ValueError(f"law '{self.law}' needs {', '.join(sorted(missing))}")
        if extra := there - must - may:
            takes = ", ".join(sorted(must | may)) or "no parameters"
            raise ValueError(
                f"law '{self.law}' takes {takes}, and the profile names "
                f"{', '.join(sorted(extra))}, too: leave that out, or name the law that it belongs to"
            )
        if (self.law is CompensationLaw.HOST) != (self.host is not None):
            raise ValueError("law 'host' names the torque offset as host, and no other law does")
        return self


class LoopGains(_Strict):
    """The drive's own loops: how late they are, and where their gains are written.

    P of the position over PI of the velocity; all three gains are mapped, or none. `dead_time` is from the
    sample of the position to the torque, the hold of the loop's own period left out; `lag` names a
    parameter with the time constant of the torque loop, which comes on top.
    """

    period: Annotated[float, Field(gt=0)]  # s
    dead_time: Annotated[float, Field(ge=0)]  # s
    lag: str | None = None
    velocity_gain: str | None = None
    integral_time: str | None = None
    position_gain: str | None = None

    @property
    def terms(self) -> dict[str, str]:
        """Parameter name of each gain that the profile maps."""
        names = ("velocity_gain", "integral_time", "position_gain")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.terms) not in (0, 3):
            raise ValueError("velocity_gain, integral_time and position_gain go together")
        return self


_FACTORY_VALUES = 0x1011  # CiA 301: restore default parameters
_GAIN_UNITS = {
    "velocity_gain": Unit.RATED_TORQUE_PER_SPEED,
    "integral_time": Unit.SECOND,
    "position_gain": Unit.PER_SECOND,
}


class Patience(_Strict):
    """How long a drive may take, s, to do what it was told: real ones take milliseconds, or seconds."""

    boot: Annotated[float, Field(ge=0)] = (
        2.0  # until it answers at all, from when it is asked first
    )
    reset: Annotated[float, Field(gt=0)] = 2.0  # until a fault is gone after its acknowledgement
    mode: Annotated[float, Field(gt=0)] = 10.0  # until the mode that was asked for is displayed
    enable: Annotated[float, Field(gt=0)] = 5.0  # one transition of the state machine, brake too
    save: Annotated[float, Field(gt=0)] = 10.0  # until parameters are stored, and it listens again


class Brake(_Strict):
    """Holding brake: delays between command and effect, which the drive itself keeps."""

    release_delay: Annotated[float, Field(ge=0)] = 0.0  # s
    apply_delay: Annotated[float, Field(ge=0)] = 0.0  # s


class Profile(_Strict):
    """A drive family: identity, parameters, procedures, limits.

    A drive whose [modes] has no torque is not moved: its friction is found in a recording, and written to it.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")]
    version: str
    title: str
    bus: Literal["modbus", "canopen"]
    status: Literal["virtual", "from documents", "tried on hardware"]
    sources: tuple[str, ...] = ()
    identity: IdentityMatch = IdentityMatch()
    link: LinkDefaults = LinkDefaults()
    state_machine: Literal["cia402", "procedure"] = "cia402"
    power: Power | None = None
    parameters: dict[str, Parameter]
    mailbox: Mailbox | None = None
    cycle: Cycle = Cycle.model_validate({"out": (), "in": (), "function": "fc16+3"})
    modes: dict[Mode, tuple[ModeCode, ...]] = {}  # the first one that the drive supports is taken
    stop: tuple[Step, ...] = ()  # brings the axis to rest; written without waiting for an answer
    disable: tuple[Step, ...] = ()  # takes the energy away; likewise
    stop_time: Annotated[float, Field(gt=0)] = 1.0  # s, from `stop` to rest, brake closed
    requires: tuple[Condition, ...] = ()  # looked at before anything is written
    exclusive: Step | None = None  # locks other masters out: written first, put back last
    limits: dict[
        Literal["torque", "speed", "current"], str
    ] = {}  # current: a second one of the torque
    watchdog: Watchdog
    patience: Patience = Patience()
    brake: Brake = Brake()
    store: Store | None = None
    compensation: Compensation
    own_estimates: dict[Literal["coulomb"], str] = {}  # what the drive itself has found, to compare
    loops: LoopGains | None = None

    @property
    def moves(self) -> bool:
        """Whether torque can be commanded."""
        return bool(self.modes.get(Mode.TORQUE))

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        known = set(self.parameters)
        if (self.state_machine == "procedure") != (self.power is not None):
            raise ValueError("[power] belongs to state_machine 'procedure', and only to that")
        if self.power is not None and self.moves != bool(self.power.enable):
            raise ValueError(
                "[power] enable belongs to a drive with a torque mode, and only to that"
            )
        wanted = {"torque_target", "position_actual"} if self.moves else set()
        if self.state_machine == "cia402":
            wanted |= {"controlword", "statusword", "mode_of_operation", "mode_display"}
            if any(code.code is None for codes in self.modes.values() for code in codes):
                raise ValueError("[modes] lacks a code: a CiA 402 drive is told its mode")
        if missing := wanted - known:
            raise ValueError(f"[parameters] lacks {', '.join(sorted(missing))}")
        for where, name in self._references():
            if name not in known:
                raise ValueError(f"[{where}] names '{name}', which [parameters] does not have")
        for where, step in self._steps():
            if step.write is not None and step.raw is not None:
                low, high = self.parameters[step.write].range
                if not self.parameters[step.write].allows(step.raw):
                    raise ValueError(
                        f"[{where}] writes {step.raw} to '{step.write}', which takes {low}…{high}"
                    )
        return self

    @model_validator(mode="after")
    def _check_bus(self) -> Self:
        kinds = (CanopenAddress,) if self.bus == "canopen" else (ModbusAddress, MailboxAddress)
        for name, parameter in self.parameters.items():
            if not isinstance(parameter.address, kinds):
                raise ValueError(
                    f"[parameters.{name}] has an address of another bus than '{self.bus}'"
                )
            if isinstance(parameter.address, MailboxAddress) and self.mailbox is None:
                raise ValueError(f"[parameters.{name}] is behind a mailbox: [mailbox] is missing")
        if not self.moves:
            return self
        status = "statusword" if self.power is None else self.power.enabled.parameter
        for name in (status, "position_actual"):
            if name not in self.cycle.in_:
                raise ValueError(f"[cycle] in lacks '{name}', which every cycle must see")
        for mode, codes in self.modes.items():
            for code in codes:
                if code.set_point not in self.cycle.out:
                    raise ValueError(f"[cycle] out lacks '{code.set_point}', set-point of {mode}")
        for name in (*self.cycle.out, *self.cycle.in_):
            address = self.parameters[name].address
            if isinstance(address, MailboxAddress) or address.type == FLOAT:
                raise ValueError(f"[cycle] has '{name}', which is no register with a whole number")
            if name in self.cycle.out and getattr(address, "bits", None) is not None:
                raise ValueError(f"[cycle] out has '{name}', which is only bits of a register")
        if (self.cycle.function == "pdo") != (self.bus == "canopen"):
            raise ValueError(
                f"[cycle] function '{self.cycle.function}' does not fit bus '{self.bus}'"
            )
        return self

    @model_validator(mode="after")
    def _check_protection(self) -> Self:
        held = [
            name
            for name in (self.compensation.host, self.exclusive and self.exclusive.write)
            if name
        ]
        for name in held:
            if self.parameters[name].protection is not Protection.EXPERIMENT:
                raise ValueError(f"[parameters.{name}] must have protection 'experiment'")
        if self.exclusive is not None and self.exclusive.write is None:
            raise ValueError("[exclusive] is a write: { write, raw }")
        for name, parameter in self.parameters.items():
            index = getattr(parameter.address, "index", None)
            if index == _FACTORY_VALUES and parameter.protection is not Protection.READ:
                raise ValueError(
                    f"[parameters.{name}] is 1011h, which restores factory values and forgets the motor: it "
                    "must have protection 'read'"
                )
        for name in self.compensation.terms.values():
            if self.parameters[name].protection is not Protection.COMPENSATION:
                raise ValueError(f"[parameters.{name}] must have protection 'compensation'")
        for term, name in self.loops.terms.items() if self.loops else ():
            if self.parameters[name].protection is not Protection.GAIN:
                raise ValueError(f"[parameters.{name}] must have protection 'gain'")
            if self.parameters[name].unit is not _GAIN_UNITS[term]:
                raise ValueError(f"[parameters.{name}] must have unit '{_GAIN_UNITS[term]}'")
        return self

    def _steps(self) -> list[tuple[str, Step]]:
        """Every step of every procedure, with the section that it stands in."""
        found = [("stop", step) for step in self.stop] + [
            ("disable", step) for step in self.disable
        ]
        found += [("store", step) for step in (self.store.steps if self.store else ())]
        found += [("exclusive", self.exclusive)] if self.exclusive else []
        if self.power is not None:
            found += [("power", step) for step in (*self.power.enable, *self.power.reset)]
        for mode, codes in self.modes.items():
            found += [(f"modes.{mode}", step) for code in codes for step in code.before]
        return found

    def _references(self) -> list[tuple[str, str]]:
        found = [("cycle", name) for name in (*self.cycle.out, *self.cycle.in_)]
        for mode, codes in self.modes.items():
            found += [(f"modes.{mode}", code.set_point) for code in codes]
        found += [("compensation", name) for name in self.compensation.terms.values()]
        found += [("compensation", self.compensation.host)] if self.compensation.host else []
        found += [("limits", name) for name in self.limits.values()]
        found += [("own_estimates", name) for name in self.own_estimates.values()]
        if self.loops is not None:
            found += [("loops", name) for name in self.loops.terms.values()]
            found += [("loops", self.loops.lag)] if self.loops.lag else []
        found += [(where, step.write or step.until or "") for where, step in self._steps()]
        found += [("requires", condition.parameter) for condition in self.requires]
        if self.power is not None:
            conditions = (self.power.enabled, self.power.stopping, self.power.fault)
            found += [("power", condition.parameter) for condition in conditions if condition]
        for mode, codes in self.modes.items():
            if any(code.code is not None for code in codes):
                found.append((f"modes.{mode}", "mode_of_operation"))
                found.append((f"modes.{mode}", "mode_display"))
        watchdog = self.watchdog
        named = (watchdog.parameter, watchdog.reaction, watchdog.guard_time, watchdog.life_factor)
        found += [("watchdog", name) for name in named if name]
        return found
