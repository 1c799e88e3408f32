"""What an axis is: how it is reached, what it may do, and how the motor moves it.

Rotary and linear axes differ here, in gear and feed, and nowhere else: everything above a driver
is in rad, N.m or in m, N at the axis.
"""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from profiles.errors import ProfileError
from profiles.quantities import Kind, parse, units_of
from profiles.strict import Strict
from profiles.toml_files import load_model

__all__ = ["Axis", "AxisLimits", "Mechanics", "axis_name", "axis_text", "load_axis"]

Positive = Annotated[float, Field(gt=0)]
_IN_UNITS: dict[str, tuple[Kind, ...]] = {  # keys that may be texts with a unit
    "travel": ("position",), "cycle": ("time",), "rated_torque": ("torque",),
    "torque_constant": ("torque constant",), "mechanics.feed": ("position",),
    "limits.torque": ("torque",), "limits.speed": ("velocity",), "limits.duration": ("time",),
    "limits.watchdog": ("time",), "limits.ends": ("position",),
}  # fmt: skip
_OF_THE_MOTOR = "rated_torque", "torque_constant"


class Mechanics(Strict):
    """How the motor moves the axis.

    Parameters
    ----------
    motion : rotary (rad, N.m) or linear (m, N)
    gear : motor revolutions per revolution of the gear's output
    feed : m per revolution of the gear's output, for a linear axis
    held_by : what keeps the axis at rest without energy
    """

    motion: Literal["rotary", "linear"] = "rotary"
    gear: Positive = 1.0
    feed: Positive | None = None
    held_by: Literal["friction", "brake", "counterbalance", "fixture"] = "friction"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.motion == "linear") != (self.feed is not None):
            raise ValueError("feed (m per revolution) belongs to motion 'linear', and only to that")
        return self

    @property
    def travel_per_revolution(self) -> float:
        """Travel of the axis per motor revolution, rad or m."""
        if self.motion == "rotary":
            return 2 * pi / self.gear
        assert self.feed is not None
        return self.feed / self.gear

    @property
    def effort_per_torque(self) -> float:
        """Torque (1) or force (1/m) at the axis per motor torque, without losses."""
        return 2 * pi / self.travel_per_revolution


class AxisLimits(Strict):
    """What the axis may never exceed in an experiment."""

    torque: Positive | None = None  # N.m or N at the axis
    speed: Positive | None = None  # rad/s or m/s
    duration: Positive = 300.0  # s
    watchdog: Positive | None = None  # s, what the drive's watchdog is armed with
    ends: tuple[float, float] | None = None  # rad or m, of a drive that knows where it is

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.ends is not None and not self.ends[0] < self.ends[1]:
            raise ValueError("ends are [low, high], the lower one first")
        return self


LONGEST_NAME = 100  # characters


def axis_name(text: str) -> str:
    """A name as people say it: of any script, in one line."""
    if not text or text != text.strip():
        raise ValueError("must not be empty, nor begin or end with a space")
    if len(text) > LONGEST_NAME:
        raise ValueError(f"has {len(text)} characters: must have {LONGEST_NAME} at most")
    if not text.isprintable():
        raise ValueError("must be one line of printable characters")
    return text


class Axis(Strict):
    """One axis of a machine.

    `travel` is the room on either side of the position where the job starts, rad or m.
    `rated_torque` (N.m of the motor), `torque_constant` (N.m/A) and `encoder` (increments per motor
    revolution) are for drives that do not tell theirs. Axes of one `group` can meet, those of one
    `zone` are behind one emergency stop. `limits.ends` of the travel, by the drive's own position:
    an experiment stays between them, and what was measured in one third of it is compared with
    that.
    """

    name: Annotated[str, AfterValidator(axis_name)] = "axis"
    link: str | None = None
    profile: str | None = None
    travel: Positive | None = None
    cycle: Positive | None = None
    rated_torque: Positive | None = None
    torque_constant: Positive | None = None
    encoder: Positive | None = None
    mechanics: Mechanics = Mechanics()
    limits: AxisLimits = AxisLimits()
    group: str | None = None
    zone: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _to_si(cls, tree: Any) -> Any:
        """Texts with units as numbers in SI."""
        if not isinstance(tree, dict):
            return tree
        mechanics = tree.get("mechanics")
        is_linear = isinstance(mechanics, dict) and mechanics.get("motion") == "linear"
        found = {k: dict(v) if isinstance(v, dict) else v for k, v in tree.items()}
        for key, kinds in _IN_UNITS.items():
            section, _, name = key.rpartition(".")
            there = found.get(section) if section else found
            if not isinstance(there, dict) or name not in there:
                continue
            of_motor = None if is_linear else False  # a linear motor has newtons
            linear = of_motor if key in _OF_THE_MOTOR else is_linear
            value = there[name]
            if isinstance(value, list):
                there[name] = tuple(_in_si(key, one, kinds, linear=linear) for one in value)
            else:
                there[name] = _in_si(key, value, kinds, linear=linear)
        return found

    @property
    def position_unit(self) -> Literal["rad", "m"]:
        """ASCII unit of position."""
        return "rad" if self.mechanics.motion == "rotary" else "m"

    def as_said(self) -> str:
        """JSON of what was said of it; what was not stays unsaid."""
        return self.model_dump_json(exclude_unset=True)

    @property
    def effort_unit(self) -> str:
        """ASCII unit of torque or force."""
        return "N.m" if self.mechanics.motion == "rotary" else "N"


def _in_si(key: str, value: Any, kinds: tuple[Kind, ...], *, linear: bool | None) -> Any:
    """A text with a unit in SI, anything else as it is; raises ValueError."""
    if not isinstance(value, str):
        return value
    text = value.strip().removeprefix("±").removeprefix("+-")
    try:
        found = parse(text)
    except ValueError as error:
        raise ValueError(f"{key} = '{value}': {error}; there are {units_of(*kinds)}") from None
    unit = found.unit
    if unit is None or unit.kind not in kinds or unit.base:
        raise ValueError(f"{key} = '{value}': give it a unit: {units_of(*kinds)}")
    if linear is not None and unit.linear is not None and unit.linear is not linear:
        kind = "linear" if linear else "rotary"
        raise ValueError(f"{key} = '{value}': the axis is {kind}, {unit.name} is of the other kind")
    return found.si


def load_axis(path: Path) -> Axis:
    """Read an axis file; its name is the file's unless it says another.

    A profile that is a file is looked for beside it first.
    """
    axis = load_model(path, Axis)
    beside = path.parent / axis.profile if axis.profile else None
    if beside is not None and beside.suffix == ".toml" and beside.exists():
        axis = axis.model_copy(update={"profile": str(beside)})
    if "name" in axis.model_fields_set:
        return axis
    try:
        return axis.model_copy(update={"name": axis_name(path.stem)})
    except ValueError as error:
        raise ProfileError(
            f"{path}: the file's name is the axis' name, which {error}; give another in the file: "
            'name = "…"'
        ) from None


def axis_text(axis: Axis) -> str:
    """An axis as the text of its file."""
    import tomlkit

    return tomlkit.dumps(axis.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
