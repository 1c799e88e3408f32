"""Whether a node lives: its heartbeat, or its answers to life guarding (CiA 301, 7.2.8)."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

from drivers.canopen.pdo import HEARTBEAT_PRODUCER
from drivers.canopen.pdo_parameters import PdoParameters
from drivers.canopen.wire import CanWire
from drivers.errors import AccessDenied, LinkLost

__all__ = ["Liveness"]

_HEARTBEAT_EVERY = 100  # ms, asked of a node that has none
_HEARTBEATS_MISSED = 3
_FIRST_BEAT, _FIRST_ANSWER = 1.0, 0.05  # s that are waited for it


class Liveness:
    """What a node tells of itself between two cycles."""

    def __init__(self, wire: CanWire, parameters: PdoParameters, *, is_guarded: bool) -> None:
        self._wire = wire
        self._pdos = parameters
        self._is_guarded = is_guarded
        self._silence_allowed = 0.0  # s without a heartbeat of the node; 0: it has none

    @property
    def is_told(self) -> bool:
        """Whether the node tells that it lives, and its silence is one."""
        return self._silence_allowed > 0

    def time(self) -> int | None:
        """Producer heartbeat time (1017h), ms; None: the node has none."""
        try:
            return self._pdos.number(*HEARTBEAT_PRODUCER)
        except AccessDenied:
            return None

    def ask(self, note: Callable[[int], None]) -> None:
        """See that the node tells that it lives: by its heartbeat (1017h), or as it is guarded.

        A node does not do both (CiA 301, 7.2.8.2.2.3). One that tells nothing is known by its TPDO
        alone. `note` : told the producer heartbeat time that was there, ms, once it is another.
        """
        wire, every = self._wire, self.time()
        is_guarded = self._is_guarded
        wanted = self.wanted(every)
        if every is not None and every != wanted:
            try:
                self._pdos.download(HEARTBEAT_PRODUCER, wanted)
            except AccessDenied:
                return
            note(every)
        self._silence_allowed = _HEARTBEATS_MISSED * (wanted or _HEARTBEAT_EVERY) / 1000
        if is_guarded or (every is None and wire.can_guard):
            wire.guard()  # which tells the state, too
        patience = _FIRST_ANSWER if every is None else _FIRST_BEAT
        wire.pump_until(lambda: wire.heartbeat_state is not None, patience)
        if every is None and not is_guarded:
            self._silence_allowed = 0.0

    def wanted(self, every: int | None) -> int:
        """Producer heartbeat time, ms: that which is there, and none of a node that is guarded."""
        return 0 if self._is_guarded else every or _HEARTBEAT_EVERY

    def supervise(self) -> None:
        """Raises LinkLost where the node has restarted, or fallen silent."""
        wire = self._wire
        if wire.restarted:
            wire.restarted = False  # said once: the stop path still waits for standstill
            raise LinkLost(
                f"node {wire.node} has restarted (its boot-up message was heard): was its supply "
                "interrupted?",
                code="link.restarted",
            )
        if not self._silence_allowed or wire.heartbeat_state is None:
            return
        asked = wire.guarded_at if self._is_guarded else wire.heard_at
        silent = perf_counter() - asked if asked is not None else 0.0
        if silent > self._silence_allowed:
            self._silence_allowed = 0.0
            raise LinkLost(
                f"no heartbeat from node {wire.node} for {silent * 1000:.0f} ms: the link is lost",
                code="link.heartbeat",
            )
