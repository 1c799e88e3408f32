"""The virtual drive on Modbus with habits of real ones.

Of the drive, its gateway, and its adapter.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from drivers.virtual.habits import Habits
from drivers.virtual.modbus_framing import Answer, Framing, MbapFraming, RtuFraming, crc
from drivers.virtual.modbus_slave import READ_IDENTIFICATION, ModbusSlave
from drivers.virtual.registers import Layout, RegisterMap

__all__ = ["bent", "framings"]

_ACKNOWLEDGE, _BUSY, _NO_TARGET = 5, 6, 11  # exception codes
_WRITES = 6, 16
_CYCLE = 23
_PIECE, _PAUSE = 3, 0.001  # bytes, s
_NOISE = bytes.fromhex("FF 00 7E")
_STORE = 0x0500
_NOT_OF_THE_DRIVE = 0x0500  # from here on the store, and the clock of a virtual one


def bent(layout: Layout, habits: Habits) -> Layout:
    """The registers of a drive with these habits."""
    ours = {at for at in layout.registers if at < _NOT_OF_THE_DRIVE}
    if "low-first" in habits:
        layout = replace(layout, low_first=frozenset(ours) - layout.low_first)
    if "off-by-one" in habits:

        def shifted(at: int) -> int:
            return at + (at in ours)

        layout = replace(
            layout,
            registers={shifted(at): entry for at, entry in layout.registers.items()},
            low_first=frozenset(shifted(at) for at in layout.low_first),
            position=shifted(layout.position),
        )
    return layout


def framings(
    units: Mapping[int, RegisterMap], habits: Habits, *, rtu: bool
) -> Callable[[], Framing]:
    """What makes a framing for each connection to the drives, by their units."""
    kind = RtuFraming if rtu else MbapFraming
    slaves = {unit: _in_turn(registers) for unit, registers in units.items()}
    if not habits.values:
        return lambda: kind(slaves)
    wait = _Wait()
    answers = {u: _Answers(units[u], answer, habits, wait) for u, answer in slaves.items()}
    return lambda: _HabitualFraming(kind(answers), wait, habits, rtu=rtu)


def _in_turn(registers: RegisterMap) -> Answer:
    """The slave of these registers, once its bus is where the last one asked has brought it."""
    slave, clock = ModbusSlave(registers), registers.device.clock

    def answer(pdu: bytes) -> bytes:
        clock.turn()
        return slave.answer(pdu)

    return answer


class _Wait:
    """Before the last answer, whosever it was, s."""

    seconds = 0.0


class _Answers:
    """PDU in, PDU out, bent.

    What takes time takes it of the wall: that of a drive that steps stands still while it is asked.
    """

    def __init__(self, registers: RegisterMap, answer: Answer, habits: Habits, wait: _Wait) -> None:
        self._registers = registers
        self._answer = answer
        self._habits = habits
        self._wait = wait
        self._asked = 0
        self._saved_until = self._boots_at = 0.0

    def __call__(self, pdu: bytes) -> bytes:
        habits, now = self._habits, time.monotonic()
        self._wait.seconds = 0.0
        if "slow-boot" in habits and not self._boots_at:
            self._boots_at = now + habits.seconds("slow-boot")
        is_mute = pdu[0] == READ_IDENTIFICATION and "mute43" in habits
        if (
            now < self._boots_at
            or is_mute
            or (now < self._saved_until and "busy-save" not in habits)
        ):
            return b""
        if now < self._saved_until:
            return self._refusal(pdu, _BUSY)
        return self._answered(pdu, now)

    def _answered(self, pdu: bytes, now: float) -> bytes:
        habits, register = self._habits, int.from_bytes(pdu[1:3], "big")
        self._asked += register < _NOT_OF_THE_DRIVE
        for name, code in (("busy", _BUSY), ("no-target", _NO_TARGET)):
            if self._is_turn(name, register):
                return self._refusal(pdu, code)
        response = self._answer(pdu)
        if self._is_turn("lost-answer", register):
            return b""
        if pdu[0] in _WRITES and self._is_turn("acknowledge", register):
            return bytes((pdu[0] | 0x80, _ACKNOWLEDGE))
        if pdu[0] in _WRITES and register == _STORE:
            self._wait.seconds = habits.seconds("slow-save") + habits.seconds("silent-save")
            self._saved_until = now + max(
                habits.seconds("busy-save"), habits.seconds("silent-save")
            )
        return response

    def _is_turn(self, name: str, register: int) -> bool:
        """Whether it is this request's turn, of the so many-th each, that are the drive's own."""
        every = self._habits.number(name)
        return bool(every) and self._asked % every == 0 and register < _NOT_OF_THE_DRIVE

    def _refusal(self, pdu: bytes, code: int) -> bytes:
        if pdu[0] == _CYCLE:
            self._registers.device.end_cycle()  # its time passes for the drive, too
        return bytes((pdu[0] | 0x80, code))


class _HabitualFraming(Framing):
    """What goes over the wire, bent."""

    def __init__(self, plain: Framing, wait: _Wait, habits: Habits, *, rtu: bool) -> None:
        super().__init__({})
        self._plain = plain
        self._wait = wait
        self._habits = habits
        self._rtu = rtu
        self._noises = 0
        self._echo = b""
        self._random = random.Random(1)  # noqa: S311

    @property
    def is_incomplete(self) -> bool:
        """Whether a part of a request waits for its rest."""
        return self._plain.is_incomplete

    def feed(self, data: bytes) -> list[bytes]:
        """The answers to what is complete, one each."""
        answers = [self._bent(answer) for answer in self._plain.feed(data)]
        self.is_closed = self._plain.is_closed
        if "duplicate" in self._habits:
            answers = [answer for one in answers for answer in (one, one)]
        if "echo" not in self._habits:
            return answers
        self._echo = self._noise() + data
        return [self._echo, *answers]

    def silence(self) -> list[bytes]:
        """Nothing more has come for a while."""
        return self._plain.silence()

    def _bent(self, answer: bytes) -> bytes:
        habits = self._habits
        if "other-unit" in habits:
            unit = bytes((int(habits.values["other-unit"]) % 256,))
            if self._rtu:
                head = unit + answer[1:-2]
                answer = head + crc(head).to_bytes(2, "little")
            else:
                answer = answer[:6] + unit + answer[7:]
        return self._noise() + answer

    def _noise(self) -> bytes:
        every = self._habits.number("noise")
        self._noises += 1
        return _NOISE if every and self._noises % every == 0 else b""

    def due(self, answer: bytes) -> list[tuple[float, bytes]]:
        """When which part of an answer goes out, s from now."""
        habits = self._habits
        if answer is self._echo:
            return [(0.0, answer)]  # it is heard while it is sent
        wait = self._wait.seconds + habits.seconds("slow-answer")
        if "irregular" in habits:
            wait += self._random.uniform(0.0, habits.seconds("irregular"))
        if "fragments" not in habits:
            return [(wait, answer)]
        parts = [answer[at : at + _PIECE] for at in range(0, len(answer), _PIECE)]
        return [(wait + n * _PAUSE, part) for n, part in enumerate(parts)]
