"""What each method found, as its reading in a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

from commissioning.identification.lock_in import LockIn
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.output_error import OutputErrorEstimate
from commissioning.identification.phase_locked import PhaseLocked
from commissioning.identification.steady import SteadyFit, SteadyPoint
from commissioning.identification.two_relay import FrictionEstimate
from commissioning.result.found import QUANTITIES
from commissioning.result.readings import (
    BalanceReading,
    LawReading,
    ModulatingReading,
    OutputErrorReading,
    ProgressReading,
    Speed,
    SteadyReading,
    TwoRelayReading,
)

__all__ = [
    "balance_reading",
    "modulating_reading",
    "output_error_reading",
    "steady_reading",
    "two_relay_reading",
]

_CHECKS = (  # of modulating functions, in the order of their reading
    "residual", "held_out", "rigid_residual", "condition", "halves", "widths", "noise", "periods",
    "windows", "reversals", "low_speed", "peak_speed",
)  # fmt: skip


def two_relay_reading(found: FrictionEstimate) -> TwoRelayReading:
    """The thesis' balance of two relay tests."""
    a, b = found.first, found.second
    return TwoRelayReading(
        found.coulomb.value,
        found.complex_coulomb.real,
        found.complex_coulomb.imag,
        abs(found.complex_coulomb),
        half_swing=(a.half_swing, b.half_swing),
        fundamental=(a.fundamental, b.fundamental),
        period=(a.period, b.period),
        periods=(a.periods, b.periods),
        relay_amplitude=(a.relay_amplitude, b.relay_amplitude),
        hysteresis=(a.hysteresis, b.hysteresis),
        bias=(a.bias, b.bias),
        duty=(a.duty, b.duty),
        settled=(a.settled, b.settled),
    )


def balance_reading(found: LockIn | PhaseLocked) -> BalanceReading:
    """A balance on measured phasors."""
    reading = BalanceReading(
        found.coulomb.value,
        found.complex_coulomb.real,
        found.complex_coulomb.imag,
        abs(found.complex_coulomb),
        half_swing=tuple(found.half_swing),
        fundamental=tuple(found.fundamental),
        period=found.period,
        periods=tuple(found.periods),
        **{name: getattr(found, name).value for name in QUANTITIES[1:] if hasattr(found, name)},
    )
    if isinstance(found, PhaseLocked):
        return replace(reading, phase_deg=tuple(found.phase_deg))
    return replace(
        reading,
        harmonics=dict(zip(("1", "3", "5"), found.harmonics, strict=True)),
        rejected=tuple(found.rejected),
        plant=(found.plant.real, found.plant.imag),
    )


def modulating_reading(found: ModulatingEstimate) -> ModulatingReading:
    """Modulating functions: numbers, law, and what says how far to trust them."""
    law = found.law
    return ModulatingReading(
        found.coulomb.value, found.offset.value, found.viscous.value, found.inertia.value,
        found.dead_time.value,
        LawReading(
            ("coulomb", "viscous", *law.rungs), law.stribeck, law.soft, law.position,
            tuple(found.coefficients.tolist()),
            None if law.stribeck is None else law.exponent,
        ),
        *(_finite(getattr(found, name)) for name in _CHECKS),
    )  # fmt: skip


def output_error_reading(found: OutputErrorEstimate) -> OutputErrorReading:
    """Output error: numbers, law, what is left, and what fewer periods would have given."""
    return OutputErrorReading(
        coulomb=found.coulomb.value,
        offset=found.offset.value,
        viscous=found.viscous.value,
        inertia=found.inertia.value,
        dead_time=found.dead_time.value,
        lag=found.lag.value,
        lag_low=found.lag.low,
        lag_high=found.lag.high,
        terms={str(term): found.size(term) for term in found.terms},
        left=found.rms,
        noise=found.noise,
        colour=found.colour,
        misfit=found.misfit,
        explained=found.is_explained,
        samples=found.samples,
        periods=found.periods,
        low_speed=found.low_speed,
        peak_speed=found.peak_speed,
        progress=tuple(
            ProgressReading(one.periods, one.coulomb.value, one.coulomb.low, one.coulomb.high)
            for one in found.progress
        ),
    )


def steady_reading(found: SteadyFit, points: Sequence[SteadyPoint]) -> SteadyReading:
    """Friction from constant speeds."""
    return SteadyReading(
        found.coulomb.value,
        found.offset.value,
        found.viscous.value,
        found.stribeck_level,
        found.stribeck_speed,
        _finite(found.rms),
        _finite(found.held_out),
        tuple(Speed(p.speed, p.torque, p.error) for p in points),
    )


def _finite(value: float | None) -> float | None:
    """Not known is None."""
    return float(value) if value is not None and isfinite(value) else None
