"""Zones in which nothing starts: after an emergency stop, or beside what may still move."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from commissioning.fleet.board import Standing

__all__ = ["Zones"]

_STILL_ENABLED = 0.5  # s after which an axis of a zone shows that it was no emergency stop
_BY_NOBODY = float("inf")


class Zones:
    """Which are paused, and since when, s."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.paused: dict[str, float] = {}
        self._clock = clock

    def pause(self, zone: str, *, may_be_woken: bool) -> None:
        """Nothing starts there until somebody says so.

        `may_be_woken` : or until another axis of the zone shows that it is enabled still
        """
        since = self._clock() if may_be_woken else _BY_NOBODY
        self.paused[zone] = max(since, self.paused.get(zone, since))

    def free(self, zone: str) -> None:
        """Somebody has said so."""
        self.paused.pop(zone, None)

    def woken(self, running: Iterable[Standing]) -> Iterator[Standing]:
        """Axes that have shown that their zones go on, which they do from now on."""
        for one in running:
            zone = one.planned.zone
            if zone and one.moving_at > self.paused.get(zone, _BY_NOBODY) + _STILL_ENABLED:
                self.free(zone)
                yield one

    def held(self, waiting: Iterable[Standing], running: Iterable[Standing]) -> list[str]:
        """Paused zones in which something waits, and nothing runs any more."""
        wanted = {one.planned.zone for one in waiting}
        busy = {one.planned.zone for one in running}
        return [zone for zone in self.paused if zone in wanted and zone not in busy]
