"""Each compensation law, by hand-calculated proposals."""

from __future__ import annotations

import pytest

from commissioning.compensation import propose
from commissioning.result.found import Found, Quantity
from drivers.described import Parameters, described
from drivers.errors import WriteFailed
from drivers.scaling import Scaling
from profiles.axis import Mechanics
from profiles.law import Compensation, CompensationLaw
from profiles.library import load_profile
from profiles.schema import Profile
from tests.raising import raises

BASE = load_profile("virtual-modbus")
SCALING = Scaling(1.0, 131072, Mechanics())
NAMES = ("torque_offset", "coulomb_positive", "coulomb_negative", "viscous_gain")
OLD = dict.fromkeys(NAMES, 0)


def with_law(**law: object) -> Profile:
    return BASE.model_copy(update={"compensation": Compensation.model_validate(law)})


def exactly(value: float, uncertainty: float = 0.0) -> Quantity:
    """A number with the relative half-width of its interval."""
    return Quantity(value, value * (1 - uncertainty), value * (1 + uncertainty), "")


def found(
    coulomb: float, offset: float | None, viscous: float | None = None, uncertainty: float = 0.0
) -> Found:
    return Found(
        "modulating", exactly(coulomb), None if offset is None else exactly(offset),
        None if viscous is None else exactly(viscous, uncertainty),
    )  # fmt: skip


def parameters(profile: Profile) -> Parameters:
    return described(profile, SCALING, constant_known=True)


def raw(profile: Profile, known: Found, fraction: float = 0.85) -> dict[str, int]:
    return {
        c.parameter: c.new_raw
        for c in propose(profile.compensation, parameters(profile), known, OLD, fraction)
    }


def test_coulomb_and_viscous_with_the_offset_whole() -> None:
    known = found(0.1, 0.0504, viscous=2e-3, uncertainty=0.1)
    assert raw(BASE, known) == {
        "torque_offset": 50, "coulomb_positive": 85, "coulomb_negative": 85, "viscous_gain": 170,
    }  # fmt: skip


def test_what_is_not_measured_is_not_written() -> None:
    assert raw(BASE, found(0.1, None)) == {"coulomb_positive": 85, "coulomb_negative": 85}
    vague = found(0.1, 0.0, viscous=2e-3, uncertainty=0.5)
    assert "viscous_gain" not in raw(BASE, vague)


def test_the_other_laws() -> None:
    known = found(0.1, 0.02)
    asymmetric = with_law(
        law=CompensationLaw.OFFSET_ASYMMETRIC, offset="torque_offset",
        positive="coulomb_positive", negative="coulomb_negative",
    )  # fmt: skip
    assert raw(asymmetric, known, 1.0) == {
        "torque_offset": 20, "coulomb_positive": 100, "coulomb_negative": 100,
    }  # fmt: skip
    single = with_law(law=CompensationLaw.SINGLE_GAIN, gain="coulomb_positive")
    assert raw(single, known, 0.5) == {"coulomb_positive": 50}
    saturated = with_law(
        law=CompensationLaw.SATURATED_LINEAR, gain="coulomb_positive", speed="viscous_gain"
    )
    assert raw(saturated, known) == {"coulomb_positive": 85}
    none = with_law(law=CompensationLaw.NONE)
    assert propose(none.compensation, parameters(none), known, OLD) == []


def test_a_drive_that_stores_the_negative_direction_with_its_sign() -> None:
    signed = with_law(
        law=CompensationLaw.OFFSET_ASYMMETRIC, positive="coulomb_positive",
        negative="torque_offset", negative_sign=-1,
    )  # fmt: skip
    assert raw(signed, found(0.1, None), 1.0) == {"coulomb_positive": 100, "torque_offset": -100}


def test_rounding_is_said() -> None:
    change = propose(BASE.compensation, parameters(BASE), found(0.10236, None), OLD)[0]
    assert change.new == pytest.approx(0.087)
    assert change.rounded_by == pytest.approx(-6e-6)


def test_a_friction_outside_the_drive_s_range_is_refused() -> None:
    with raises(WriteFailed, "write.range"):
        propose(BASE.compensation, parameters(BASE), found(1.5, None), OLD)
