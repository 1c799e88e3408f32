"""The result of a run as JSON (`tworelay.run/1`). Not measured is null, never 0."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

from commissioning.compensation import Change
from commissioning.identification.critical_point import (
    CriticalPoint,
    hysteresis_only,
    naive,
)
from commissioning.identification.estimate import Estimate
from commissioning.identification.lock_in import LockIn
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.phase_locked import PhaseLocked
from commissioning.identification.steady import SteadyFit, SteadyPoint
from commissioning.identification.two_relay import FrictionEstimate
from commissioning.identification.verdict import Reason, Weight, verdict
from commissioning.session.methods import Measured, Oscillation, Wished
from commissioning.session.points import TARGETS
from drivers.scaling import Scaling
from profiles.axis import Axis
from profiles.errors import MeasurementRejected
from profiles.library import digest
from profiles.schema import Identity, Profile

__all__ = ["blank", "changes_json", "critical_points", "estimate_json", "friction_json"]

SCHEMA = "tworelay.run/1"
QUANTITIES = ("coulomb", "offset", "viscous", "inertia", "dead_time")


def units(axis: Axis) -> dict[str, str]:
    """ASCII units of the quantities of this axis."""
    p, e = axis.position_unit, axis.effort_unit
    return {
        "position": p,
        "effort": e,
        "coulomb": e,
        "offset": e,
        "viscous": f"{e}.s/{p}",
        "inertia": "kg.m2" if p == "rad" else "kg",
        "dead_time": "s",
        "gain": f"{p}/({e})" if p == "rad" else f"{p}/{e}",
        "stiffness": f"{e}/{p}",
    }


def blank(axis: Axis, link: str | None, profile: Profile | None, identity: Identity | None) -> Any:
    """A result in which nothing is measured yet."""
    names = units(axis)
    return {
        "schema": SCHEMA,
        "status": "failed",
        "run": None,
        "axis": axis.name,
        "link": link,
        "profile": None
        if profile is None
        else {"name": profile.name, "version": profile.version, "hash": digest(profile)},
        "identity": None if identity is None else identity.model_dump(),
        "units": names,
        "friction": {
            "method": None,
            **{key: estimate_json(None, names[key]) for key in QUANTITIES},
        },
        "methods": {},
        "critical_point": None,
        "tuning": [],
        "compensation": [],
        "host_compensation": None,
        "experiment": None,
        "quality": {"verdict": "rejected", "reasons": []},
        "notes": [],
    }


def estimate_json(
    estimate: Estimate | None, unit: str, raw: float | None = None, raw_unit: str | None = None
) -> dict[str, Any]:
    """One quantity with its interval, in SI and as the drive counts."""
    return {
        "value": None if estimate is None else estimate.value,
        "low": None if estimate is None else estimate.low,
        "high": None if estimate is None else estimate.high,
        "unit": unit,
        "raw": raw,
        "raw_unit": raw_unit,
    }


def judge(result: dict[str, Any], reasons: Sequence[Reason]) -> None:
    """Put the verdict into `result`, weightiest reason first; raises MeasurementRejected."""
    ordered = sorted(reasons, key=lambda reason: -reason.weight)
    result["quality"] = {"verdict": verdict(ordered), "reasons": [r.text for r in ordered]}
    if result["quality"]["verdict"] == "rejected":
        worst = [r.text for r in ordered if r.weight is Weight.CONTRADICTION]
        raise MeasurementRejected("; ".join(worst))


def friction_json(
    method: str,
    estimates: dict[str, Estimate | None],
    axis: Axis,
    profile: Profile,
    scaling: Scaling,
) -> dict[str, Any]:
    """The `friction` object; torques also in the drive's own unit."""
    names = units(axis)
    parameter = profile.parameters["torque_target"]
    found: dict[str, Any] = {"method": method}
    for key in QUANTITIES:
        estimate = estimates.get(key)
        if key in ("coulomb", "offset") and estimate is not None:
            raw = estimate.value / scaling.step(parameter)
            found[key] = estimate_json(estimate, names[key], raw, scaling.raw_unit(parameter))
        else:
            found[key] = estimate_json(estimate, names[key])
    return found


def methods_json(measured: Measured) -> dict[str, Any]:
    """Every method that was run."""
    found: dict[str, Any] = {}
    for name in ("two_relay", "two_relay_delay"):
        balance = getattr(measured, name)
        if balance is not None:
            found[name.replace("_", "-")] = two_relay_json(balance)
    if measured.phase_locked is not None:
        found["phase-locked"] = balance_json(measured.phase_locked)
    if measured.lock_in is not None:
        found["lock-in"] = balance_json(measured.lock_in)
    if measured.modulating is not None:
        found["modulating"] = modulating_json(measured.modulating)
    return found


def two_relay_json(estimate: FrictionEstimate) -> dict[str, Any]:
    """The thesis' balance: its complex friction and both tests."""
    cycles = (estimate.first, estimate.second)
    return {
        "coulomb": estimate.coulomb.value,
        "real": estimate.complex_coulomb.real,
        "imaginary": estimate.complex_coulomb.imag,
        "modulus": abs(estimate.complex_coulomb),
        "half_swing": [c.half_swing for c in cycles],
        "fundamental": [c.fundamental for c in cycles],
        "period": [c.period for c in cycles],
        "periods": [c.periods for c in cycles],
        "relay_amplitude": [c.relay_amplitude for c in cycles],
        "hysteresis": [c.hysteresis for c in cycles],
        "bias": [c.bias for c in cycles],
        "duty": [c.duty for c in cycles],
        "settled": [c.settled for c in cycles],
    }


def balance_json(estimate: LockIn | PhaseLocked) -> dict[str, Any]:
    """A balance on measured phasors."""
    found: dict[str, Any] = {
        key: getattr(estimate, key).value for key in QUANTITIES if hasattr(estimate, key)
    }
    found |= {
        "real": estimate.complex_coulomb.real,
        "imaginary": estimate.complex_coulomb.imag,
        "modulus": abs(estimate.complex_coulomb),
        "half_swing": list(estimate.half_swing),
        "fundamental": list(estimate.fundamental),
        "period": estimate.period,
        "periods": list(estimate.periods),
        "hysteresis": None,
    }
    if isinstance(estimate, LockIn):
        found["harmonics"] = dict(zip(("1", "3", "5"), estimate.harmonics, strict=True))
        found["rejected"] = list(estimate.rejected)
        found["plant"] = [estimate.plant.real, estimate.plant.imag]
    else:
        found["phase_deg"] = list(estimate.phase_deg)
    return found


def modulating_json(estimate: ModulatingEstimate) -> dict[str, Any]:
    """Modulating functions: the numbers, the friction law, and what says how far to trust them."""
    import numpy as np

    numbers = {key: getattr(estimate, key).value for key in QUANTITIES}
    checks = (
        "residual", "held_out", "rigid_residual", "condition", "halves", "widths", "noise",
        "periods", "windows", "reversals", "low_speed", "peak_speed",
    )  # fmt: skip
    law = estimate.law
    speed = np.geomspace(0.002, 1, 40) * estimate.peak_speed
    return (
        numbers
        | {key: _finite(getattr(estimate, key)) for key in checks}
        | {
            "law": {
                "terms": ["coulomb", "viscous", *law.rungs],
                "stribeck_speed": law.stribeck,
                "soft_speed": law.soft,
                "pitch": law.position,
                "coefficients": estimate.coefficients.tolist(),
            },
            "curve": {"speed": speed.tolist(), "friction": estimate.curve(speed).tolist()},
        }
    )


def _finite(value: float) -> float | None:
    """Not known is null."""
    return value if isfinite(value) else None


def steady_json(
    estimate: SteadyFit, points: Sequence[SteadyPoint], fastest: float
) -> dict[str, Any]:
    """The friction curve from constant speeds."""
    import numpy as np

    speed = np.geomspace(0.005, 1, 40) * fastest
    return {
        "coulomb": estimate.coulomb.value,
        "offset": estimate.offset.value,
        "viscous": estimate.viscous.value,
        "stribeck_level": estimate.stribeck_level,
        "stribeck_speed": estimate.stribeck_speed,
        "rms": _finite(estimate.rms),
        "held_out": _finite(estimate.held_out),
        "points": [{"speed": p.speed, "torque": p.torque, "error": p.error} for p in points],
        "curve": {"speed": speed.tolist(), "friction": estimate.curve(speed).tolist()},
    }


def cycles_json(shown: Sequence[Oscillation]) -> list[dict[str, Any]]:
    """The oscillations that the report shows; not measured is null."""
    names = (
        "relay_amplitude", "hysteresis", "bias", "period", "half_swing", "fundamental", "duty",
        "periods", "settled",
    )  # fmt: skip
    return [
        {"name": one.name}
        | {name: None if (value := getattr(one.cycle, name)) != value else value for name in names}
        for one in shown
    ]


def critical_points(measured: Measured, right: CriticalPoint | None) -> dict[str, Any]:
    """The readings at the relay's own frequency (`right`: the corrected one), and the points wanted."""
    wanted = {key: _wished_json(measured.points.get(key)) for key in TARGETS}
    return {
        "naive": _point_json(naive(measured.relay)),
        "hysteresis": _point_json(hysteresis_only(measured.relay)),
        "corrected": _point_json(right),
        "measured": _point_json(measured.second),
        **wanted,
    }


def _wished_json(wished: Wished | None) -> dict[str, Any] | None:
    found = _point_json(wished.point) if wished is not None else None
    return found and {**found, "travel_needed": wished.travel if wished else None}


def _point_json(point: CriticalPoint | None) -> dict[str, Any] | None:
    if point is None:
        return None
    gain, phase = point.gain_error, point.phase_error
    return {
        "gain": point.gain,
        "gain_low": None if gain is None else point.gain * max(1 - gain, 0.0),
        "gain_high": None if gain is None else point.gain * (1 + gain),
        "phase_deg": point.phase_deg,
        "phase_low_deg": None if phase is None else point.phase_deg - phase,
        "phase_high_deg": None if phase is None else point.phase_deg + phase,
        "period": point.period,
        "ku": point.ku,
        "how": "measured" if point.measured else "computed",
    }


def changes_json(changes: Sequence[Change]) -> list[dict[str, Any]]:
    """The proposal."""
    return [
        {
            "parameter": c.parameter,
            "old": c.old,
            "new": c.new,
            "unit": c.unit,
            "rounded_by": c.rounded_by,
            "old_raw": c.old_raw,
            "new_raw": c.new_raw,
            "raw_unit": c.raw_unit,
            "why": c.why,
            "written": False,
        }
        for c in changes
    ]
