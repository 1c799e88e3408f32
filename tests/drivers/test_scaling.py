"""Raw values against SI, by hand-calculated drives."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drivers.described import described
from drivers.errors import WriteFailed
from drivers.scaling import Scaling
from profiles.axis import Mechanics
from profiles.library import load_profile
from tests.raising import raises

PROFILE = load_profile("virtual-modbus")
PARAMETERS = PROFILE.parameters
MOTOR = Scaling(1.27, 131072, Mechanics())
ON_MOTOR = described(PROFILE, MOTOR, constant_known=True)


def test_torque_is_a_share_of_the_rated_torque() -> None:
    assert ON_MOTOR["torque_target"].si(500) == pytest.approx(0.635)
    assert ON_MOTOR["torque_target"].raw(-0.127) == -100


def test_a_gear_divides_travel_and_multiplies_torque() -> None:
    geared = described(PROFILE, Scaling(1.27, 131072, Mechanics(gear=10)), constant_known=True)
    assert geared["position_actual"].si(131072) == pytest.approx(2 * math.pi / 10)
    assert geared["torque_target"].si(1000) == pytest.approx(12.7)
    assert geared["max_speed"].si(30000) == pytest.approx(3000 / 60 * 2 * math.pi / 10)


def test_a_screw_makes_metres_and_newtons() -> None:
    scaling = Scaling(1.27, 131072, Mechanics(motion="linear", feed=0.01))
    screw = described(PROFILE, scaling, constant_known=True)
    assert screw["position_actual"].si(131072) == pytest.approx(0.01)
    # 1.27 N.m on a 10 mm screw: 2 pi / 0.01 per metre
    assert screw["torque_target"].si(1000) == pytest.approx(1.27 * 2 * math.pi / 0.01)
    assert screw["torque_target"].unit == "N"
    # 1e-5 rated per rad/s of the motor, as N.s/m
    expected = 1e-5 * 1.27 * (2 * math.pi / 0.01) ** 2
    assert screw["viscous_gain"].step == pytest.approx(expected)


def test_out_of_range_is_refused_with_numbers_and_units() -> None:
    with pytest.raises(WriteFailed, match=r"'coulomb_positive': 2 N.m is outside 0…1.27 N.m"):
        ON_MOTOR["coulomb_positive"].checked_raw(2.0)


def test_a_forbidden_value_is_refused() -> None:
    parameter = PARAMETERS["quick_stop_option"].model_copy(update={"forbidden": (1, 2, 3)})
    with raises(WriteFailed, "write.range"):
        replace(ON_MOTOR["quick_stop_option"], parameter=parameter).checked_raw(2)
