"""The stop path: it acts before it asks, needs nothing that may have failed, and says what it reached."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import NamedTuple

from drivers.drive import Bus, StopFrames, StopReport
from profiles.errors import AccessDenied
from profiles.schema import Address, Profile, Step

__all__ = ["Rest", "StopPath"]

_POLL = 0.005  # s between two looks at a drive that is stopping
_FEWEST_LOOKS = 3
# a stop that makes the axis faster is none: a speed that is more than so many times that of the first looks,
# and so many revolutions a second more, in so many looks
_TIMES, _REVOLUTIONS, _FIRST_LOOKS, _FASTER_LOOKS = 1.2, 0.3, 2, 2
_BETWEEN_FRAMES = 0.03  # s, for an answer that nobody reads
_REPEATS = 3  # of frames that nobody confirms


class Rest(NamedTuple):
    """The set-point with which the axis rests."""

    address: Address
    raw: int


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
        self._looks = max(round(profile.stop_time / _POLL), _FEWEST_LOOKS)

    def frames(self, rest: Rest) -> StopFrames | None:
        """What another process writes to our port to stop the drive; None: it connects by itself."""
        descriptor, port = self._bus.descriptor(), self._bus.port()
        if descriptor is None and port is None:
            return None

        def made(steps: tuple[Step, ...]) -> list[tuple[bytes, float]]:
            return [
                (self._bus.frame(address, raw), _BETWEEN_FRAMES)
                for address, raw in self._writes(steps)
            ]

        halt = [(self._bus.frame(*rest), _BETWEEN_FRAMES), *made(self._profile.stop)] * _REPEATS
        halt[-1] = (halt[-1][0], self._profile.stop_time)
        every = (*halt, *made(self._profile.disable) * _REPEATS)
        return StopFrames(descriptor, every, port)

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

        `hurry` says that the energy must go now, without waiting for standstill; `afterwards` is done on
        a drive that has none any more. Never raises.
        """
        failures: list[str] = []

        def attempt(action: Callable[[], None]) -> None:
            try:
                action()
            except Exception as error:
                failures.append(str(error) or type(error).__name__)

        def post(writes: list[tuple[Address, int]]) -> None:
            for address, raw in writes:
                attempt(lambda address=address, raw=raw: self._bus.post(address, raw))  # type: ignore[misc]

        halt = self._writes(self._profile.stop)
        if "controlword" in self._profile.cycle.out:
            # both travel in one frame, and it must not say "enable operation" once more
            post([*halt, rest])
        else:
            post([rest, *halt])
        if not hurry():
            attempt(lambda: self._await_standstill(hurry))
        post(self._writes(self._profile.disable))
        state: bool | None = None
        for _ in range(self._looks):
            try:
                state = not self._is_energised()
            except Exception as error:
                failures.append(str(error) or type(error).__name__)
                break
            if state:
                attempt(afterwards)
                break
            attempt(lambda: self._bus.wait(_POLL))
        return StopReport(state, tuple(dict.fromkeys(failures)))

    def _await_standstill(self, hurry: Callable[[], bool]) -> None:
        """Wait until the drive has stopped the axis and closed the brake, at most `stop_time`.

        An axis that becomes faster is not being stopped: then the energy goes at once.
        """
        at, time = self._position(), self._bus.now()
        most, faster = 0.0, 0
        for look in range(self._looks):
            if not self._is_energised() or hurry():
                return
            self._bus.wait(_POLL)
            before, at = at, self._position()
            since, time = time, self._bus.now()
            # nan where it cannot be read: no faster than anything
            speed = abs(at - before) / (time - since)
            if look < _FIRST_LOOKS:
                most = max(most, _TIMES * speed + self._noise)
                continue
            faster = faster + 1 if speed > most else 0
            if faster >= _FASTER_LOOKS:
                return

    def _position(self) -> float:
        """Position, increments; nan where it is not needed or cannot be read."""
        if self._noise == inf:
            return nan
        try:
            return self._bus.read(self._profile.parameters["position_actual"].address)
        except AccessDenied:
            return nan
