"""The cycle without an experiment: every output zero, the drive without energy."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from drivers.access import RawAccess
from drivers.bus import SET, Exchange
from drivers.errors import PreflightRefused
from drivers.modes import Modes
from profiles.procedures import Mode

__all__ = ["Rehearsal"]


class Rehearsal:
    """Exchanges that measure a link; nothing is set, nothing moves."""

    def __init__(self, access: RawAccess, modes: Modes, is_energised: Callable[[], bool]) -> None:
        self._access = access
        self._modes = modes
        self._is_energised = is_energised

    @property
    def status(self) -> str:
        """Parameter that says how the drive is."""
        power = self._access.profile.power
        return "statusword" if power is None else power.enabled.parameter

    def check(self) -> None:
        """Raises PreflightRefused where the cycle must not be exchanged without an experiment."""
        if self._is_energised():
            raise PreflightRefused(
                "the drive is enabled, so somebody else controls it: its cycle is not disturbed",
                code="refused.enabled",
            )
        profile = self._access.profile
        steps = self._modes.supported(Mode.TORQUE).before
        settings = [s.write for s in steps if s.write is not None and s.write not in SET]
        if profile.power is not None and settings:
            raise PreflightRefused(
                f"a cycle of {profile} needs {settings[0]} set before (or the drive may store each "
                "command): the experiment does that, and puts it back; this measurement writes no "
                "setting",
                code="rehearsal.settings",
                hint="'tworelay identify' tells how late its cycles were",
            )

    def cycles(self, count: int) -> Iterator[Exchange]:
        """`count` cycles with every output at zero; raises PreflightRefused, LinkError."""
        self.check()
        bus = self._access.bus
        zeros = (0,) * len(self._access.profile.cycle.out)
        bus.start(zeros)
        for _ in range(count):
            yield bus.exchange(zeros)
