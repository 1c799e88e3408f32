"""Raw values against SI, by hand-calculated drives."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drivers.described import described
from drivers.errors import WriteFailed
from drivers.scaling import Scaling
from drivers.writing import why_not_written
from profiles.axis import Mechanics
from profiles.library import load_profile
from profiles.parameter import Unit
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


def test_what_is_counted_behind_the_gear_does_not_know_it() -> None:
    """Festo CMMT, page 377: the table is N.m and rad/s at the output of the gear."""
    festo = load_profile("festo-cmmt")
    behind = described(festo, Scaling(1.0, 4096, Mechanics(gear=5)), constant_known=True)
    speed, torque = behind["friction_velocity_1"], behind["friction_torque_1"]
    assert (speed.step, torque.step) == (1.0, 1.0)  # the axis is the output
    assert not torque.lacks_gear
    # on a screw of 20 mm: 2 N.m at the shaft are 2 x 2 pi / 0.02 N, 1 rad/s is 0.02 / (2 pi) m/s
    screw = Mechanics(motion="linear", feed=0.02, gear=5)
    behind = described(festo, Scaling(1.0, 4096, screw), constant_known=True)
    assert behind["friction_torque_1"].step == pytest.approx(2 * math.pi / 0.02)
    assert behind["friction_velocity_1"].step == pytest.approx(0.02 / (2 * math.pi))
    unsaid = described(festo, Scaling(1.0, 4096, Mechanics()), constant_known=True)
    why = why_not_written(unsaid["friction_torque_1"])
    assert why is not None
    assert why.code == "write.gear"


def test_viscous_friction_and_stiffness_of_the_motor() -> None:
    axis = Scaling(2.0, 4096, Mechanics(gear=10))
    assert axis.step_of(Unit.TORQUE_PER_SPEED) == pytest.approx(100.0)  # by the gear, squared
    assert axis.step_of(Unit.STIFFNESS) == pytest.approx(100.0)


def test_out_of_range_is_refused_with_numbers_and_units() -> None:
    with pytest.raises(WriteFailed, match=r"'coulomb_positive': 2 N.m is outside 0…1.27 N.m"):
        ON_MOTOR["coulomb_positive"].checked_raw(2.0)


def test_a_forbidden_value_is_refused() -> None:
    parameter = PARAMETERS["quick_stop_option"].model_copy(update={"forbidden": (1, 2, 3)})
    with raises(WriteFailed, "write.range"):
        replace(ON_MOTOR["quick_stop_option"], parameter=parameter).checked_raw(2)
