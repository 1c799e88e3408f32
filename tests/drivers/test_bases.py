"""What a drive counts in, where its own objects say it: by hand, and refused where it cannot be."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest

from drivers.bases import read_bases
from drivers.errors import PreflightRefused
from profiles.axis import Axis
from profiles.library import load_profile
from tests.raising import raises

AXIS = Axis(name="x")


def told(values: Mapping[str, int]) -> Callable[[str], int | None]:
    """A drive that says this, and nothing else."""
    return values.get


def test_command_units_behind_an_electronic_gear() -> None:
    """DSY-RS: P18.07 counts P04.09 units where the encoder counts P04.07 increments.

    A 17 bit encoder with the gear as delivered, 131072 to 10000: 10000 units a revolution.
    """
    values = {
        "rated_torque": 127, "encoder_increments": 131072, "position_factor": 131072,
        "position_divisor": 10000,
    }  # fmt: skip
    scaling = read_bases(load_profile("dsy-rs"), AXIS, told(values))
    assert scaling.increments_per_revolution == pytest.approx(10000)
    assert scaling.rated_torque == pytest.approx(1.27)
    with raises(PreflightRefused, "scale.position"):
        read_bases(load_profile("dsy-rs"), AXIS, told({**values, "position_factor": 0}))


@pytest.mark.parametrize(("raw", "code"), [(1, "scale.torque"), (0, "scale.torque"), (2, "")])
def test_a_rated_torque_that_nobody_has_set_up_is_no_scale(raw: int, code: str) -> None:
    """Drives deliver 6076h as 0 or 1 mN.m; both mean that the motor is not set up."""
    values = {"rated_torque": raw, "encoder_increments": 4096, "encoder_revolutions": 1}
    profile = load_profile("cia402")
    if code:
        with raises(PreflightRefused, code):
            read_bases(profile, AXIS, told(values))
    else:
        assert read_bases(profile, AXIS, told(values)).rated_torque == pytest.approx(0.002)
    said = Axis(name="x", rated_torque=0.001)  # a small motor is told in the axis file
    assert read_bases(profile, said, told(values)).rated_torque == 0.001
