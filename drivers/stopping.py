"""The stop path.

It acts before it asks, needs nothing that may have failed, and says what it reached.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from math import inf, nan
from typing import NamedTuple, TypeVar

from drivers.bus import Bus, StopFrames
from drivers.drive import StopReport
from drivers.errors import AccessDenied, WriteFailed
from profiles.address import Address
from profiles.procedures import Step
from profiles.schema import Profile

__all__ = ["Rest", "StopPath"]

T = TypeVar("T")

_POLL = 0.005  # s between two looks at a drive that is stopping
_AT_REST, _RESTING = 3, 1e-4  # increments, or revolutions, between two looks: it does not move
_FEWEST_LOOKS = 3
# a stop that makes the axis faster is none: a speed that is more than so many times that of the
# first looks, and so many revolutions a second more, in so many looks
_TIMES, _REVOLUTIONS, _FIRST_LOOKS, _FASTER_LOOKS = 1.2, 0.3, 2, 2
_BETWEEN_FRAMES = 0.03  # s, for an answer that nobody reads
_REPEATS = 3  # of frames that nobody confirms


class Rest(NamedTuple):
    """The set-point with which the axis rests."""

    address: Address
    raw: int


class _Busy(Exception):
    """The drive has no time to answer; that tells nothing."""


def _now(look: Callable[[], T]) -> T:
    """What a look at the drive tells; raises _Busy where it says that it has no time."""
    try:
        return look()
    except AccessDenied as error:
        if error.busy:
            raise _Busy from None
        raise


class _Said:
    """What was said to a drive, whatever fails.

    Attributes
    ----------
    failures : in words
    refused : writes for which the drive had no time
    is_put_off : so it was when it was said again last
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.failures: list[str] = []
        self.refused: list[tuple[Address, int]] = []
        self.is_put_off = False

    def fail(self, error: Exception) -> None:
        """Note what failed."""
        self.failures.append(str(error) or type(error).__name__)

    def attempt(self, action: Callable[[], None]) -> None:
        """Do it, or note why not."""
        try:
            action()
        except Exception as error:
            self.fail(error)

    def post(self, writes: list[tuple[Address, int]]) -> None:
        """Write without waiting."""
        for address, raw in writes:
            try:
                _now(lambda at=address, raw=raw: self._bus.post(at, raw))  # type: ignore[misc]
            except _Busy:
                self.refused.append((address, raw))
            except Exception as error:
                self.fail(error)

    def forget(self) -> None:
        """What was refused is not to be done any more."""
        self._bus.refused_posts()
        self.refused.clear()

    def again(self) -> None:
        """What was refused for now, in its order."""
        self.refused += self._bus.refused_posts()
        self.is_put_off = bool(self.refused)
        waiting = self.refused.copy()
        self.refused.clear()
        self.post(waiting)


class StopPath:
    """Ways to stop the drive on `bus`.

    Parameters
    ----------
    is_energised : asks the drive whether it controls the axis
    revolution : increments a motor revolution; inf where it is not known: then no speed is judged
    """

    def __init__(
        self, bus: Bus, profile: Profile, is_energised: Callable[[], bool], revolution: float
    ) -> None:
        self._bus = bus
        self._profile = profile
        self._is_energised = is_energised
        self._noise = _REVOLUTIONS * revolution  # increments/s
        self._at_rest = max(_AT_REST, _RESTING * revolution) if revolution < inf else _AT_REST
        power = profile.power
        self._says_braking = power is None or power.stopping is not None
        self._looks = max(round(profile.stop_time / _POLL), _FEWEST_LOOKS)

    def frames(self, rest: Rest) -> StopFrames | None:
        """What another process writes to our port to stop the drive.

        None: it connects by itself.
        """
        descriptor, port = self._bus.descriptor(), self._bus.port()
        if descriptor is None and port is None:
            return None

        every: list[tuple[bytes, float]] = []

        def add(writes: list[tuple[Address, int]], pause: float) -> None:
            """Frames at once, and twice more in case that one is lost.

            Then a pause, for nobody reads.
            """
            every.extend(
                (self._bus.frame(address, raw), _BETWEEN_FRAMES)
                for address, raw in writes * _REPEATS
            )
            every[-1] = (every[-1][0], max(every[-1][1], pause))

        for writes, pause in self._groups(self._profile.stop, [rest]):
            add(writes, pause)
        every[-1] = (every[-1][0], max(every[-1][1], self._profile.stop_time))
        for writes, pause in self._groups(self._profile.disable, []):
            add(writes, pause)
        return StopFrames(descriptor, tuple(every), port)

    def _groups(
        self, steps: tuple[Step, ...], writes: list[tuple[Address, int]]
    ) -> list[tuple[list[tuple[Address, int]], float]]:
        """Writes up to a step that waits, and how long that may take, s.

        Then those up to the next one.
        """
        found, group = [], list(writes)
        for step in steps:
            if step.until is None:
                group += self._writes((step,))
            else:
                found.append((group, step.within))
                group = []
        return [*found, (group, 0.0)] if group else found

    def _writes(self, steps: tuple[Step, ...]) -> list[tuple[Address, int]]:
        return [
            (self._profile.parameters[step.write].address, step.raw)
            for step in steps
            if step.write is not None and step.raw is not None
        ]

    def stop(
        self, rest: Rest, hurry: Callable[[], bool], afterwards: Callable[[], None]
    ) -> StopReport:
        """Rest set-point and quick stop at once, then look, then take the energy away, then look.

        `hurry` says that the energy must go now, without waiting for standstill; `afterwards` is
        done on a drive that has none any more. Never raises.
        """
        said = _Said(self._bus)

        def perform(steps: tuple[Step, ...]) -> None:
            """Writes at once, up to a step that waits.

            An `until` is waited for, and told when in vain.
            """
            for step in steps:
                if step.until is not None:
                    said.attempt(lambda step=step: self._await(step, hurry))  # type: ignore[misc]
                else:
                    said.post(self._writes((step,)))

        if "controlword" in self._profile.cycle.out:
            # both travel in one frame, and it must not say "enable operation" once more
            perform(self._profile.stop)
            said.post([rest])
        else:
            said.post([rest])
            perform(self._profile.stop)
        if not hurry():
            said.attempt(lambda: self._await_standstill(hurry, said.again))
        said.forget()  # a quick stop after it would be one too many
        perform(self._profile.disable)
        state: bool | None = None
        deadline = self._bus.now() + self._profile.stop_time
        for look in range(self._looks):
            if look >= _FEWEST_LOOKS and self._bus.now() > deadline:
                break
            try:
                state = not self._energised_now()
            except Exception as error:
                said.fail(error)
                break
            if state:
                said.attempt(afterwards)
                break
            said.again()
            said.attempt(lambda: self._bus.wait(_POLL))
        if not state and said.is_put_off:
            said.failures.append("the drive says that it is busy, and takes no command")
        return StopReport(state, tuple(dict.fromkeys(said.failures)))

    def _await(self, step: Step, hurry: Callable[[], bool]) -> None:
        """Wait as a step says; raises WriteFailed when that is in vain, LinkError."""
        name = step.until or ""
        address = self._profile.parameters[name].address
        deadline = self._bus.now() + step.within
        there: int | None = None
        while not hurry():
            with contextlib.suppress(_Busy):
                there = _now(lambda: self._bus.read(address))
                if there & step.mask == step.equals:
                    return
            if self._bus.now() >= deadline:
                raise WriteFailed(
                    f"stop: '{name}' reads {there} for {step.within:g} s instead of {step.equals}",
                    code="procedure.in-vain",
                )
            self._bus.wait(_POLL)

    def _energised_now(self) -> bool:
        """Whether the drive has energy, as far as is known: one that has no time to tell has."""
        try:
            return _now(self._is_energised)
        except _Busy:
            return True

    def _await_standstill(self, hurry: Callable[[], bool], again: Callable[[], None]) -> None:
        """Wait until the drive has stopped the axis and closed the brake, at most `stop_time`.

        Where a drive has no word for braking, one that is not enabled any more may still brake:
        then the axis has to be at rest, too. An axis that becomes faster is not being stopped: then
        the energy goes.
        """
        at, time = self._position(), self._bus.now()
        most, faster, resting = 0.0, 0, 0
        deadline = time + self._profile.stop_time
        for look in range(self._looks):
            if hurry() or (look >= _FEWEST_LOOKS and time > deadline):
                return
            if not self._energised_now() and (self._says_braking or resting >= _FEWEST_LOOKS):
                return
            again()
            self._bus.wait(_POLL)
            before, at = at, self._position()
            since, time = time, self._bus.now()
            # nan where it cannot be read: no faster than anything
            speed = abs(at - before) / (time - since)
            resting = resting + 1 if abs(at - before) <= self._at_rest else 0
            if look < _FIRST_LOOKS:
                most = max(most, _TIMES * speed + self._noise)
                continue
            faster = faster + 1 if speed > most else 0
            if faster >= _FASTER_LOOKS:
                return

    def _position(self) -> float:
        """Position, increments; nan where it is not needed or cannot be read."""
        if self._noise == inf and self._says_braking:
            return nan
        try:
            return self._bus.read(self._profile.parameters["position_actual"].address)
        except AccessDenied:
            return nan
