"""Raw values against SI, by hand-calculated drives."""

from __future__ import annotations

import math

import pytest

from drivers.errors import WriteFailed
from drivers.scaling import Scaling
from profiles.axis import Mechanics
from profiles.library import load_profile

PARAMETERS = load_profile("virtual-modbus").parameters
MOTOR = Scaling(1.27, 131072, Mechanics())


def test_torque_is_a_share_of_the_rated_torque() -> None:
    assert MOTOR.to_si(PARAMETERS["torque_target"], 500) == pytest.approx(0.635)
    assert MOTOR.to_raw(PARAMETERS["torque_target"], -0.127) == -100


def test_a_gear_divides_travel_and_multiplies_torque() -> None:
    geared = Scaling(1.27, 131072, Mechanics(gear=10))
    assert geared.to_si(PARAMETERS["position_actual"], 131072) == pytest.approx(2 * math.pi / 10)
    assert geared.to_si(PARAMETERS["torque_target"], 1000) == pytest.approx(12.7)
    assert geared.to_si(PARAMETERS["max_speed"], 30000) == pytest.approx(
        3000 / 60 * 2 * math.pi / 10
    )


def test_a_screw_makes_metres_and_newtons() -> None:
    screw = Scaling(1.27, 131072, Mechanics(motion="linear", feed=0.01))
    assert screw.to_si(PARAMETERS["position_actual"], 131072) == pytest.approx(0.01)
    # 1.27 N.m on a 10 mm screw: 2 pi / 0.01 per metre
    assert screw.to_si(PARAMETERS["torque_target"], 1000) == pytest.approx(
        1.27 * 2 * math.pi / 0.01
    )
    assert screw.unit_text(PARAMETERS["torque_target"]) == "N"
    # 1e-5 rated per rad/s of the motor, as N.s/m
    expected = 1e-5 * 1.27 * (2 * math.pi / 0.01) ** 2
    assert screw.step(PARAMETERS["viscous_gain"]) == pytest.approx(expected)


def test_out_of_range_is_refused_with_numbers_and_units() -> None:
    with pytest.raises(WriteFailed, match=r"'coulomb_positive': 2 N.m is outside 0…1.27 N.m"):
        MOTOR.checked_raw("coulomb_positive", PARAMETERS["coulomb_positive"], 2.0)


def test_a_forbidden_value_is_refused() -> None:
    parameter = PARAMETERS["quick_stop_option"].model_copy(update={"forbidden": (1, 2, 3)})
    with pytest.raises(WriteFailed, match="must never be written"):
        MOTOR.checked_raw("P2-30", parameter, 2)
