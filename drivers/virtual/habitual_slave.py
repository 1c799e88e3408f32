"""The virtual drive on Modbus with habits of real ones: of the drive, its gateway, and its adapter."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.virtual.habits import Habits
from drivers.virtual.modbus_framing import Answer, Framing, MbapFraming, RtuFraming, crc
from drivers.virtual.modbus_slave import READ_IDENTIFICATION, ModbusSlave
from drivers.virtual.registers import Layout, RegisterMap

__all__ = ["bent", "framings"]

_BUSY, _NO_TARGET = 6, 11  # exception codes
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
    registers: RegisterMap, unit: int, habits: Habits, *, rtu: bool
) -> Callable[[], Framing]:
    """What makes a framing for each connection to the drive."""
    slave = ModbusSlave(registers)
    kind = RtuFraming if rtu else MbapFraming
    if not habits.values:
        return lambda: kind(unit, slave.answer)
    answers = _Answers(registers, slave.answer, habits)
    return lambda: _HabitualFraming(kind(unit, answers), answers, habits, rtu=rtu)


class _Answers:
    """PDU in, PDU out, bent.

    What takes time takes it of the wall: that of a drive that steps stands still while it is asked.
    """

    def __init__(self, registers: RegisterMap, answer: Answer, habits: Habits) -> None:
        self._registers = registers
        self._answer = answer
        self._habits = habits
        self._asked = 0
        self._saved_until = self._boots_at = 0.0
        self.delay = 0.0  # s, of the last answer

    def __call__(self, pdu: bytes) -> bytes:
        habits, now = self._habits, time.monotonic()
        self.delay = 0.0
        if "slow-boot" in habits:
            self._boots_at = self._boots_at or now + habits.seconds("slow-boot")
            if now < self._boots_at:
                return b""
        if now < self._saved_until:
            return self._refusal(pdu, _BUSY) if "busy-save" in habits else b""
        if pdu[0] == READ_IDENTIFICATION and "mute43" in habits:
            return b""
        self._asked += 1
        for name, code in (("busy", _BUSY), ("no-target", _NO_TARGET)):
            if name in habits and self._asked % habits.number(name) == 0:
                return self._refusal(pdu, code)
        response = self._answer(pdu)
        every, register = habits.number("lost-answer"), int.from_bytes(pdu[1:3], "big")
        if every and self._asked % every == 0 and register < _NOT_OF_THE_DRIVE:
            return b""
        if pdu[0] in _WRITES and register == _STORE:
            self.delay = habits.seconds("slow-save") + habits.seconds("silent-save")
            self._saved_until = now + max(
                habits.seconds("busy-save"), habits.seconds("silent-save")
            )
        return response

    def _refusal(self, pdu: bytes, code: int) -> bytes:
        if pdu[0] == _CYCLE:
            self._registers.device.end_cycle()  # its time passes for the drive, too
        return bytes((pdu[0] | 0x80, code))


class _HabitualFraming(Framing):
    """What goes over the wire, bent."""

    def __init__(self, plain: Framing, answers: _Answers, habits: Habits, *, rtu: bool) -> None:
        super().__init__(0, answers)
        self._plain = plain
        self._answers = answers
        self._habits = habits
        self._rtu = rtu
        self._sent = 0
        self._random = random.Random(1)  # noqa: S311

    @property
    def is_incomplete(self) -> bool:
        """Whether a part of a request waits for its rest."""
        return self._plain.is_incomplete

    def feed(self, data: bytes) -> list[bytes]:
        """The answers to what is complete, one each."""
        answers = [self._bent(answer) for answer in self._plain.feed(data)]
        self.is_closed = self._plain.is_closed
        echo = [data] if "echo" in self._habits else []
        return [*echo, *answers]

    def silence(self) -> list[bytes]:
        """Nothing more has come for a while."""
        return self._plain.silence()

    def _bent(self, answer: bytes) -> bytes:
        habits = self._habits
        self._sent += 1
        if "other-unit" in habits:
            unit = bytes((int(habits.values["other-unit"]) % 256,))
            if self._rtu:
                head = unit + answer[1:-2]
                answer = head + crc(head).to_bytes(2, "little")
            else:
                answer = answer[:6] + unit + answer[7:]
        every = habits.number("noise")
        if every and self._sent % every == 0:
            answer = _NOISE + answer
        return answer

    def due(self, answer: bytes) -> list[tuple[float, bytes]]:
        """When which part of an answer goes out, s from now."""
        habits = self._habits
        wait = self._answers.delay + habits.seconds("slow-answer")
        if "irregular" in habits:
            wait += self._random.uniform(0.0, habits.seconds("irregular"))
        if "fragments" not in habits:
            return [(wait, answer)]
        parts = [answer[at : at + _PIECE] for at in range(0, len(answer), _PIECE)]
        return [(wait + n * _PAUSE, part) for n, part in enumerate(parts)]
