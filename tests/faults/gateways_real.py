"""The network between a client and a gateway, with the real engine and real TLS, is cut before, in
and after each message, either way: python -m tests.faults.gateways_real NUMBER…

Each run of a fleet is taken up until all is done; starts are counted in the gateway's own file.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from commissioning.fleet.ledger import Ledger
from commissioning.result.fleet import JobState
from tests.command import in_this_process
from tests.gateways.lines import At, fleet_file, keys_in

__all__ = ["CUTS", "Cut", "held_by_all"]

_HEADER = 5  # bytes of a TLS record
_TO_COME = 30.0  # s


@dataclass(frozen=True)
class Cut:
    """Where a connection ends: at the n-th TLS record, of those to the gateway or from it."""

    number: int
    place: str  # before | in | after
    to_gateway: bool

    def __str__(self) -> str:
        way = "to" if self.to_gateway else "from"
        return f"cut {self.place} TLS record {self.number} {way} the gateway"


CUTS = [
    Cut(number, place, to_gateway)
    for number in (2, 4, 6, 8, 10, 12, 14, 17, 20, 24, 30)
    for place in ("before", "in", "after")
    for to_gateway in (True, False)
]


@dataclass
class Proxy:
    """Between them; of the connections that come, the one of the engine is cut, once."""

    target: int
    cut: Cut | None = None
    connections: int = 0
    records: Counter[bool] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            gateway = socket.create_connection(("127.0.0.1", self.target))
            both = client, gateway
            for to_gateway in (True, False):
                threading.Thread(target=self._pass, args=(both, to_gateway), daemon=True).start()

    def _pass(self, both: tuple[socket.socket, socket.socket], to_gateway: bool) -> None:
        source, sink = both if to_gateway else both[::-1]
        with contextlib.suppress(OSError), contextlib.ExitStack() as at_end:
            for one in both:
                at_end.callback(_closed, one)
            while record := _record(source):
                self.records[to_gateway] += 1
                cut = self.cut
                is_it = (
                    cut is not None
                    and cut.to_gateway is to_gateway
                    and self.records[to_gateway] == cut.number
                )
                if is_it and cut is not None:
                    self.cut = None
                    sink.sendall({"before": b"", "in": record[: len(record) // 2]}.get(
                        cut.place, record
                    ))  # fmt: skip
                    return
                sink.sendall(record)

    def aim(self, cut: Cut) -> None:
        """From now on."""
        self.records.clear()
        self.cut = cut

    def close(self) -> None:
        self._listener.close()


def _closed(one: socket.socket) -> None:
    with contextlib.suppress(OSError):
        one.shutdown(socket.SHUT_RDWR)
    one.close()


def _record(source: socket.socket) -> bytes:
    header = _exactly(source, _HEADER)
    return header and header + _exactly(source, int.from_bytes(header[3:5], "big"))


def _exactly(source: socket.socket, count: int) -> bytes:
    found = b""
    while len(found) < count:
        part = source.recv(count - len(found))
        if not part:
            return b""
        found += part
    return found


def _held(cut: Cut, proxy: Proxy, at: At, keys: Path, folder: Path) -> str:
    """'' or why not."""
    home = folder / "home"
    path = fleet_file(folder / "line.toml", {"pc-a": at}, keys, ports={"pc-a": proxy.port})
    environment = {"TWORELAY_HOME": str(home)}
    before = len(at.moves())
    proxy.aim(cut)
    words = ["fleet", "run", str(path)]
    done = in_this_process(*words, environment=environment)
    for again in (["--resume"], ["--again", "failed"], ["--resume"]):  # as its last lines say
        if done.returncode == 0:
            break
        done = in_this_process(*words, *again, environment=environment)
    new = at.moves()[before:]
    starts = Counter(new)
    if done.returncode == 0 and max(starts.values(), default=0) == 1:
        with Ledger(home, reading=True) as ledger:
            states = {row.state for row in ledger.rows(ledger.record("last").id).values()}
        if states == {JobState.DONE} and len(new) == 2:
            return ""
    return f"exit {done.returncode}, starts {starts}: {done.stdout[-400:]} {done.stderr[-200:]}"


@contextlib.contextmanager
def _standing() -> Iterator[tuple[Proxy, At, Path]]:
    with tempfile.TemporaryDirectory() as folder:
        keys = keys_in(Path(folder) / "keys", "pc-a")
        axes = {name: f'link = "virtual://bench?seed={n}"\n' for n, name in enumerate("xy")}
        with At(Path(folder), "pc-a", keys, axes, 0.3).running() as at:
            proxy = Proxy(at.port)
            try:
                yield proxy, at, keys
            finally:
                proxy.close()


def held_by_all(cuts: list[Cut]) -> Iterator[tuple[Cut, str]]:
    """Each cut, and '' or why it did not hold."""
    with _standing() as (proxy, at, keys):
        for cut in cuts:
            with tempfile.TemporaryDirectory() as folder:
                yield cut, _held(cut, proxy, at, keys, Path(folder))


def main() -> None:
    """A line a cut: `+` or `-` and why not."""
    out = os.dup(1)
    for cut, why in held_by_all([CUTS[int(word)] for word in sys.argv[1:]]):
        os.write(out, f"{'-' if why else '+'} {cut} {' '.join(why.split())}\n".encode())
    os._exit(0)  # the engine's threads have no end of their own


if __name__ == "__main__":
    main()
