"""From a cause to zero torque on the wire and to rest, on each link, in real time."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from commissioning.envelope import Envelope
from commissioning.errors import EnvelopeTripped
from commissioning.experiments.plan import Plan
from commissioning.guardian import NOBODY, Guardian, guarded
from commissioning.interruption import Interruption
from commissioning.runner import Recorder, run
from drivers.drive import Drive
from drivers.link import open_drive
from profiles.axis import Axis
from profiles.errors import TwoRelayError
from tests.faults.proxy import WIRES, Proxy, Way, drive_end

__all__ = ["stop_times"]

HERE = Path(__file__).parent
_TIMES = 50  # a cause and link
_TRIES = 5
_CYCLE = 0.005  # s
_TORQUE, _TURN = 0.13, 20  # N.m, cycles: bench moves to and fro at up to 3 rad/s
_BEFORE = 40, 80  # cycles until the cause
_ENABLED, _AT_REST = 0x27, 400  # statusword's state bits; increments/s: 0.02 rad/s
CTRL_C, LIMIT, DRIVE, DEAD = "Ctrl-C", "limit of the envelope", "drive stops", "dead link"
SILENT = "loop silent (guardian)"
_FROZEN = 1.2  # s
_FEEDS = 5000
_UNWATCHED = 'extends = "{}"\nname = "unwatched"\n[watchdog]\nkind = "none"\n'
_TORQUE_REGISTER = 0x0100


_HEAD = """# Stop times

`python -m benchmarks.stop_times`: {times} stops of `bench` a row, in real time, cycle {cycle:g} ms; median / 99 % / worst.
*To zero*: from the cause to the frame with zero torque leaving this computer. *To rest*: to the last instant at which
another master saw the axis move. *Out of operation*: until the drive no longer follows a command: after a dead link by
its own watchdog of 50 ms, for what this computer sends then reaches nobody; after a loop that falls silent, on a drive
without a watchdog, by the guardian, which waits for 250 ms."""


@dataclass
class _Stop:
    """Instants of one stop, s of the performance counter."""

    cause: float = 0.0
    sent: list[tuple[float, tuple[Any, ...]]] = field(default_factory=list)

    def trace(self, sending: bool, *frame: Any) -> None:
        """What the driver calls with every frame."""
        if sending:
            self.sent.append((time.perf_counter(), frame))

    @property
    def zero_sent(self) -> float:
        """When the first frame left after the cause that takes the torque away."""
        return next(at for at, frame in self.sent if at >= self.cause and _is_zero(frame))


def _is_zero(frame: tuple[Any, ...]) -> bool:
    """Whether a frame commands zero torque: a register of its own, or the torque in the RPDO."""
    if len(frame) == 2:
        cob_id, data = frame
        return bool(cob_id == 0x205 and data[2:4] == b"\0\0")
    (data,) = frame
    pdu = data[7:] if data[2:4] == b"\0\0" else data[1:]  # MBAP, else RTU
    function, register = struct.unpack_from(">BH", pdu)
    value = pdu[3:5] if function == 6 else pdu[6:8]
    return function in (6, 16) and register == _TORQUE_REGISTER and value == b"\0\0"


def _plan(stop: _Stop, count: int, end: Callable[[], None]) -> Plan[None]:
    n = 0
    while True:
        yield _TORQUE if n // _TURN % 2 == 0 else -_TORQUE
        n += 1
        if n == count:
            end()


class _Observer:
    """Another master on a connection of its own, in another process: what the drive really does."""

    def __init__(self, link: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.stop_times", link], cwd=HERE.parent,
            stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        self._process.stdout.readline()
        self.seen: list[tuple[float, int, int]] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            at, word, velocity = line.split()
            self.seen.append((float(at), int(word), int(velocity)))

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._reader.join()
        self._process.wait()

    def left_operation(self, since: float) -> float:
        """When the drive was no longer enabled, s."""
        return next(t for t, word, _ in self.seen if t >= since and word & 0x6F != _ENABLED)

    def at_rest(self, since: float) -> float:
        """When the axis had come to rest for good, s."""
        moving = [t for t, _, v in self.seen if t >= since and abs(v) > _AT_REST]
        return max(moving, default=since)


def _observe(link: str) -> None:
    """The observer's process: one line a look, until standard input ends."""
    ended = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    drive = open_drive(Axis(link=link, profile="virtual-modbus"))
    print("ready", flush=True)
    while not ended.is_set():
        word, velocity = drive.read("statusword").raw, drive.read("velocity_actual").raw
        print(f"{time.perf_counter():.6f} {word} {velocity}", flush=True)
        time.sleep(0.001)
    drive.close()


@contextmanager
def _served(wire: str) -> Iterator[tuple[str, str]]:
    """Links of one drive: on the wire, and by Modbus TCP for whoever looks on."""
    arguments = [*WIRES["modbus-tcp"].serve, *(WIRES[wire].serve if wire != "modbus-tcp" else ())]
    with subprocess.Popen(
        [sys.executable, "-m", "commissioning", "virtual", "serve", "bench", *arguments],
        stdout=subprocess.PIPE, text=True, cwd=HERE.parent,
    ) as server:  # fmt: skip
        assert server.stdout is not None
        try:
            found = [server.stdout.readline().strip() for _ in range(len(arguments) // 2)]
            yield found[-1], found[0]
        finally:
            server.terminate()


class _Causes:
    """What ends a motion; each says when it came."""

    def __init__(self, stop: _Stop, proxy: Proxy | None, look_link: str, delay: float) -> None:
        self._stop, self._proxy, self._look_link, self._delay = stop, proxy, look_link, delay
        self._timer: threading.Timer | None = None

    def act(self, cause: str) -> None:
        """Now, or within the coming cycle where the world decides."""
        if cause == LIMIT:
            self._now()
            raise EnvelopeTripped("a limit")
        if cause == SILENT:
            self._now()
            time.sleep(_FROZEN)
            return
        act = {CTRL_C: self._interrupt, DRIVE: self._fail, DEAD: self._cut}[cause]
        self._timer = threading.Timer(self._delay, act)
        self._timer.start()

    def join(self) -> None:
        """It has acted."""
        if self._timer is not None:
            self._timer.join()

    def _now(self) -> None:
        self._stop.cause = time.perf_counter()

    def _interrupt(self) -> None:
        self._now()
        os.kill(os.getpid(), signal.SIGINT)

    def _fail(self) -> None:
        other = open_drive(Axis(link=self._look_link, profile="virtual-modbus"))
        self._now()
        other._bus.write(other.profile.parameters["controlword"].address, 0)
        other.close()

    def _cut(self) -> None:
        self._now()
        assert self._proxy is not None
        self._proxy.cut()


def _once(wire: str, drive_link: str, look_link: str, cause: str, draw: random.Random) -> _Stop:
    """One stop; the drive is ready for the next one after it."""
    stop = _Stop()
    kind = WIRES[wire]
    # a guardian connects beside the loop, and the proxy is for one
    proxy = Proxy(kind, drive_end(drive_link), None, Way.SILENT) if cause != SILENT else None
    link = drive_link if proxy is None else kind.link.format(proxy.place)
    axis = Axis(link=link, profile=kind.profile, travel=100.0)
    causes = _Causes(stop, proxy, look_link, draw.random() * _CYCLE)
    plan = _plan(stop, draw.randint(*_BEFORE), lambda: causes.act(cause))
    envelope = Envelope(centre=0.0, travel=1e6, speed=1e6, torque=1.0, duration=60.0)
    try:
        drive = open_drive(axis, cycle=_CYCLE, trace=stop.trace)
        try:
            if drive.state().in_fault:
                drive.reset_fault()
            for name, raw in drive.preparation.watchdog().items():
                drive.write(name, 0 if cause == SILENT and name == "watchdog_time" else raw)
            with (
                tempfile.TemporaryDirectory() as home,
                _guarded(drive, axis, Path(home), cause) as guardian,
                Interruption() as interruption,
                contextlib.suppress(TwoRelayError),
            ):
                run(plan, drive, envelope, Recorder(), interruption, guardian=guardian)
        finally:
            causes.join()
            drive.close()
    finally:
        if proxy is not None:
            proxy.close()
    time.sleep(0.3 if cause in (DEAD, SILENT) else 0.1)  # until the drive's own watchdog has done
    return stop


@contextmanager
def _guarded(drive: Drive, axis: Axis, home: Path, cause: str) -> Iterator[Guardian]:
    """The guardian of a drive without a watchdog, where it is what stops the axis."""
    if cause != SILENT:
        yield NOBODY
        return
    profile = home / "unwatched.toml"
    profile.write_text(_UNWATCHED.format(axis.profile))
    with guarded(drive, axis, profile, "none", home) as guardian:
        yield guardian


def _cost_of_feeding() -> str:
    """What the guardian takes of a cycle."""
    with _served("modbus-tcp") as (link, _), tempfile.TemporaryDirectory() as home:
        axis = Axis(link=link, profile="virtual-modbus")
        drive = open_drive(axis, cycle=_CYCLE)
        with _guarded(drive, axis, Path(home), SILENT) as guardian:
            guardian.arm()
            spent = []
            for _ in range(_FEEDS):
                time.sleep(0.0005)
                begin = time.perf_counter()
                guardian.feed()
                spent.append(1e6 * (time.perf_counter() - begin))
            guardian.rest()
        drive.close()
    return f"The guardian takes {_three(spent)} µs of a cycle ({_FEEDS} words to it, median / 99 % / worst)."


def _some(wire: str, drive_link: str, look_link: str, cause: str, draw: random.Random) -> _Stop:
    """A stop by that cause; on a busy machine the motion may end by another one before it."""
    for _ in range(_TRIES):
        stop = _once(wire, drive_link, look_link, cause, draw)
        if stop.cause:
            return stop
    raise SystemExit(f"{wire}: the motion ends before '{cause}', {_TRIES} times")


def stop_times(times: int = _TIMES) -> list[str]:
    """The table."""
    lines = [
        *_HEAD.format(times=times, cycle=1000 * _CYCLE).splitlines(),
        "",
        "| link | cause | to zero, ms | worst, cycles | to rest, ms | out of operation, ms |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    draw = random.Random(0)
    for wire in (name for name, kind in WIRES.items() if not kind.is_own):
        with _served(wire) as (drive_link, look_link):
            for cause in (CTRL_C, LIMIT, DRIVE, DEAD, SILENT):
                observer = _Observer(look_link)
                stops = [_some(wire, drive_link, look_link, cause, draw) for _ in range(times)]
                observer.close()
                zero = [1000 * (stop.zero_sent - stop.cause) for stop in stops if cause != SILENT]
                rest = [
                    1000 * (observer.at_rest(s.cause) - s.cause) for s in _apart(stops, observer)
                ]
                own = (
                    _three([1000 * (observer.left_operation(s.cause) - s.cause) for s in stops])
                    if cause in (DEAD, SILENT)
                    else "–"
                )
                cycles = f"{max(zero) / 1000 / _CYCLE:.1f}" if zero else "–"
                lines.append(
                    f"| {wire} | {cause} | {_three(zero) if zero else '–'} | {cycles} | {_three(rest)} "
                    f"| {own} |"
                )
                print(lines[-1], flush=True)
    return [*lines, "", _cost_of_feeding()]


def _apart(stops: list[_Stop], observer: _Observer) -> Iterator[_Stop]:
    """Each stop, the observer's view cut off where the next one begins."""
    seen = observer.seen
    for stop, after in zip(stops, [*stops[1:], None], strict=True):
        end = after.sent[0][0] if after is not None else float("inf")
        observer.seen = [look for look in seen if stop.cause <= look[0] < end]
        yield stop
    observer.seen = seen


def _three(values: list[float]) -> str:
    """Median, 99 %, worst."""
    ranked = sorted(values)
    high = ranked[min(len(ranked) - 1, round(0.99 * len(ranked)))]
    return f"{statistics.median(ranked):.2f} / {high:.2f} / {ranked[-1]:.2f}"


if __name__ == "__main__":
    if len(sys.argv) > 1 and "://" in sys.argv[1]:
        _observe(sys.argv[1])
    else:
        table = stop_times(int(sys.argv[1]) if len(sys.argv) > 1 else _TIMES)
        (HERE / "stop_times.md").write_text("\n".join(table) + "\n", "utf-8")
