"""A drive that is its own twin, in this process: what a profile is tried on before any machine.

The drivers speak to it as to any drive, by Modbus or CANopen to the last byte; there is no wire,
and time is simulated.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.bus import Bus
from drivers.link import agreed
from drivers.pace import StepPace
from drivers.profiled import ProfiledDrive
from drivers.virtual.axes import VirtualAxis, configured
from drivers.virtual.can_channel import LocalCan
from drivers.virtual.device import Device
from drivers.virtual.firmware import SECOND, Firmware
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.twin import habits_of_twin, modbus_twin, twin, within
from drivers.virtual.witness import Witness, WitnessedNode
from profiles.address import CanopenAddress
from profiles.axis import Axis
from profiles.schema import Profile

__all__ = ["Twinned", "open_twin"]

_AXIS, _OPTIONS = "bench", {"watchdog": "0.25"}  # which no profile asks for
_TIMEOUT = 5.0  # s, of a process that others keep from running; no answer is late
_HEADER = 7  # bytes of MBAP
_FIRST = 1  # unit, or node


@dataclass(frozen=True, slots=True)
class Twinned:
    """A connected drive, and the twin behind it.

    Attributes
    ----------
    adapter : the CAN adapter; None on Modbus
    """

    drive: ProfiledDrive
    witness: Witness
    firmware: Firmware
    adapter: LocalCan | None


def virtual_axis() -> VirtualAxis:
    """The axis that every twin here stands before."""
    return configured(_AXIS, _OPTIONS, None)


def open_twin(
    profile: Profile, axis: Axis, habits: Habits = NONE, cycle: float | None = None
) -> Twinned:
    """Connect to the twin of `profile`; raises TwoRelayError as a drive of its own would."""
    cycle = cycle or profile.link.cycle
    device = Device(Firmware(virtual_axis()), "step")
    device.cycle = round(cycle * SECOND)
    witness = Witness()
    witness.now = lambda: device.firmware.now / SECOND
    if profile.bus == "canopen":
        return _on_canopen(profile, axis, device, witness, habits, cycle)
    return _on_modbus(profile, axis, device, witness, habits, cycle)


def _on_modbus(
    profile: Profile, axis: Axis, device: Device, witness: Witness, habits: Habits, cycle: float
) -> Twinned:
    from drivers.modbus.bus import ModbusBus, identify
    from drivers.modbus.client import Client
    from drivers.modbus.wires import LocalWire
    from drivers.virtual.habitual_slave import framings

    within(profile, device.firmware)
    registers = modbus_twin(profile, device, habits, witness.around)
    unit = _FIRST if profile.link.unit is None else profile.link.unit
    framing = framings({unit: registers}, NONE, rtu=False)()

    def answers(data: bytes) -> bytes:
        witness.functions.add(data[_HEADER])
        return b"".join(framing.feed(data))

    client = Client(LocalWire(answers), unit, _TIMEOUT)
    if profile.identity.asked:
        agreed(identify(client, profile.link.patience), "modbus", profile)
    bus: Bus = ModbusBus(client, profile, StepPace(cycle))
    drive = ProfiledDrive(bus, profile, axis, str(LocalWire(answers)))
    return Twinned(drive, witness, device.firmware, None)


def _on_canopen(
    profile: Profile, axis: Axis, device: Device, witness: Witness, habits: Habits, cycle: float
) -> Twinned:
    from drivers.canopen.bus import CanopenBus, identify
    from drivers.canopen.wire import CanWire
    from drivers.optional import as_it_is

    names = {
        (parameter.address.index, parameter.address.sub): name
        for name, parameter in profile.parameters.items()
        if isinstance(parameter.address, CanopenAddress)
    }
    node = profile.link.node or _FIRST
    dictionary = twin(profile, device.firmware.axis, complete=True)
    within(profile, device.firmware)
    habits = habits_of_twin(profile, habits)
    adapter = LocalCan(WitnessedNode(device, node, dictionary, habits, witness, names))
    wire = CanWire(adapter, node, _TIMEOUT)
    agreed(identify(wire, profile.link.patience), "canopen", profile)
    chosen, lacking = as_it_is(
        profile,
        lambda at: wire.has(at.index, at.sub, profile.link.patience),  # type: ignore[union-attr]
        can_guard=wire.can_guard,
    )
    bus: Bus = CanopenBus(wire, chosen, StepPace(cycle), lacking)
    wire.restarted = False
    drive = ProfiledDrive(bus, chosen, axis, "its twin in this process")
    return Twinned(drive, witness, device.firmware, adapter)
