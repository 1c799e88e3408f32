"""Modbus as a bus: registers by address, and the cycle by FC 23, or FC 16 then FC 3."""

from __future__ import annotations

from drivers.drive import Exchange
from drivers.modbus.client import Client, NoAnswer
from drivers.modbus.registers import decode, encode
from drivers.pace import Pace
from drivers.stepping import set_simulation
from profiles.errors import AccessDenied, LinkLost, ProfileError
from profiles.schema import Address, Identity, ModbusAddress, Profile

__all__ = ["ModbusBus", "identify"]

MISSED_CYCLES = 3  # consecutive cycles without a sample are a lost link (safety, receive deadline)


def identify(client: Client) -> Identity:
    """Vendor, product and revision by FC 43/14; a drive without it has empty ones."""
    try:
        found = client.identification()
    except AccessDenied:
        found = {}
    return Identity(
        vendor=found.get(0, ""),
        product=found.get(1, ""),
        revision=found.get(2, ""),
        serial="",
    )


class ModbusBus:
    """One unit on one connection.

    Parameters
    ----------
    client : Client
    profile : Profile
    pace : Pace
        Its cycle is the link's.
    """

    def __init__(self, client: Client, profile: Profile, pace: Pace) -> None:
        self.cycle = pace.cycle
        self.in_real_time = not pace.stepping
        self._client = client
        self._pace = pace
        self._profile = profile
        self._deadline = max(pace.cycle, profile.watchdog.deadline)
        self._idle: tuple[int, ...] = (0,) * len(profile.cycle.out)
        self._out = _Block(profile, profile.cycle.out)
        self._in = _Block(profile, profile.cycle.in_)
        self._before: tuple[tuple[int, ...], float] | None = None  # command in force, when it left
        self._one_transaction = profile.cycle.function == "fc23"
        if pace.stepping:
            set_simulation(self.write, profile, "simulation_cycle", pace.cycle)

    def identify(self) -> Identity:
        """Ask the drive who it is."""
        return identify(self._client)

    def read(self, address: Address) -> int:
        """Raw value; raises LinkError, AccessDenied."""
        at = _modbus(address)
        try:
            return decode(at, self._client.read(at.read_function, at.register_, at.count))
        except AccessDenied as error:
            raise AccessDenied(f"{at}: {error}") from None

    def write(self, address: Address, raw: int) -> None:
        """Write a raw value; raises LinkError, AccessDenied."""
        at = _modbus(address)
        try:
            self._client.write(at.write_function, at.register_, encode(at, raw))
        except AccessDenied as error:
            raise AccessDenied(f"{at}: {error}") from None

    def post(self, address: Address, raw: int) -> None:
        """Send a write; no answer is waited for."""
        at = _modbus(address)
        self._client.post(at.write_function, at.register_, encode(at, raw))

    def start(self, idle: tuple[int, ...]) -> None:
        """The cycle begins with the first exchange; until then `idle` is in force."""
        self._before = None
        self._idle = idle

    def exchange(self, values: tuple[int, ...]) -> Exchange:
        """One cycle; a missing answer lets the next cycle go out, three of them are a lost link."""
        words = self._out.encode(values)
        missed = 0
        while True:
            pace = self._pace
            lateness = pace.next_deadline()
            sent = pace.now() - (pace.cycle if pace.stepping else 0.0)
            try:
                answer = self._transact(words)
            except NoAnswer as error:
                missed += 1
                if missed >= MISSED_CYCLES:
                    raise LinkLost(
                        f"no answer for {missed} cycles of {self.cycle * 1000:g} ms: the link is "
                        f"lost ({error})"
                    ) from None
                continue
            received = pace.now()
            feedback = self._in.decode(answer)
            if pace.stepping:
                return Exchange(feedback, values, sent, received, lateness, missed)
            # in real time the drive latches the position right after it took the command, so that
            # what acted until then is the command before; most likely it was midway
            in_force, left = self._before or (self._idle, sent - pace.cycle)
            self._before = (values, sent)
            return Exchange(feedback, in_force, left, 0.5 * (sent + received), lateness, missed)

    def _transact(self, words: list[int]) -> list[int]:
        client, out, into = self._client, self._out, self._in
        if self._one_transaction:
            return client.read_write(into.start, into.count, out.start, words, self._deadline)
        client.write(16, out.start, words, self._deadline)
        return client.read(3, into.start, into.count, self._deadline)

    def wait(self, seconds: float) -> None:
        """Let time pass; on a stepping drive, by asking it to."""
        if self._pace.stepping:
            set_simulation(self.write, self._profile, "simulation_advance", seconds)
        self._pace.pass_time(seconds)

    def other_master(self) -> str:
        """Modbus shows no other client."""
        return ""

    def trouble(self) -> str:
        """Modbus drives report nothing by themselves."""
        return ""

    def close(self) -> None:
        """Close the connection."""
        self._client.close()


class _Block:
    """Parameters that lie one after the other and are exchanged as one block of registers."""

    def __init__(self, profile: Profile, names: tuple[str, ...]) -> None:
        addresses = [_modbus(profile.parameters[name].address) for name in names]
        self.start = addresses[0].register_
        self._spans: list[tuple[ModbusAddress, int, int]] = []
        at = self.start
        for name, address in zip(names, addresses, strict=True):
            if address.register_ != at:
                raise ProfileError(
                    f"profile '{profile.name}': [cycle] '{name}' is at {address}, where register "
                    f"{at:04X}h must follow: a block has no gaps"
                )
            self._spans.append((address, at - self.start, at - self.start + address.count))
            at += address.count
        self.count = at - self.start

    def encode(self, values: tuple[int, ...]) -> list[int]:
        words: list[int] = []
        for (address, _, _), value in zip(self._spans, values, strict=True):
            words += encode(address, value)
        return words

    def decode(self, words: list[int]) -> tuple[int, ...]:
        return tuple(decode(address, words[a:b]) for address, a, b in self._spans)


def _modbus(address: Address) -> ModbusAddress:
    assert isinstance(address, ModbusAddress)  # the profile's bus was checked when it was loaded
    return address
