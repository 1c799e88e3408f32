"""How an act ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from commissioning.result.kinds import Finite, Text

__all__ = ["AxisState", "CompensationState", "DriveState", "Ending", "Error", "SettingsState"]


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
    names: dict[str, Text] = field(default_factory=dict)
