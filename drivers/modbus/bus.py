"""Modbus as a bus: registers by address, and the cycle by FC 23, or FC 16 then FC 3."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from contextlib import AbstractContextManager
from time import sleep

from drivers.bus import Exchange
from drivers.errors import AccessDenied, DriveFault, LinkLost, WriteDenied
from drivers.modbus.client import POST_ANSWER, Client, NoAnswer
from drivers.modbus.mailbox import MailboxAccess
from drivers.modbus.registers import decode, encode
from drivers.pace import Pace
from drivers.patience import patiently
from drivers.serial_port import SerialPort, Stream
from drivers.stepping import TWIN_MARK, TWIN_MARKED, Simulation, set_simulation
from profiles.address import Address, MailboxAddress, ModbusAddress
from profiles.errors import ProfileError, TwoRelayError, UsageError
from profiles.identity import NOBODY, Identity
from profiles.procedures import LinkDefaults
from profiles.schema import Profile

__all__ = ["ModbusBus", "answers", "identify"]

_MOST_READ = 125  # registers in one answer (Modbus application protocol 6.3)
_PLAIN = {"i16": "h", "u16": "H", "i32": "i", "u32": "I"}
_ASKED_AGAIN = 0.05  # s
MISSED_CYCLES = 3  # consecutive cycles without a sample are a lost link (safety, receive deadline)


def identify(client: Client, patience: float = LinkDefaults().patience) -> Identity:
    """Vendor, product and revision by FC 43/14.

    A drive without it, or silent on it, has empty ones.

    `patience` : s for a drive that is busy; with none, it is one without it. Raises NoAnswer where
        the drive
    answers nothing else, either.
    """
    try:
        found = patiently(client.identification, patience, _nap)
    except AccessDenied as error:
        if error.busy and patience:
            raise
        found = {}
    except NoAnswer:
        answers(client)
        found = _asked_once_more(client) if patience else {}
    return Identity(
        vendor=found.get(0, ""),
        product=found.get(1, ""),
        revision=found.get(2, ""),
        serial="",
    )


def answers(client: Client) -> Identity:
    """Nobody in particular, once the drive answers anything at all; raises NoAnswer."""
    with contextlib.suppress(AccessDenied):  # which is an answer
        client.read(3, 0, 1)
    return NOBODY


def _asked_once_more(client: Client) -> dict[int, str]:
    """What a drive says of itself that answers, and has not answered this.

    It may have booted meanwhile.
    """
    try:
        return client.identification()
    except (AccessDenied, NoAnswer):
        return {}


def _nap() -> float:
    """Time of the wall, s, that a busy drive is given before it is asked again."""
    sleep(_ASKED_AGAIN)
    return _ASKED_AGAIN


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
        self.lacking: tuple[str, ...] = (client.oddity,) if client.oddity else ()
        self.cycle = pace.cycle
        self.in_real_time = not pace.stepping
        self._client = client
        self._pace = pace
        self._profile = profile
        # simulated time stands still while an answer is awaited: any service's patience will do
        self._deadline = None if pace.stepping else max(pace.cycle, profile.watchdog.deadline)
        self._idle: tuple[int, ...] = (0,) * len(profile.cycle.out)
        self._mailbox = MailboxAccess(client, profile.mailbox) if profile.mailbox else None
        if profile.moves:
            self._out = _written(profile)
            self._in = _read_blocks(profile)
            position = _modbus(profile.parameters["position_actual"].address)
            self._at_position = next(n for n, block in enumerate(self._in) if block.holds(position))
        self._words: dict[int, int] = {}  # registers of which only bits are ours, as last seen
        self._before: tuple[tuple[int, ...], float] | None = None  # command in force, when it left
        self._write_function = 6 if profile.cycle.function == "fc6+3" else 16
        self._one_transaction = profile.cycle.function == "fc23"
        if pace.stepping:
            client.quiet_time = (
                0.0  # a virtual drive is well-behaved, and there are thousands of cycles
            )
            self._simulate("simulation_cycle", pace.cycle)

    def _simulate(self, name: Simulation, seconds: float) -> None:
        """Let the clock of a drive that steps know."""

        def write(address: Address, raw: int) -> None:
            patiently(lambda: self.write(address, raw), self._profile.link.patience, _nap)

        set_simulation(write, self._profile, name, seconds, self._is_twin)

    def _is_twin(self) -> bool:
        """Whether the drive says that it is a virtual one in another one's clothes."""
        try:
            return self.read(TWIN_MARK) == TWIN_MARKED
        except AccessDenied:
            return False

    def identify(self) -> Identity:
        """Ask the drive who it is."""
        return identify(self._client, self._profile.link.patience)

    def read(self, address: Address) -> int:
        """Raw value; raises LinkError, AccessDenied."""
        if self._mailbox is not None and isinstance(address, MailboxAddress):
            return self._mailbox.read(address)
        at = _modbus(address)
        try:
            words = self._asked_twice(at)
        except AccessDenied as error:
            raise AccessDenied(f"{at}: {error}", busy=error.busy) from None
        if at.bits is not None:
            self._words[at.register_] = words[0]
        return decode(at, words)

    def _asked_twice(self, at: ModbusAddress) -> list[int]:
        """Words of a register.

        An answer may be lost on its way, and a read asked again does no harm.
        """
        try:
            return self._client.read(at.read_function, at.register_, at.count)
        except NoAnswer:
            return self._client.read(at.read_function, at.register_, at.count)

    def write(self, address: Address, raw: int) -> None:
        """Write a raw value; raises LinkError, WriteDenied."""
        try:
            if self._mailbox is not None and isinstance(address, MailboxAddress):
                self._mailbox.write(address, raw)
                return
            at = _modbus(address)
            if at.bits is not None and at.write_function != 22:
                self.read(at)  # the bits that are not ours stay as they are
            self._put(at, raw, self._client.write)
        except AccessDenied as error:
            raise WriteDenied(f"{address}: {error}", busy=error.busy) from None

    def post(self, address: Address, raw: int) -> None:
        """Send a write; no answer is waited for.

        Bits go into the register as it is now, where it can be read at once, else as it was last
        seen.
        """
        at = _modbus(address)
        if at.bits is not None and at.write_function != 22 and not self._client.owes:
            with contextlib.suppress(TwoRelayError):
                self._words[at.register_] = self._client.read(
                    at.read_function, at.register_, 1, POST_ANSWER
                )[0]
        self._put(at, raw, self._client.post)

    def _put(
        self, at: ModbusAddress, raw: int, send: Callable[[int, int, list[int]], None]
    ) -> None:
        words = encode(at, raw)
        if at.bits is None:
            send(at.write_function, at.register_, words)
        elif at.write_function == 22:
            send(22, at.register_, [0xFFFF & ~at.bits, words[0]])
        else:
            words[0] |= self._words.get(at.register_, 0) & ~at.bits
            send(at.write_function, at.register_, words)
            self._words[at.register_] = words[0]

    def descriptor(self) -> int | None:
        """Descriptor of the serial port, or of a connection that the drive allows only one of."""
        if self._profile.link.sharing == "shared" and not self._client.serial:
            return None
        return self._client.descriptor()

    def port(self) -> SerialPort | None:
        """The serial port, where the drive is on one."""
        return self._client.port()

    def speak_through(self, stream: Stream | None) -> None:
        """Give the serial port back and speak through `stream` from now on."""
        self._client.speak_through(stream)

    def frame(self, address: Address, raw: int) -> bytes:
        """The request that `post` would send."""
        found: list[bytes] = []
        self._put(
            _modbus(address), raw, lambda *request: found.append(self._client.frame(*request))
        )
        return found[0]

    def changes(self) -> dict[str, tuple[int, int]]:
        """Nothing beside the parameters of the profile."""
        return {}

    def put_back(self, old: dict[str, int]) -> bool:
        """Nothing but parameters of the profile was changed.

        Raises UsageError for anything else.
        """
        if old:
            raise UsageError(f"no parameter of profile '{self._profile.name}': {', '.join(old)}")
        return False

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
                answer, latched = self._transact(words)
            except (NoAnswer, AccessDenied) as error:
                if isinstance(error, AccessDenied) and not error.busy:
                    raise DriveFault(
                        f"the drive refuses the cycle: {error}", code="drive.refuses-cycle"
                    ) from None
                missed += 1
                if missed >= MISSED_CYCLES:
                    raise LinkLost(
                        f"no answer for {missed} cycles of {self.cycle * 1000:g} ms: the link is "
                        f"lost ({error})",
                        code="link.silent",
                    ) from None
                continue
            if pace.stepping:
                return Exchange(answer, values, sent, pace.now(), lateness, missed)
            # in real time the drive latches the position right after it took the command, so that
            # what acted until then is the command before; most likely it was midway
            in_force, left = self._before or (self._idle, sent - pace.cycle)
            self._before = (values, sent)
            return Exchange(answer, in_force, left, latched, lateness, missed)

    def _transact(self, words: list[int]) -> tuple[tuple[int, ...], float]:
        """One exchange, in as many transactions as it takes.

        With the middle of the position's, s.
        """
        client, out, now = self._client, self._out, self._pace.now
        values: tuple[int, ...] = ()
        timed = self.in_real_time  # else no time passes while an answer is awaited
        begun, latched = now(), 0.0
        if not self._one_transaction:
            client.write(self._write_function, out.start, words, self._deadline, in_cycle=True)
            begun = now()
        for at, block in enumerate(self._in):
            if at == 0 and self._one_transaction:
                answer = client.read_write(
                    block.start, block.count, out.start, words, self._deadline, in_cycle=timed
                )
            else:
                answer = client.read(3, block.start, block.count, self._deadline, in_cycle=True)
            ended = now()
            if at == self._at_position:
                latched = 0.5 * (begun + ended)
            begun = ended
            values += block.decode(answer)
        return values, latched

    def wait(self, seconds: float) -> None:
        """Let time pass; on a stepping drive, by asking it to."""
        if self._pace.stepping:
            self._simulate("simulation_advance", seconds)
        self._pace.pass_time(seconds)

    def answering_within(self, seconds: float) -> AbstractContextManager[None]:
        """Requests meanwhile may take so long to be answered, if that is more than usual."""
        return self._client.answering_within(seconds)

    def now(self) -> float:
        """Time of the cycle's clock, s."""
        return self._pace.now()

    def own_address(self) -> str:
        """IP address by which the drive knows this computer, or ''."""
        return self._client.own_address

    def other_master(self) -> str:
        """Modbus shows no other client."""
        return ""

    def refused_posts(self) -> list[tuple[Address, int]]:
        """None: a refusal comes at once here."""
        return []

    def trouble(self) -> str:
        """Modbus drives report nothing by themselves."""
        return ""

    def close(self) -> None:
        """Close the connection."""
        self._client.close()


class _Block:
    """Parameters that are exchanged as one block of registers.

    What lies between them is read along.
    """

    def __init__(self, addresses: list[ModbusAddress]) -> None:
        self.start = addresses[0].register_
        self.count = addresses[-1].register_ + addresses[-1].count - self.start
        self._words = struct.Struct(f">{self.count}H")
        self._layout = _plain_layout(addresses)
        self._spans = [
            (at, at.register_ - self.start, at.register_ - self.start + at.count)
            for at in addresses
        ]

    def holds(self, address: ModbusAddress) -> bool:
        return any(at == address for at, _, _ in self._spans)

    def encode(self, values: tuple[int, ...]) -> list[int]:
        if self._layout is not None:
            return list(self._words.unpack(self._layout.pack(*values)))
        words: list[int] = []
        for (address, _, _), value in zip(self._spans, values, strict=True):
            words += encode(address, value)
        return words

    def decode(self, words: list[int]) -> tuple[int, ...]:
        if self._layout is not None:
            return self._layout.unpack(self._words.pack(*words))
        return tuple(decode(address, words[a:b]) for address, a, b in self._spans)


def _plain_layout(addresses: list[ModbusAddress]) -> struct.Struct | None:
    """All of a block at once, where every value is a whole one with its high word first."""
    layout, at = ">", addresses[0].register_
    for address in addresses:
        code = _PLAIN.get(address.type)
        if code is None or address.bits is not None or address.word_order != "high-first":
            return None
        layout += "2x" * (address.register_ - at) + code
        at = address.register_ + address.count
    return struct.Struct(layout)


def _written(profile: Profile) -> _Block:
    """What is written in a cycle.

    One block without gaps, and one register where that is all FC 6 can.
    """
    names = profile.cycle.out
    addresses = [_modbus(profile.parameters[name].address) for name in names]
    for name, before, at in zip(names[1:], addresses, addresses[1:], strict=False):
        follows = before.register_ + before.count
        if at.register_ != follows:
            raise ProfileError(
                f"profile '{profile.name}': [cycle] '{name}' is at {at}, where register "
                f"{follows:04X}h must follow: a block that is written has no gaps"
            )
    block = _Block(addresses)
    if profile.cycle.function == "fc6+3" and block.count > 1:
        raise ProfileError(
            f"profile '{profile.name}': [cycle] fc6+3 writes one register, and out has "
            f"{block.count}"
        )
    return block


def _read_blocks(profile: Profile) -> list[_Block]:
    """What is read in a cycle, in the order of `in`.

    A new block where the next one is too far away.
    """
    blocks: list[list[ModbusAddress]] = []
    for name in profile.cycle.in_:
        at = _modbus(profile.parameters[name].address)
        if blocks:
            last = blocks[-1][-1]
            gap = at.register_ - last.register_ - last.count
            if (
                0 <= gap <= profile.cycle.gap
                and at.register_ + at.count - blocks[-1][0].register_ <= _MOST_READ
            ):
                blocks[-1].append(at)
                continue
        blocks.append([at])
    return [_Block(block) for block in blocks]


def _modbus(address: Address) -> ModbusAddress:
    assert isinstance(address, ModbusAddress)  # the profile's bus was checked when it was loaded
    return address
