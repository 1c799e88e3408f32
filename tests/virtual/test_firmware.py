"""The virtual drive's firmware against CiA 402 and against its own statements."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drivers.virtual.axes import AXES, configured
from drivers.virtual.compliant_plant import CompliantPlant
from drivers.virtual.firmware import SECOND, Firmware
from drivers.virtual.memory import Memory
from drivers.virtual.states import Denied, State

MS = 1_000_000


def drive(name: str = "bench", memory: Memory | None = None, **options: str) -> Firmware:
    return Firmware(configured(name, options), memory)


def enable(firmware: Firmware, mode: int = 10) -> Firmware:
    firmware.write("mode", mode)
    for word in (0x06, 0x07, 0x0F):
        firmware.write("controlword", word)
    firmware.advance(100 * MS)
    assert firmware.state is State.OPERATION_ENABLED
    return firmware


# CiA 402, state transitions by controlword: (from, controlword, to)
TRANSITIONS = [
    ([], 0x06, 0x21), ([0x06], 0x07, 0x23), ([0x06, 0x07], 0x0F, 0x27),
    ([0x06], 0x00, 0x40), ([0x06, 0x07], 0x00, 0x40), ([0x06, 0x07], 0x06, 0x21),
    ([0x06, 0x07, 0x0F], 0x00, 0x40), ([0x06], 0x02, 0x40), ([], 0x0F, 0x40), ([], 0x07, 0x40),
    ([0x06], 0x0F, 0x21),
]  # fmt: skip


@pytest.mark.parametrize(("path", "word", "expected"), TRANSITIONS)
def test_the_state_machine_of_cia_402(path: list[int], word: int, expected: int) -> None:
    firmware = drive()
    firmware.write("mode", 10)
    for step in path:
        firmware.write("controlword", step)
    firmware.write("controlword", word)
    mask = 0x6F if expected not in (0x40, 0x08) else 0x4F
    assert firmware.statusword & mask == expected


def test_quick_stop_decelerates_and_ends_de_energised() -> None:
    firmware = enable(drive())
    firmware.command_torque(500)
    firmware.advance(40 * MS)
    assert firmware.plant.velocity > 5
    firmware.write("controlword", 0x02)
    assert firmware.statusword & 0x6F == 0x07
    firmware.advance(50 * MS)
    assert firmware.plant.velocity == 0.0
    assert firmware.state is State.SWITCH_ON_DISABLED
    assert not firmware.energised


def test_a_torque_command_acts_after_the_delay_and_not_before() -> None:
    firmware = enable(drive(delay="0.003"))
    firmware.command_torque(500)
    firmware.advance(3 * MS - 1)
    assert firmware.plant.velocity == 0.0
    firmware.advance(5 * MS)
    # (0.5 - 0.1) N.m on 1e-3 kg.m2 for 5 ms, viscous friction in the fourth digit
    assert firmware.plant.velocity == pytest.approx(400 * 5e-3, rel=0.01)


def test_the_torque_limit_acts_and_says_so() -> None:
    firmware = enable(drive())
    firmware.write("max_torque", 200)
    firmware.command_torque(900)
    firmware.advance(10 * MS)
    assert firmware.torque == 200
    assert firmware.statusword & 0x0800


def test_the_speed_limit_acts_in_torque_mode() -> None:
    firmware = enable(drive())
    firmware.write("max_speed", 500)  # 50 rpm = 5.2 rad/s
    firmware.command_torque(500)
    firmware.advance(SECOND)
    limit = 50 * 2 * math.pi / 60
    assert 0.4 * limit < firmware.plant.velocity <= limit
    assert firmware.statusword & 0x0800
    firmware.command_torque(-500)
    firmware.advance(8 * MS)
    assert firmware.torque == -500, "against the motion the limiter leaves the torque alone"


def test_mode_4_ramps_the_torque_by_its_slope_and_mode_10_does_not() -> None:
    firmware = drive(delay="0")
    firmware.write("torque_slope", 1000)  # 1 rated torque a second
    enable(firmware, mode=4)
    firmware.write("torque_target", 90)
    firmware.advance(50 * MS)
    assert firmware.torque == pytest.approx(50, abs=2)
    firmware.advance(50 * MS)
    assert firmware.torque == 90


@pytest.mark.parametrize(
    ("option", "state", "fault"),
    [
        (1, State.FAULT, True),
        (2, State.SWITCH_ON_DISABLED, True),
        (3, State.SWITCH_ON_DISABLED, True),
    ],
)
def test_a_silent_master_stops_the_drive(option: int, state: State, fault: bool) -> None:
    firmware = enable(drive())
    firmware.write("abort_connection_option", option)
    seen: list[int] = []
    firmware.on_emergency = seen.append
    firmware.feed_watchdog()
    firmware.command_torque(300)
    firmware.advance(49 * MS)
    assert firmware.state is State.OPERATION_ENABLED
    firmware.advance(200 * MS)
    assert firmware.state is state
    assert not firmware.energised
    assert seen == [0x8100]
    assert firmware.plant.velocity == 0.0


def test_abort_option_0_goes_on_and_an_unfed_watchdog_sleeps() -> None:
    firmware = enable(drive())
    firmware.advance(SECOND)
    assert firmware.state is State.OPERATION_ENABLED, "never fed: not armed"
    firmware.write("abort_connection_option", 0)
    firmware.feed_watchdog()
    firmware.advance(SECOND)
    assert firmware.state is State.OPERATION_ENABLED


def test_a_fault_is_reset_by_bit_7_and_never_enables() -> None:
    firmware = enable(drive())
    firmware.trip(0x2310)
    firmware.advance(20 * MS)
    assert firmware.statusword & 0x4F == 0x08
    firmware.write("controlword", 0x0F)
    assert firmware.statusword & 0x4F == 0x08
    firmware.write("controlword", 0x80)
    assert firmware.state is State.SWITCH_ON_DISABLED
    assert firmware.error_code == 0


def test_the_brake_holds_the_load_until_it_is_released_and_again_after() -> None:
    firmware = drive("vertical")
    firmware.write("torque_target", round(0.15 / 1.3 * 1000))
    firmware.write("mode", 10)
    for word in (0x06, 0x07, 0x0F):
        firmware.write("controlword", word)
    assert firmware.statusword & 0x6F == 0x23, "not enabled before the brake is open"
    firmware.advance(60 * MS)
    assert firmware.state is State.OPERATION_ENABLED
    assert firmware.plant.position == 0.0
    firmware.command_torque(300)
    firmware.advance(30 * MS)
    firmware.write("controlword", 0x02)
    firmware.advance(400 * MS)
    assert firmware.plant.locked
    assert not firmware.energised
    at_rest = firmware.plant.position
    firmware.advance(SECOND)
    assert firmware.plant.position == at_rest


def test_without_voltage_the_vertical_axis_drops_until_the_brake_closes() -> None:
    firmware = drive("vertical")
    enable(firmware, mode=8)
    before = firmware.plant.position
    firmware.write("controlword", 0x00)
    firmware.advance(300 * MS)
    drop = before - firmware.plant.position
    # (0.15 - 0.08) N.m on 1e-4 kg.m2 for 50 ms: 0.9 rad, less viscous friction
    assert 0.5 < drop < 0.95
    assert firmware.plant.locked


def test_position_mode_follows_and_holds() -> None:
    firmware = enable(drive(), mode=8)
    for n in range(1, 501):
        firmware.write("position_target", round(n * 0.004 * 131072 / (2 * math.pi)))
        firmware.advance(2 * MS)
    firmware.advance(500 * MS)
    assert firmware.plant.position == pytest.approx(2.0, abs=0.01)


def reversal_error(compensation: bool) -> float:
    """Largest position error of a slow triangle, which reverses the friction."""
    firmware = drive(coulomb="0.2")
    if compensation:
        for key in ("coulomb_positive", "coulomb_negative"):
            firmware.write(key, 180)
    enable(firmware, mode=8)
    worst = 0.0
    for n in range(2000):
        phase = n / 500 % 2
        wanted = 0.3 * (phase if phase < 1 else 2 - phase)
        firmware.write("position_target", round(wanted / firmware.axis.resolution))
        firmware.advance(2 * MS)
        if n > 600:
            worst = max(worst, abs(firmware.plant.position - wanted))
    return worst


def test_friction_compensation_acts_in_position_mode() -> None:
    assert reversal_error(compensation=True) < 0.8 * reversal_error(compensation=False)


def test_friction_compensation_does_not_act_in_torque_mode() -> None:
    firmware = drive()
    firmware.write("coulomb_positive", 500)
    firmware.write("torque_offset", 500)
    enable(firmware, mode=10)
    firmware.command_torque(90)
    firmware.advance(SECOND)
    assert firmware.plant.position == 0.0


def test_values_are_lost_without_store_and_kept_with_it(tmp_path: Path) -> None:
    path = tmp_path / "drive.json"
    firmware = drive(memory=Memory(path))
    firmware.write("coulomb_positive", 87)
    assert drive(memory=Memory(path)).read("coulomb_positive") == 0
    firmware.store()
    assert firmware.read("store_status") == 1
    firmware.advance(50 * MS)
    assert firmware.read("store_status") == 0
    assert drive(memory=Memory(path)).read("coulomb_positive") == 87
    path.write_text("no json")
    assert drive(memory=Memory(path)).read("coulomb_positive") == 0


def test_storing_is_refused_while_enabled() -> None:
    with pytest.raises(Denied):
        enable(drive()).store()


@pytest.mark.parametrize(
    ("key", "value"),
    [("statusword", 1), ("rated_torque", 1), ("no such", 1), ("coulomb_positive", 1001),
     ("coulomb_positive", -1), ("mode", 42)],
)  # fmt: skip
def test_what_the_drive_does_not_take_is_denied(key: str, value: int) -> None:
    with pytest.raises(Denied):
        drive().write(key, value)


def test_the_encoder_counts_a_turn_as_it_says() -> None:
    for axis in AXES.values():
        firmware = Firmware(axis)
        # one turn; for a linear axis 2 pi m
        if isinstance(firmware.plant, CompliantPlant):
            firmware.plant.place(2 * math.pi)
        else:
            firmware.plant.position = 2 * math.pi
        assert firmware.position == firmware.read("encoder_increments")


def test_gains_that_are_set_are_those_of_its_loops_and_a_stop_has_its_own() -> None:
    """Position P over velocity PI.

    A velocity gain of 0 moves nothing, and the stop still brakes.
    """
    firmware = enable(drive(coulomb="0"), mode=8)
    firmware.write("position_target", 2000)
    firmware.advance(200 * MS)
    assert firmware.position == pytest.approx(2000, abs=20)
    limp = enable(drive(coulomb="0"), mode=8)
    for key in ("velocity_gain", "integral_time"):
        limp.write(key, 0)
    limp.write("position_target", 2000)
    limp.advance(200 * MS)
    assert limp.position == 0
    limp.plant.velocity = 20.0
    limp.write("controlword", 0x02)
    limp.advance(100 * MS)
    assert limp.plant.velocity < 0.1


def test_gains_are_kept_by_a_store_and_lost_by_none(tmp_path: Path) -> None:
    memory = Memory(tmp_path / "drive.json")
    firmware = drive(memory=memory)
    firmware.write("position_gain", 1234)
    firmware.restart()
    assert firmware.values["position_gain"] == 5000  # 50/s, as delivered: bandwidth 250/5
    firmware.write("position_gain", 1234)
    firmware.store()
    firmware.restart()
    assert firmware.values["position_gain"] == 1234
