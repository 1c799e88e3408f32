"""Energy on and off by the state machine, and by a profile's procedure."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.bus import Exchange
from drivers.errors import DriveFault, PreflightRefused, WriteFailed
from drivers.power import Cia402Power, ProcedurePower, perform, power_of
from profiles.address import Address
from profiles.library import load_profile
from profiles.procedures import Step
from profiles.schema import Profile
from profiles.toml_files import parse_model
from tests.command import ROOT
from tests.raising import raises

CANOPEN, MODBUS = load_profile("virtual-canopen"), load_profile("virtual-modbus")
LEADSHINE = load_profile("leadshine-el7")
DISABLED, READY, SWITCHED, ENABLED, FAULT = 0x40, 0x21, 0x23, 0x27, 0x08  # CiA 402 statuswords


class Machine:
    """A drive that answers to writes as it is told; each exchange is a cycle of 10 ms."""

    cycle = 0.01

    def __init__(self, profile: Profile, react: Callable[[Machine, str, int], None]) -> None:
        self.profile = profile
        self.values = dict.fromkeys(profile.parameters, 0)
        self.frames: list[tuple[int, ...]] = []
        self.written: list[tuple[str, int]] = []
        self.waited = 0.0
        self.in_cycle: Callable[[Machine], None] = lambda machine: None
        self._react = react
        self._names = {str(p.address): name for name, p in profile.parameters.items()}

    def read(self, address: Address) -> int:
        return self.values[self._names[str(address)]]

    def write(self, address: Address, raw: int) -> None:
        name = self._names[str(address)]
        self.written.append((name, raw))
        self._react(self, name, raw)

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        self.frames.append(values)
        self.in_cycle(self)
        return Exchange((), values, 0.0, 0.0, 0.0, 0)

    def wait(self, seconds: float) -> None:
        self.waited += seconds
        self.in_cycle(self)


def obedient(machine: Machine, name: str, raw: int) -> None:
    """CiA 402, each transition at once."""
    word = machine.values["statusword"]
    ways = {
        (DISABLED, 6): READY, (READY, 7): SWITCHED, (SWITCHED, 15): ENABLED, (ENABLED, 7): SWITCHED,
        (SWITCHED, 6): READY, (READY, 0): DISABLED,
    }  # fmt: skip
    machine.values["statusword"] = ways.get((word, raw), word)


def cia402(machine: Machine) -> Cia402Power:
    return Cia402Power(machine, machine.profile, lambda: "described")  # type: ignore[arg-type]


@pytest.mark.parametrize("profile", [CANOPEN, MODBUS], ids=lambda p: p.name)
def test_the_state_machine_is_walked_up_and_down_step_by_step(profile: Profile) -> None:
    machine = Machine(profile, obedient)
    machine.values["statusword"] = DISABLED
    power = cia402(machine)
    assert not power.is_energised()
    power.enable(power.idle())
    assert [raw for _, raw in machine.written] == [6, 7, 15]
    assert power.is_energised()
    machine.written.clear()
    power.disable(power.idle())
    assert [raw for _, raw in machine.written] == [7, 6, 0]
    assert not power.is_energised()


def test_an_idle_frame_is_zeros_and_enables_what_is_enabled() -> None:
    assert cia402(Machine(CANOPEN, obedient)).idle() == [15, 0, 0]
    assert cia402(Machine(MODBUS, obedient)).idle() == [0, 0]
    assert procedure(Machine(LEADSHINE, leadshine)).idle() == [0]


def test_the_controlword_in_the_cycle_follows_the_walk() -> None:
    """While a transition takes its time, the cycle repeats the controlword that asked for it.

    Once more before the drive is enabled: who has restarted says so there.
    """

    def slow(machine: Machine, name: str, raw: int) -> None:
        machine.in_cycle = lambda m: obedient(m, name, raw) if len(m.frames) % 3 == 0 else None

    machine = Machine(CANOPEN, slow)
    machine.values["statusword"] = DISABLED
    power = cia402(machine)
    power.enable(power.idle())
    assert [frame[0] for frame in machine.frames] == [6] * 3 + [7] * 4 + [15] * 2


def test_a_transition_that_never_comes_is_refused_after_its_time() -> None:
    machine = Machine(MODBUS, lambda machine, name, raw: None)
    machine.values["statusword"] = DISABLED
    with raises(PreflightRefused, "power.stuck"):
        cia402(machine).enable([0, 0])
    seconds = len(machine.frames) * machine.cycle
    machine.values["statusword"] = ENABLED
    machine.frames.clear()
    with raises(PreflightRefused, "power.stuck"):
        cia402(machine).disable([0, 0])
    assert seconds == pytest.approx(len(machine.frames) * machine.cycle)
    assert seconds == pytest.approx(5.0, abs=0.02)


def test_a_fault_and_a_fall_while_enabling_end_the_walk() -> None:
    def faulty(machine: Machine, name: str, raw: int) -> None:
        machine.values["statusword"] = FAULT

    machine = Machine(MODBUS, faulty)
    machine.values["statusword"] = DISABLED
    with raises(DriveFault, "power.fault"):
        cia402(machine).enable([0, 0])
    assert cia402(machine).in_fault()
    cia402(machine).disable([0, 0])  # a fault has no energy: it is there already

    def falling(machine: Machine, name: str, raw: int) -> None:
        obedient(machine, name, raw)
        if raw == 15:
            machine.values["statusword"] = DISABLED

    machine = Machine(MODBUS, falling)
    machine.values["statusword"] = DISABLED
    with raises(DriveFault, "power.fell-back"):
        cia402(machine).enable([0, 0])
    assert [raw for _, raw in machine.written] == [6, 7, 15]


def test_a_fault_is_acknowledged_by_an_edge() -> None:
    machine = Machine(MODBUS, lambda machine, name, raw: None)
    cia402(machine).acknowledge()
    assert machine.written == [("controlword", 0), ("controlword", 0x80), ("controlword", 0)]


# -- by a procedure -------------------------------------------------------------------------------


def leadshine(machine: Machine, name: str, raw: int) -> None:
    """Bit 1 of the operation status while the input function says so."""
    machine.values[name] = raw
    if name == "input_1_function":
        machine.values["operation_status"] = 2 if raw == 131 else 0


def procedure(machine: Machine) -> ProcedurePower:
    made = power_of(machine, machine.profile, lambda: "described")  # type: ignore[arg-type]
    assert isinstance(made, ProcedurePower)
    return made


def test_a_procedure_enables_disables_and_tells_its_state() -> None:
    machine = Machine(LEADSHINE, leadshine)
    power = procedure(machine)
    assert power.said().text == "disabled"
    power.enable(power.idle())
    assert machine.written == [("input_1_function", 131)]
    assert power.is_energised()
    assert power.said().text == "enabled"
    power.disable(power.idle())
    assert not power.is_energised()
    machine.values["alarm"] = 0x0152
    assert power.in_fault()
    assert power.said().text == "fault (alarm 0152h)"
    power.acknowledge()
    assert machine.written[-1] == ("control", 4369)


def test_a_procedure_without_a_reset_says_so() -> None:
    assert LEADSHINE.power is not None
    bare = LEADSHINE.model_copy(update={"power": LEADSHINE.power.model_copy(update={"reset": ()})})
    with raises(PreflightRefused, "fault.no-reset"):
        procedure(Machine(bare, leadshine)).acknowledge()


def test_a_reset_that_takes_its_time_is_looked_at_every_five_milliseconds() -> None:
    assert LEADSHINE.power is not None
    steps = (Step(write="control", raw=1), Step(until="alarm", equals=0, within=1.0))
    slow = LEADSHINE.model_copy(
        update={"power": LEADSHINE.power.model_copy(update={"reset": steps})}
    )
    machine = Machine(slow, lambda machine, name, raw: None)
    machine.values["alarm"] = 1
    looks = []

    def clears(machine: Machine) -> None:
        looks.append(True)
        machine.values["alarm"] = int(len(looks) < 4)

    machine.in_cycle = clears
    procedure(machine).acknowledge()
    assert machine.waited == pytest.approx(4 * 0.005)


def test_a_procedure_waits_for_its_sign_and_not_for_ever() -> None:
    machine = Machine(LEADSHINE, lambda machine, name, raw: None)
    with pytest.raises(
        PreflightRefused, match="does not become enabled: it stays 'disabled' for 5 s"
    ):
        procedure(machine).enable([0])
    assert len(machine.frames) == pytest.approx(500, abs=1)

    def late(machine: Machine) -> None:
        machine.values["operation_status"] = 2 if len(machine.frames) == 5 else 0

    machine = Machine(LEADSHINE, lambda machine, name, raw: None)
    machine.in_cycle = late
    procedure(machine).enable([0])
    assert len(machine.frames) == 5
    machine = Machine(LEADSHINE, lambda machine, name, raw: None)
    machine.values["operation_status"] = 2
    with raises(PreflightRefused, "power.stuck"):
        procedure(machine).disable([0])


def test_a_fault_while_a_procedure_enables_ends_it() -> None:
    def faulty(machine: Machine, name: str, raw: int) -> None:
        machine.values["alarm"] = 1

    with raises(DriveFault, "power.fault"):
        procedure(Machine(LEADSHINE, faulty)).enable([0])


def test_a_profile_that_names_no_fault_has_none() -> None:
    assert LEADSHINE.power is not None
    bare = LEADSHINE.model_copy(
        update={"power": LEADSHINE.power.model_copy(update={"fault": None})}
    )
    machine = Machine(bare, leadshine)
    machine.values["alarm"] = 1
    power = procedure(machine)
    assert not power.in_fault()
    assert power.said().text == "disabled"
    assert not power.status(tuple(1 for _ in bare.cycle.in_)).fault


def test_the_cycle_of_a_procedure_tells_enabled_and_fault() -> None:
    power = procedure(Machine(LEADSHINE, leadshine))
    into = LEADSHINE.cycle.in_

    def status(**values: int) -> tuple[bool, bool]:
        found = power.status(tuple(values.get(name, 0) for name in into))
        return found.enabled, found.fault

    assert (
        power.status(tuple(0xA5A2 if n == "operation_status" else 0 for n in into)).word == 0xA5A2
    )
    assert status(operation_status=2) == (True, False)
    assert status(operation_status=1) == (False, False)


def test_a_fault_that_the_cycle_tells_takes_enabled_away() -> None:
    delta = load_profile("delta-asda")
    assert delta.power is not None
    assert delta.power.fault is not None
    on, fault = delta.power.enabled, delta.power.fault
    assert (on.parameter, fault.parameter, fault.mask) == ("drive_status", "drive_status", 64)
    power = procedure(Machine(delta, lambda machine, name, raw: None))

    def status(word: int) -> tuple[bool, bool]:
        found = power.status(tuple(word if n == "drive_status" else 0 for n in delta.cycle.in_))
        return found.enabled, found.fault

    enabled = on.equals or 0
    assert status(enabled) == (True, False)
    assert status(enabled | 64) == (False, True)
    assert status(64) == (False, True)
    assert status(0) == (False, False)


TWO_KEY = parse_model((ROOT / "tests/faults/two_key.toml").read_text(), Profile, "two-key")


def two_key(machine: Machine, name: str, raw: int) -> None:
    """State 1 (5 once it moves) with both keys, 2 while it brakes."""
    machine.values[name] = raw
    both = machine.values["key_1"] == 85 and machine.values["key_2"] == 170
    machine.values["servo_state"] = 1 if both else 0


def test_each_of_several_values_says_enabled_and_one_says_that_it_brakes() -> None:
    machine = Machine(TWO_KEY, two_key)
    power = procedure(machine)
    power.enable(power.idle())
    assert machine.written == [("key_1", 85), ("key_2", 170)]
    told = {}
    for state in (0, 1, 2, 3, 5, 0x0101):
        machine.values["servo_state"] = state
        cycle = tuple(state if n == "servo_state" else 0 for n in TWO_KEY.cycle.in_)
        status = power.status(cycle)
        told[state] = power.said().text, power.is_energised(), status.enabled, status.stopping
    assert told == {
        0: ("disabled", False, False, False),
        1: ("enabled", True, True, False),
        2: ("stopping", True, False, True),
        3: ("disabled", False, False, False),
        5: ("enabled", True, True, False),
        0x0101: ("fault (servo_state 0101h)", True, False, False),
    }


def test_a_drive_that_brakes_is_not_enabled_yet_and_has_not_lost_its_energy_yet() -> None:
    machine = Machine(TWO_KEY, lambda machine, name, raw: None)
    machine.values["servo_state"] = 2
    with raises(PreflightRefused, "power.stuck"):
        procedure(machine).enable([0, 0])
    with raises(PreflightRefused, "power.stuck"):
        procedure(machine).disable([0, 0])


# -- steps ----------------------------------------------------------------------------------------


def test_steps_write_and_wait_for_what_they_name() -> None:
    machine = Machine(LEADSHINE, leadshine)
    waits: list[float] = []

    def wait() -> float:
        waits.append(0.25)
        machine.values["alarm"] = 0x31 if len(waits) == 3 else 0x22
        return 0.25

    steps = (
        Step(write="control", raw=5),
        Step(until="alarm", mask=0x0F, equals=1, within=1.0),
        Step(write="control", raw=6),
    )
    perform(machine, LEADSHINE, steps, "store", wait)  # type: ignore[arg-type]
    assert machine.written == [("control", 5), ("control", 6)]
    assert len(waits) == 3


def test_a_wait_in_vain_names_the_parameter_and_the_time() -> None:
    machine = Machine(LEADSHINE, leadshine)
    waits: list[float] = []

    def wait() -> float:
        waits.append(0.25)
        return 0.25

    steps = (Step(until="alarm", equals=3, within=1.0), Step(write="control", raw=6))
    with pytest.raises(WriteFailed, match="store: 'alarm' reads 0 for 1 s instead of 3"):
        perform(machine, LEADSHINE, steps, "store", wait)  # type: ignore[arg-type]
    assert len(waits) == 4
    assert machine.written == []
