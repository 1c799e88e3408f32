"""A fleet file: which axes, in which groups and zones, and what is asked of them."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from commissioning.result.fleet import FleetJob
from commissioning.result.readings import MethodName
from profiles.axis import axis_name
from profiles.strict import Strict

__all__ = [
    "MOST_AXES",
    "AxisEntry",
    "FleetFile",
    "Gateway",
    "Group",
    "Keys",
    "Zone",
    "gateway_name",
]

MOST_AXES = 1000
Positive = Annotated[float, Field(gt=0)]
Name = Annotated[str, AfterValidator(axis_name)]


class Zone(Strict):
    """Axes behind one emergency stop; `at_once`: how many of them may be under way."""

    at_once: Annotated[int, Field(ge=1)] | None = None


class Group(Strict):
    """Axes that can meet: one at a time, and one that fails stops the others, or not."""

    zone: str | None = None
    on_failure: Literal["stop-group", "go-on"] = "stop-group"


def gateway_name(text: str) -> str:
    """A name that a certificate can bear; raises ValueError."""
    if not re.fullmatch(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?", text):
        raise ValueError(
            "is no name of a gateway: lower-case letters, digits and dashes, as its certificate has"
        )
    return text


GatewayName = Annotated[str, AfterValidator(gateway_name)]


class Gateway(Strict):
    """Another computer that owns the bus of some axes.

    Attributes
    ----------
    address : tls://HOST:PORT
    keys : folder with ca.crt and the certificate of this client, beside the fleet file
    """

    address: str
    keys: str | None = None

    @field_validator("address")
    @classmethod
    def _check(cls, text: str) -> str:
        found = re.fullmatch(r"tls://(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):([0-9]{1,5})", text)
        if found is None or not 0 < int(found[2]) < 65536:
            raise ValueError("must be tls://HOST:PORT, as in tls://10.0.7.11:8786")
        return text


class Keys(Strict):
    """What an axis file or an option of the job may say, of one axis or of all."""

    profile: str | None = None
    travel: Positive | None = None
    cycle: Positive | None = None
    rated_torque: Positive | None = None
    torque_constant: Positive | None = None
    encoder: Positive | None = None
    mechanics: dict[str, Any] = {}
    limits: dict[str, Any] = {}
    group: str | None = None
    zone: str | None = None
    gateway: str | None = None
    twin: str | None = None  # virtual axis that stands for it in a rehearsal
    fraction: Annotated[float, Field(ge=0, le=1)] | None = None
    method: MethodName | None = None
    precision: Annotated[float, Field(gt=0, le=1)] | None = None
    solver: Literal["bracket", "thesis"] | None = None
    repeat: Annotated[int, Field(ge=1, le=50)] | None = None
    points: bool | None = None
    output_filter: Positive | None = None
    max_torque: Positive | None = None
    max_speed: Positive | None = None
    duration: Positive | None = None
    watchdog: Annotated[float, Field(ge=0.005, le=5)] | None = None
    without_watchdog: bool | None = None


OF_THE_JOB = (
    "fraction", "method", "precision", "solver", "repeat", "points", "output_filter",
    "without_watchdog",
)  # fmt: skip
LIMITS = {  # option of the job → the limit of the axis that it is
    "max_torque": "torque", "max_speed": "speed", "duration": "duration", "watchdog": "watchdog",
}  # fmt: skip


class AxisEntry(Keys):
    """One axis, or all that a glob finds.

    `serial`: which drive it is, or "none" where the drive tells no serial number
    """

    file: str | None = None
    name: Name | None = None
    link: str | None = None
    serial: str | None = None
    after: list[str] = []

    @property
    def is_glob(self) -> bool:
        """Whether its file is several."""
        return self.file is not None and any(letter in self.file for letter in "*?[")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.gateway is not None:
            self._check_named_only()
        elif self.file is None and self.link is None:
            raise ValueError("an axis needs a file, or a link and a name")
        if self.file is None and self.name is None:
            raise ValueError("an axis without a file needs a name")
        alone = [key for key in ("serial", "name", "after", "link") if getattr(self, key)]
        if self.is_glob and alone:
            raise ValueError(
                f"file = '{self.file}' is several axes, which cannot share a {alone[0]}: name that "
                "axis in an entry of its own"
            )
        return self

    def _check_named_only(self) -> None:
        allowed = {"name", "gateway", "group", "zone", "after", "serial", "twin", *OF_THE_JOB}
        wrong = [key for key in self.model_fields_set if key not in allowed]
        if wrong:
            raise ValueError(
                f"an axis of a gateway is described by the file there, and not by '{wrong[0]}' here"
            )


class FleetFile(Strict):
    """A fleet file as it is written."""

    name: Name | None = None
    job: FleetJob
    confirm: Literal["each", "group", "yes"] = "group"
    defaults: Keys = Keys()
    zones: dict[Name, Zone] = {}
    groups: dict[Name, Group] = {}
    gateways: dict[GatewayName, Gateway] = {}
    axes: Annotated[list[AxisEntry], Field(min_length=1, max_length=MOST_AXES)]
