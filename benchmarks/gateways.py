"""What gateways cost: a thousand fake axes on twenty of them, and a stop that goes through one."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from benchmarks.links import WIRES, served
from drivers.link import open_drive
from profiles.axis import Axis
from tests.gateways.lines import At, fleet_file, keys_in

__all__ = ["gateways"]

HERE = Path(__file__).parent
_GATEWAYS, _EACH = 20, 50
_STOPS = 20
_MOVING, _PATIENCE = 100, 60.0  # looks with torque before it is stopped, s
_FRESH = 0.02  # s since the last look, which saw torque


def gateways() -> list[str]:
    """Both tables."""
    return [
        "# Gateways",
        "",
        f"Written by `python benchmarks/run.py gateways`, on one machine of {os.cpu_count()} processors.",
        "",
        *_scale(),
        "",
        *_stops(),
    ]


# -- a thousand axes ------------------------------------------------------------------------------


def _scale() -> list[str]:
    with tempfile.TemporaryDirectory() as text, contextlib.ExitStack() as stack:
        folder = Path(text)
        names = [f"pc-{n:02d}" for n in range(_GATEWAYS)]
        keys = keys_in(folder / "keys", *names)
        ats = {}
        for g, name in enumerate(names):
            axes = {
                f"x{g:02d}-{n:02d}": f'link = "virtual://bench?seed={100 * g + n}"\n'
                for n in range(_EACH)
            }
            ats[name] = stack.enter_context(At(folder, name, keys, axes, 0.0).running())
        path = fleet_file(folder / "big.toml", ats, keys)
        begin = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "commissioning", "fleet", "run", str(path), "--json",
             str(folder / "f.json")],
            cwd=HERE.parent, stdout=subprocess.DEVNULL,
            env={**os.environ, "TWORELAY_HOME": str(folder / "home")},
        )  # fmt: skip
        client = _peak(process)
        whole = time.perf_counter() - begin
        own = [_memory(at.process.pid) for at in ats.values() if at.process is not None]
        tree = json.loads((folder / "f.json").read_text())
        states = {axis["state"] for axis in tree["axes"]}
        count = len(tree["axes"])
        moves = sum(len(at.moves()) for at in ats.values())
    return [
        f"{count} axes of {_GATEWAYS} gateways, jobs that take no time: each is looked at, offered, started, told and",
        f"written into both ledgers. All ended {', '.join(states)}; {moves} starts.",
        "",
        "| | |",
        "| --- | --- |",
        f"| an axis | {1000 * whole / count:.1f} ms |",
        f"| the client, at most | {client:.0f} MB |",
        f"| a gateway, median / most | {statistics.median(own):.0f} / {max(own):.0f} MB |",
    ]


def _memory(pid: int) -> float:
    return float(psutil.Process(pid).memory_info().rss) / 1e6


def _peak(process: subprocess.Popen[bytes]) -> float:
    """MB, at most, until it has ended."""
    most = 0.0
    while process.poll() is None:
        with contextlib.suppress(psutil.Error):
            most = max(most, _memory(process.pid))
        time.sleep(0.05)
    return most


# -- a stop ---------------------------------------------------------------------------------------


def _look_on(link: str) -> None:
    """The looker-on's process: instant, torque and statusword, until standard input ends."""
    ended = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    drive = open_drive(Axis(link=link, profile="virtual-modbus"))
    while not ended.is_set():
        torque, word = drive.read("torque_actual").raw, drive.read("statusword").raw
        sys.stdout.write(f"{time.time():.6f} {torque} {word}\n")
        sys.stdout.flush()
        time.sleep(0.001)
    drive.close()


@contextlib.contextmanager
def _looker_on(link: str) -> Iterator[list[tuple[float, int, int]]]:
    seen: list[tuple[float, int, int]] = []
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.gateways", link], cwd=HERE.parent, text=True,
        stdout=subprocess.PIPE, stdin=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdin is not None
        out = process.stdout

        def read() -> None:
            for line in out:
                at, torque, word = line.split()
                seen.append((float(at), int(torque), int(word)))

        reader = threading.Thread(target=read)
        reader.start()
        try:
            yield seen
        finally:
            process.stdin.close()
            reader.join()


def _stopped(path: Path, home: Path, link: str) -> float:
    """From the key until it is seen that there is no torque any more, s."""
    with _looker_on(link) as seen:
        process = subprocess.Popen(
            [sys.executable, "-m", "commissioning", "fleet", "run", str(path)], cwd=HERE.parent,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, "TWORELAY_HOME": str(home)},
        )  # fmt: skip
        until = time.monotonic() + _PATIENCE
        while sum(abs(torque) > 0 for _, torque, _ in seen) < _MOVING:
            assert time.monotonic() < until, "it does not move"
            time.sleep(0.01)
        time.sleep(random.uniform(0.0, 0.2))
        while not (seen[-1][1] and time.time() - seen[-1][0] < _FRESH):
            assert time.monotonic() < until, "it does not move any more"
            time.sleep(0.001)
        key = time.time()
        process.send_signal(signal.SIGTERM)
        process.wait()
    last = max(at for at, torque, _ in seen if torque)
    assert process.returncode == 143, process.returncode
    return min(at for at, _, _ in seen if at > last) - key


def _stops() -> list[str]:
    here, there = [], []
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        keys = keys_in(folder / "keys", "pc-a")
        arguments = [*WIRES["Modbus TCP"], "--clock", "wall"]
        with served(*arguments) as link:
            axis = f'link = "{link}"\ntravel = 3.14\ncycle = 0.004\n'
            local = folder / "local.toml"
            local.write_text(f'job = "identify"\nconfirm = "yes"\n[[axes]]\nname = "x"\n{axis}')
            with At(folder, "pc-a", keys, {"x": axis}).running() as at:
                path = fleet_file(folder / "far.toml", {"pc-a": at}, keys)
                for _ in range(_STOPS):
                    here.append(_stopped(local, folder / "home-local", link))
                    there.append(_stopped(path, folder / "home-far", link))
    rows = [
        f"| {what} | {1000 * statistics.median(times):.0f} ms | {1000 * max(times):.0f} ms |"
        for what, times in (("on this computer", here), ("through a gateway", there))
    ]
    more = 1000 * (statistics.median(there) - statistics.median(here))
    return [
        f"SIGTERM to the runner while an axis moves, until the drive gives no torque any more, {_STOPS} times each, in",
        "turn; a served drive in real time, as another master sees it.",
        "",
        "| stop | p50 | worst |",
        "| --- | --- | --- |",
        *rows,
        f"| more | {more:.0f} ms | {1000 * (max(there) - max(here)):.0f} ms |",
    ]


if __name__ == "__main__":
    _look_on(sys.argv[1])
