"""The stop path: it acts before it asks, needs nothing that may have failed, and says what it reached."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import NamedTuple

from drivers.drive import Bus, StopFrames, StopReport
from profiles.errors import AccessDenied, WriteFailed
from profiles.schema import Address, Profile, Step

__all__ = ["Rest", "StopPath"]

_POLL = 0.005  # s between two looks at a drive that is stopping
_AT_REST, _RESTING = 3, 1e-4  # increments, or revolutions, between two looks: it does not move
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
        self._at_rest = max(_AT_REST, _RESTING * revolution) if revolution < inf else _AT_REST
        power = profile.power
        self._says_braking = power is None or power.stopping is not None
        self._looks = max(round(profile.stop_time / _POLL), _FEWEST_LOOKS)

    def frames(self, rest: Rest) -> StopFrames | None:
        """What another process writes to our port to stop the drive; None: it connects by itself."""
        descriptor, port = self._bus.descriptor(), self._bus.port()
        if descriptor is None and port is None:
            return None

        def made(steps: tuple[Step, ...], *, waits: bool) -> list[tuple[bytes, float]]:
            found: list[tuple[bytes, float]] = []
            for step in steps:
                if (
                    step.until is not None and found and waits
                ):  # nobody reads: as long as it may take
                    found[-1] = found[-1][0], max(step.within, _BETWEEN_FRAMES)
                found += [
                    (self._bus.frame(address, raw), _BETWEEN_FRAMES)
                    for address, raw in self._writes((step,))
                ]
            return found

        first = (self._bus.frame(*rest), _BETWEEN_FRAMES)
        # at once, and once more in case that a frame is lost; only the last time is waited
        halts = [[first, *made(self._profile.stop, waits=n == 1)] for n in range(_REPEATS, 0, -1)]
        every = [frame for halt in halts for frame in halt]
        every[-1] = (every[-1][0], max(every[-1][1], self._profile.stop_time))
        for n in range(_REPEATS, 0, -1):
            every += made(self._profile.disable, waits=n == 1)
        return StopFrames(descriptor, tuple(every), port)

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

        def perform(steps: tuple[Step, ...]) -> None:
            """Writes at once, up to a step that waits; an `until` is waited for, and told when in vain."""
            for step in steps:
                if step.until is not None:
                    attempt(lambda step=step: self._await(step, hurry))  # type: ignore[misc]
                else:
                    post(self._writes((step,)))

        if "controlword" in self._profile.cycle.out:
            # both travel in one frame, and it must not say "enable operation" once more
            perform(self._profile.stop)
            post([rest])
        else:
            post([rest])
            perform(self._profile.stop)
        if not hurry():
            attempt(lambda: self._await_standstill(hurry))
        perform(self._profile.disable)
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

    def _await(self, step: Step, hurry: Callable[[], bool]) -> None:
        """Wait as a step says; raises WriteFailed when that is in vain, LinkError."""
        name, waited = step.until or "", 0.0
        address = self._profile.parameters[name].address
        while (there := self._bus.read(address)) & step.mask != step.equals and not hurry():
            if waited >= step.within:
                raise WriteFailed(
                    f"stop: '{name}' reads {there} for {step.within:g} s instead of {step.equals}"
                )
            self._bus.wait(_POLL)
            waited += _POLL

    def _await_standstill(self, hurry: Callable[[], bool]) -> None:
        """Wait until the drive has stopped the axis and closed the brake, at most `stop_time`.

        Where a drive has no word for braking, one that is not enabled any more may still brake: then the
        axis has to be at rest, too. An axis that becomes faster is not being stopped: then the energy goes.
        """
        at, time = self._position(), self._bus.now()
        most, faster, resting = 0.0, 0, 0
        for look in range(self._looks):
            if hurry():
                return
            if not self._is_energised() and (self._says_braking or resting >= _FEWEST_LOOKS):
                return
            self._bus.wait(_POLL)
            before, at = at, self._position()
            since, time = time, self._bus.now()
            # nan where it cannot be read: no faster than anything
            speed = abs(at - before) / (time - since)
            resting = 0 if abs(at - before) > self._at_rest else resting + 1
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
