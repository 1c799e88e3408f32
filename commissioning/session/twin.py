"""The twin of an axis that was measured: a virtual drive with the numbers of its run.

A run's numbers are at the axis, a virtual axis' at the motor: torque is E times as large at the
axis, position 1/E times, with E = 2π/(travel per revolution).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path
from typing import Literal

from commissioning.journal import Journal
from commissioning.journal_file import slug
from commissioning.result.document import RunResult
from commissioning.result.experiment import Setup
from commissioning.result.found import Quantity
from commissioning.result.readings import LawReading, SteadyReading
from commissioning.runs import RunFolder, resolve
from commissioning.session.named import axis_of_run
from drivers.home import home
from drivers.link_text import Link, parse
from drivers.virtual.axes import VirtualAxis, configured
from drivers.virtual.memory import Memory
from drivers.virtual.served import FIRST_NODE, FIRST_UNIT, Endpoints, ServedDrive
from profiles.axis import LONGEST_NAME, Axis
from profiles.errors import Refused, UsageError
from profiles.library import load_profile
from profiles.schema import Profile

__all__ = ["MeasuredTwin", "endpoints_like", "measured_twin", "numbered", "twin_of_run"]

Ask = Callable[[str, str], float | None]  # what, its unit → SI at the motor; None: nobody is there

_TWIN = " (twin)"
_ANY = ("127.0.0.1", 0)
_PEAK = 3.0  # times rated, of a drive whose run does not tell it
_WHAT = {
    "inertia": ("inertia of motor and load", "kg.m2"),
    "viscous": ("viscous friction", "N.m.s/rad"),
    "delay": ("dead time from command to torque", "s"),
    "rated": ("rated torque of the motor", "N.m"),
    "encoder": ("increments of a motor revolution", "1"),
    "speed": ("highest speed of the motor", "rad/s"),
    "travel": ("room on either side of the start, of the motor", "rad"),
}


@dataclass(frozen=True, slots=True)
class MeasuredTwin:
    """A virtual axis by a run.

    Attributes
    ----------
    axis : at the motor
    profile : whose objects or registers it has; None: the virtual drive's own
    file : the axis as it is to be commissioned, without its link
    said : what the run does not tell, and where it was taken from
    link : where the axis was measured
    """

    axis: VirtualAxis
    profile: Profile | None
    file: Axis
    said: tuple[str, ...]
    link: Link

    def served(self, unit: int, node: int, number: int, state: Path | None) -> ServedDrive:
        """As the `number`-th of the session, from 0: another drive than an equal one before it."""
        axis = replace(self.axis, seed=self.axis.seed + number)
        memory = state or home() / "virtual" / f"{slug(axis.name)}-{axis.serial:08x}.json"
        return ServedDrive(axis, Memory.at(memory), unit, node, self.profile)


def endpoints_like(link: Link, profile: Profile | None = None) -> Endpoints:
    """The same kind of wire on loopback, where this computer has it; of a virtual link Modbus TCP.

    `profile` : decides where the link does not
    """
    has_terminals = os.name != "nt"
    is_canopen = profile.bus == "canopen" if profile else link.scheme == "canopen"
    if is_canopen:
        if link.scheme == "canopen" and link.interface == "slcan" and has_terminals:
            return Endpoints(slcan_pty=True)
        return Endpoints(socketcand=_ANY)
    if link.scheme == "modbus-rtu" and has_terminals:
        return Endpoints(modbus_rtu_pty=True)
    if link.scheme in ("modbus-rtu", "modbus-rtu-tcp"):
        return Endpoints(modbus_rtu_tcp=_ANY)
    return Endpoints(modbus_tcp=_ANY)


def numbered(twins: Sequence[MeasuredTwin], key: Literal["unit", "node"]) -> list[int]:
    """The unit or node of each: the run's own, where no twin before it has that."""
    found: list[int] = []
    first, last = (FIRST_UNIT, 247) if key == "unit" else (FIRST_NODE, 127)
    for one in twins:
        own = one.link.integer(key, 1, last)
        free = (n for n in range(first, last + 1) if n not in found)
        found.append(own if own is not None and own not in found else next(free))
    return found


def measured_twin(journal: Journal, run: str, given: Mapping[str, str], ask: Ask) -> MeasuredTwin:
    """The twin of RUN; raises UsageError, Refused."""
    run_id, folder = resolve(journal, run)
    record = folder.history(journal, run_id).run
    axis = axis_of_run(record, folder, record.link)
    return twin_of_run(folder.result(), folder, axis, given, ask)


def twin_of_run(
    result: RunResult, folder: RunFolder, axis: Axis, given: Mapping[str, str], ask: Ask
) -> MeasuredTwin:
    """The twin of what `result` measured on `axis`.

    Parameters
    ----------
    given : options of a virtual axis, at the motor, which go before what the run tells
    ask : asked for what neither tells

    Raises
    ------
    Refused
        The run measured nothing that can be trusted.
    UsageError
        It does not tell enough, and nobody is there to ask.
    """
    if not result.measured or result.friction.coulomb is None:
        raise Refused(
            f"run {result.run} measured no friction that can be trusted "
            f"({result.quality.verdict or result.status}): there is nothing to make a twin of",
            code="twin.no-friction",
        )
    told, said = _told(result, axis)
    for name, text in given.items():
        told.pop(name, None)
        said.pop(name, None)
        if name in _WHAT:
            said[name] = f"{_WHAT[name][0]}: {text}, as given"
    options = {name: repr(float(value)) for name, value in told.items()} | dict(given)
    for name, (what, unit) in _WHAT.items():
        if name not in options:
            value = ask(what, unit)
            if value is None:
                raise UsageError(
                    f"run {result.run} does not tell the {what}: give it at the motor with --set "
                    f"{name}=… ({unit})"
                )
            options[name] = repr(float(value))
            said[name] = f"{what}: {value:g} {unit}, as given"
    profile = _profile(folder, said)
    if axis.limits.ends is not None:
        said["ends"] = "the ends of its travel: left out, the twin starts at 0"
    virtual = configured("bench", _with_peak(options, said))
    virtual = replace(
        virtual, name=axis.name, title=f"Twin of run {result.run}",
        brake=axis.mechanics.held_by == "brake",
    )  # fmt: skip
    return MeasuredTwin(
        virtual,
        profile,
        _file(axis, result, profile),
        tuple(said.values()),
        parse(axis.link or "virtual://bench"),
    )


def _profile(folder: RunFolder, said: dict[str, str]) -> Profile | None:
    path = folder.profile_path()
    if not path.exists():
        said["profile"] = "profile: not in the run's folder; the virtual drive's own"
        return None
    profile = load_profile(str(path), lenient=True)
    return None if profile.name.startswith("virtual-") else profile


def _file(axis: Axis, result: RunResult, profile: Profile | None) -> Axis:
    """The axis of the twin: as the run had it, and as far as it was let go."""
    travel, limits = axis.travel, axis.limits.model_copy(update={"ends": None})
    allowed = result.experiment.limits if result.experiment else None
    if allowed is not None:
        travel = travel or allowed.travel
        torque, speed = limits.torque or allowed.torque, limits.speed or allowed.speed
        limits = limits.model_copy(update={"torque": torque, "speed": speed})
    cycle = axis.cycle or (result.experiment.cycle if result.experiment else None)
    return axis.model_copy(
        update={
            "cycle": cycle, "name": _twin_name(axis.name), "link": None, "travel": travel,
            "limits": limits, "profile": None if profile is None else profile.name,
        }
    )  # fmt: skip


def _twin_name(name: str) -> str:
    """A name of its own: what the twin measures is not of the axis."""
    return f"{name[: LONGEST_NAME - len(_TWIN)].rstrip()}{_TWIN}"


def _with_peak(options: Mapping[str, str], said: dict[str, str]) -> dict[str, str]:
    """With a peak torque; no run tells the drive's own."""
    if "peak" in options:
        return dict(options)
    try:
        peak = _PEAK * float(options["rated"])
    except ValueError:
        return dict(options)  # which is refused by its name
    said["peak"] = f"peak torque of the motor: {peak:.4g} N.m, three times rated"
    return {**options, "peak": repr(peak)}


# -- what a run tells -----------------------------------------------------------------------------


def _told(result: RunResult, axis: Axis) -> tuple[dict[str, float], dict[str, str]]:
    """Options of a virtual axis, at the motor, and what is to be said of where they are from."""
    effort = axis.mechanics.effort_per_torque
    found, said = result.friction, dict[str, str]()
    assert found.coulomb is not None
    options = {"coulomb": found.coulomb.value / effort}
    reading = getattr(result.methods, (found.method or "").replace("-", "_"), None)
    options |= _law(reading, effort, found.coulomb.value, said)
    offset = found.offset.value if found.offset else 0.0
    options["load"] = (offset + options.pop("bias", 0.0)) / effort
    scales = {"inertia": effort**2, "viscous": effort**2, "dead_time": 1.0}
    setup = result.experiment.setup if result.experiment else None
    for name, scale in scales.items():
        quantity: Quantity | None = getattr(found, name)
        value = quantity.value if quantity else _roughly(name, reading, setup, said)
        if value is not None:
            options["delay" if name == "dead_time" else name] = max(value, 0.0) / scale
    options |= _motor(setup, axis, said)
    if result.experiment is not None:
        options["cycle"] = result.experiment.cycle
        if result.experiment.limits is not None:
            options["travel"] = result.experiment.limits.travel * effort
            options["speed"] = result.experiment.limits.speed * effort
    options |= _drive_train(result, effort)
    warm = result.conditions.motor_temperature if result.conditions else None
    if warm is not None:
        options["temperature"] = warm
    return options, said


def _roughly(name: str, reading: object, setup: Setup | None, said: dict[str, str]) -> float | None:
    """A number that the run does not vouch for: of its method, or of the pushes before it."""
    option = "delay" if name == "dead_time" else name
    for source, where in (
        (reading, "of its method, which the run does not vouch for"),
        (setup and setup.first_look, "of its first look, which is rough"),
    ):
        value: float | None = getattr(source, name, None)
        if value is not None and (value > 0 or name == "viscous"):
            said[option] = f"{_WHAT[option][0]}: {max(value, 0.0):.4g} at the axis, {where}"
            return value
    return None


def _motor(setup: Setup | None, axis: Axis, said: dict[str, str]) -> dict[str, float]:
    """Rated torque and encoder: as the drive told them then, else by the axis file."""
    if setup is not None:
        bases = setup.bases
        return {"rated": bases.rated_torque, "encoder": bases.increments_per_revolution}
    options = {}
    if axis.rated_torque is not None:
        options["rated"] = axis.rated_torque
        said["rated"] = "rated torque: by the axis file"
    if axis.encoder is not None:
        options["encoder"] = axis.encoder
        said["encoder"] = "encoder: by the axis file"
    return options


def _law(reading: object, effort: float, coulomb: float, said: dict[str, str]) -> dict[str, float]:
    """The shape of friction at the motor, and what holds the axis at rest."""
    if isinstance(reading, SteadyReading):
        return _stribeck(reading.stribeck_level, reading.stribeck_speed, coulomb, effort)
    law = getattr(reading, "law", None)
    if not isinstance(law, LawReading):
        return {}
    return _by_law(law, coulomb, effort, said)


def _stribeck(
    level: float | None, speed: float | None, coulomb: float, effort: float
) -> dict[str, float]:
    """`level` : above Coulomb friction, N.m or N at the axis; `speed`: rad/s or m/s."""
    if not level or not speed:
        return {}
    return {"breakaway": (coulomb + level) / effort, "stribeck": speed * effort}


def _by_law(
    law: LawReading, coulomb: float, effort: float, said: dict[str, str]
) -> dict[str, float]:
    """The terms as `friction_laws.Law` orders them."""
    terms = list(law.coefficients[1:])
    options: dict[str, float] = {}
    if law.soft_speed is not None:
        bias = options["bias"] = terms.pop(0) if terms else 0.0  # a shifted sigmoid is 0 at rest
        options["soft"] = law.soft_speed * effort
        options["soft_shift"] = bias * law.soft_speed / coulomb * effort if coulomb else 0.0
    if law.stribeck_speed is not None and terms:
        options |= _stribeck(terms.pop(0), law.stribeck_speed, coulomb, effort)
        if law.stribeck_exponent is not None and law.stribeck_exponent != 2:
            options["stribeck_exponent"] = law.stribeck_exponent
    if "load" in law.terms and terms:
        options["load_friction"] = max(terms.pop(0), 0.0)
    if "drag" in law.terms and terms:
        options["drag"] = max(terms.pop(0), 0.0) / effort**3
    if "drift" in law.terms and terms:
        terms.pop(0)
        said["drift"] = "drift of friction: left out"
    if law.pitch is not None and len(terms) >= 2:
        options["cogging"] = hypot(*terms[:2]) / effort
        options["pitch"] = law.pitch * effort
        said["cogging"] = "cogging: of its size and pitch, from another start"
    return options


def _drive_train(result: RunResult, effort: float) -> dict[str, float]:
    """Two masses and play, where the run saw them."""
    seen = result.mechanics
    if seen is None:
        return {}
    options: dict[str, float] = {}
    if seen.resonance is not None and seen.motor_inertia is not None and seen.load_inertia:
        options["resonance"] = seen.resonance.value
        options["ratio"] = seen.load_inertia.value / seen.motor_inertia.value
        if seen.play is not None:
            options["backlash"] = seen.play.value * effort
    return options
