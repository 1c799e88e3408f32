"""Gains from a run: every rule, for the loop over the link and for the loop inside the drive."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, pi
from typing import Any

import numpy as np

from commissioning.identification.critical_point import CriticalPoint
from commissioning.runs import resolve
from commissioning.session.apply import axis_of_run
from commissioning.session.desk import Desk
from commissioning.session.points import TARGETS
from commissioning.tuning.controllers import Gains
from commissioning.tuning.plant import LoopPlant
from commissioning.tuning.proposals import Hold, Known, Proposal, proposals
from commissioning.tuning.rules import Cascade
from commissioning.tuning.step import Friction, Step
from drivers.scaling import Scaling
from profiles.axis import Axis
from profiles.errors import Refused, UsageError, WriteFailed
from profiles.library import load_profile
from profiles.schema import Profile

__all__ = ["DriveLoop", "Tuned", "tune", "tune_run"]

_SHOWN = 100  # points of a step in the JSON
_SEEN = 7  # harmonics of a square wave that show the axis
_RIGID, _RIGID_NOISE = 0.006, 3.0  # of the torque, and times the noise: left by a rigid axis
_HARMONICS_AGREE = 0.05  # of the friction
_MOST_PERIODS = 200  # of a drive's loops in their dead time
_DEFAULT_PERIOD = 0.00025  # s, of a drive's own loops where only their dead time is given


@dataclass(frozen=True, slots=True)
class DriveLoop:
    """What is known of the drive's own loops beside the profile, s; None: the profile's."""

    dead_time: float | None = None
    period: float | None = None


@dataclass(frozen=True, slots=True)
class Tuned:
    """`tuning` of the result JSON, and what there is to say about it."""

    sets: list[dict[str, Any]]
    notes: list[str]


def tune(result: dict[str, Any], axis: Axis, profile: Profile, drive: DriveLoop) -> Tuned:
    """Gains for the axis of a completed run.

    Raises
    ------
    Refused
        The run is rejected or measured nothing: no gain can be proposed.
    UsageError
        The run is from an older tworelay and lacks what is needed.
    """
    run = result.get("run")
    coulomb = result["friction"].get("coulomb")
    if result["status"] != "completed" or not coulomb or coulomb["value"] is None:
        raise Refused(
            f"run {run} is {result['status']}: without a friction that can be trusted no gain is "
            "proposed; identify the axis again"
        )
    try:
        with np.errstate(divide="raise", invalid="raise"):
            return _tune(result, axis, profile, drive)
    except (KeyError, TypeError, IndexError, ArithmeticError, ValueError) as error:
        raise UsageError(
            f"run {run}: lacks what tuning needs ({type(error).__name__}: {error}); identify the axis "
            "again"
        ) from None


def _tune(result: dict[str, Any], axis: Axis, profile: Profile, drive: DriveLoop) -> Tuned:
    friction, experiment = result["friction"], result["experiment"]
    notes: list[str] = []
    unknown = [
        text
        for key, text in (("inertia", "inertia"), ("dead_time", "dead time"))
        if friction[key]["value"] is None
    ]
    if unknown:
        raise Refused(
            f"run {result['run']}: {' and '.join(unknown)} could not be identified, so no gain is "
            "proposed; more travel, or method auto, would show it"
        )
    known = _known(result)
    dead_time, cycle = friction["dead_time"]["value"], experiment["cycle"]
    viscous = known.viscous or 0.0
    host = LoopPlant(known.inertia, viscous, dead_time + experiment["turnaround"], cycle)
    sets = [_json(p, None) for p in proposals(known, "host", host)]
    own = _own_loop(profile, drive, experiment.get("loop_lag", 0.0))
    if own is None:
        notes.append(
            f"no gains for the drive's own loops: profile '{profile.name}' does not say their dead "
            "time; give --drive-dead-time"
        )
        return Tuned(_marked(sets), notes)
    inside = LoopPlant(known.inertia, viscous, *own)
    bases = experiment["bases"]
    scaling = Scaling(
        bases["rated_torque"], bases["increments_per_revolution"], axis.mechanics,
        bases.get("torque_constant", 0.0),
    )  # fmt: skip
    sets += [
        _json(proposal, _parameters(proposal, profile, scaling))
        for proposal in proposals(known, "drive", inside, _holder(profile, scaling))
    ]
    return Tuned(_marked(sets), notes)


def _known(result: dict[str, Any]) -> Known:
    friction, experiment = result["friction"], result["experiment"]
    points = result["critical_point"] or {}
    first = experiment["first_look"]
    coulomb = friction["coulomb"]["value"]
    return Known(
        inertia=friction["inertia"]["value"],
        viscous=friction["viscous"]["value"],
        dead_time=friction["dead_time"]["value"],
        friction_share=coulomb / experiment["cycles"][0]["relay_amplitude"],
        naive=_point(points.get("naive")),
        corrected=_point(points.get("corrected")),
        measured={
            phase: point
            for key, phase in TARGETS.items()
            if (tree := points.get(key)) and tree["how"] == "measured" and (point := _point(tree))
        },
        friction=Friction(
            coulomb,
            max(first["breakaway"], coulomb),
            friction["offset"]["value"],
            experiment["limits"]["torque"],
            experiment["resolution"],
        ),
        travel=experiment["limits"]["travel"],
        seen=_seen(result),
    )


def _point(tree: dict[str, Any] | None) -> CriticalPoint | None:
    return tree and CriticalPoint(tree["gain"], tree["phase_deg"], tree["period"])  # type: ignore[return-value]


def _seen(result: dict[str, Any]) -> float:
    """Frequency up to which the record shows a rigid axis, rad/s.

    A square wave shows it up to its seventh harmonic; where the model leaves something, or the harmonics
    contradict each other, only at the fundamental.
    """
    fundamental = 2 * pi / result["experiment"]["cycles"][0]["period"]
    methods = result["methods"]
    if "modulating" in methods:
        fit = methods["modulating"]
        rigid = fit["held_out"] <= max(_RIGID, _RIGID_NOISE * fit["noise"])
    else:
        f = methods["lock-in"]["harmonics"]
        rigid = abs(f["5"] / f["1"] - 1) < _HARMONICS_AGREE
    return float((_SEEN if rigid else 1) * fundamental)


def _own_loop(profile: Profile, drive: DriveLoop, lag: float) -> tuple[float, float] | None:
    """Dead time and period of the drive's own loops, s; `lag`: what the drive itself says of its torque."""
    loops = profile.loops
    dead_time = drive.dead_time
    if dead_time is None:
        dead_time = None if loops is None else loops.dead_time + lag
    if dead_time is None:
        return None
    period = drive.period or (loops.period if loops else _DEFAULT_PERIOD)
    if dead_time > _MOST_PERIODS * period:
        raise UsageError(
            f"a dead time of {dead_time:g} s is {dead_time / period:.0f} periods of the drive's loops of "
            f"{period:g} s: at most {_MOST_PERIODS} make a loop; are both in seconds?"
        )
    return dead_time, period


def _mapped(profile: Profile, gains: Gains | None) -> bool:
    """Whether the drive has these gains: a cascade, and the profile says where."""
    has = profile.loops is not None and bool(profile.loops.terms)
    return has and isinstance(gains, Cascade) and gains.position_gain > 0


def _holder(profile: Profile, scaling: Scaling) -> Hold:
    """Gains as the drive holds them, rounded to its steps; raises ValueError where it cannot."""

    def hold(gains: Gains) -> Gains:
        if not _mapped(profile, gains) or profile.loops is None:
            return gains
        held = {}
        for term, name in profile.loops.terms.items():
            parameter, value = profile.parameters[name], getattr(gains, term)
            try:
                raw = scaling.checked_raw(name, parameter, value)
            except WriteFailed as error:
                text = str(error).removesuffix("; nothing was written")
                raise ValueError(f"out of range: {text}") from None
            if not raw:
                step, unit = scaling.step(parameter), scaling.unit_text(parameter)
                raise ValueError(
                    f"too fine: '{name}' would be {value:.3g} {unit}, the drive's step is {step:.3g}"
                )
            held[term] = scaling.to_si(parameter, raw)
        return Cascade(**held)

    return hold


def _parameters(
    proposal: Proposal, profile: Profile, scaling: Scaling
) -> list[dict[str, Any]] | None:
    """The gains in the drive's own units, where the profile maps them."""
    if not _mapped(profile, proposal.gains) or profile.loops is None or not proposal.proposed:
        return None
    found = []
    for term, name in profile.loops.terms.items():
        parameter, value = profile.parameters[name], getattr(proposal.gains, term)
        raw = scaling.to_raw(parameter, value)
        found.append(
            {
                "parameter": name, "new": value, "unit": scaling.unit_text(parameter),
                "new_raw": raw, "raw_unit": scaling.raw_unit(parameter),
                "rounded_by": scaling.to_si(parameter, raw) - value,
            }
        )  # fmt: skip
    return found


def _json(proposal: Proposal, parameters: list[dict[str, Any]] | None) -> dict[str, Any]:
    worth, point, gains = proposal.margins, proposal.point, proposal.gains
    return {
        "rule": proposal.rule,
        "loop": proposal.loop,
        "source": proposal.source,
        "point": point
        and {"gain": point.gain, "phase_deg": point.phase_deg, "period": point.period},
        "gains": gains
        and {
            name: value if isfinite(value := getattr(gains, name)) else None
            for name in gains.__slots__
        },
        "phase_margin_deg": worth and worth.phase,
        "gain_margin_db": worth and worth.gain_db,
        "ms": worth and worth.sensitivity,
        "stable": worth and worth.stable,
        "crossover": worth and worth.crossover,
        "bandwidth": worth and worth.bandwidth,
        "step": proposal.step and _step(proposal.step),
        "proposed": proposal.proposed,
        "best": False,
        "why_not": proposal.why_not,
        "parameters": parameters or [],
        "written": False,
    }


def _step(step: Step) -> dict[str, Any]:
    stride = max(len(step.time) // _SHOWN, 1)
    return {
        "size": step.size,
        "overshoot": step.overshoot,
        "settling": step.settling,
        "error": step.error,
        "hunting": step.hunting,
        "time": [float(f"{t:.5g}") for t in step.time[::stride]],
        "position": [float(f"{y:.5g}") for y in step.position[::stride]],
    }


def _marked(sets: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The fastest of the proposed sets of each loop is its best."""
    for loop in ("host", "drive"):
        sound = [s for s in sets if s["loop"] == loop and s["proposed"] and s["step"]]
        if sound:
            max(sound, key=lambda s: s["crossover"])["best"] = True
    return sets


def tune_run(run: str, drive: DriveLoop, desk: Desk) -> tuple[dict[str, Any], list[str]]:
    """Tune a run, keep the gains with it, and return its result and what there is to say."""
    run_id, folder = resolve(desk.journal, run)
    result = folder.result()
    axis = axis_of_run(folder.record(desk.journal, run_id), folder, None)
    tuned = tune(result, axis, load_profile(axis.profile or ""), drive)
    for item in tuned.sets:  # what is in the drive stays said
        item["written"] = any(
            before.get("written") and before["parameters"] == item["parameters"] != []
            for before in result["tuning"]
        )
    result["tuning"] = tuned.sets
    folder.save(result, None, None)
    return result, tuned.notes
