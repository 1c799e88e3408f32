"""Random axes and settings in simulated time: what may never be exceeded is not. `make limits`."""

from __future__ import annotations

import math
import multiprocessing
import random
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from commissioning.desk import Desk, Options
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.rig.armed import Failure
from commissioning.session.identify import identify
from drivers.link import axis_of
from drivers.virtual.firmware import Firmware
from tests.faults.two_key import TWO_KEY, in_process

__all__ = ["Outcome", "one"]

_DRIVE_SPEED = 1.2  # of the speed limit: what the drive itself holds
_LIMITER = 1.25e-3  # s that the drive's own limiter takes: supervision and one period of its loop
_LET_REST = 3_000_000_000  # ns after the job
_ALLOWED = {0, 2, 3, 5, 6}
_EVERY = 4  # of these axes one has a drive with two keys


@dataclass
class Outcome:
    """What one axis did, against its limits.

    Attributes
    ----------
    code : exit code
    travel, speed, torque : largest, in shares of the limit
    energised : after the end
    gained : speed that the axis gains before the drive's own limiter acts, likewise
    """

    link: str
    code: int
    travel: float
    speed: float
    torque: float
    energised: bool
    gained: float

    @property
    def beyond_drive(self) -> bool:
        """Whether it was faster than the drive holds, for as long as the drive takes to hold it."""
        return self.speed > _DRIVE_SPEED + 0.02  # between two looks of the drive

    @property
    def held(self) -> bool:
        """Whether nothing was exceeded, and nothing left on."""
        return (
            self.code in _ALLOWED
            and self.travel <= 1.0
            and (not self.beyond_drive or self.speed <= _DRIVE_SPEED + 0.02 + self.gained)
            and self.torque <= 1.0 + 1e-6
            and not self.energised
        )


def _drawn(seed: int) -> tuple[str, Options, Callable[[float], float]]:
    """An axis of any kind, and limits that need not suit it."""
    draw = random.Random(seed)

    def log(low: float, high: float) -> float:
        return math.exp(draw.uniform(math.log(low), math.log(high)))

    coulomb = log(0.005, 0.6)
    inertia, viscous = log(2e-5, 5e-2), log(1e-5, 2e-2)
    breakaway = coulomb * draw.choice((1.0, 1.0, 1.3, 2.0))
    options = {
        "inertia": inertia, "viscous": viscous, "coulomb": coulomb, "breakaway": breakaway,
        "delay": log(2e-4, 2e-2),
        "load": draw.choice((0.0, 0.0, draw.uniform(-0.9, 0.9) * coulomb)),
        "lag": draw.choice((0.0, log(2e-4, 5e-3))), "seed": seed,
        "jitter": draw.choice((0.0, 0.0, 0.05)), "loss": draw.choice((0.0, 0.0, 0.02)),
    }  # fmt: skip
    link = "virtual://bench?" + "&".join(
        f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in options.items()
    )
    chosen = Options(
        travel=log(0.02, 50.0),
        max_torque=min(log(0.3, 20.0) * coulomb, 2.9),
        max_speed=log(1.0, 300.0),
        cycle=draw.choice((0.001, 0.002, 0.005, 0.01)),
        method=draw.choice(("modulating", "lock-in", "two-relay")),
    )
    slow = _LIMITER + float(options["lag"])  # the torque loop is not faster than its lag
    return link, chosen, lambda torque: (max(torque, breakaway) - coulomb) / inertia * slow


class _Watched:
    """The true state of the plant, after every step of the firmware."""

    def __init__(self) -> None:
        self.firmware: Firmware | None = None
        self.start = 0.0
        self.position = self.speed = self.torque = 0.0
        self._advance = Firmware.advance

    def __enter__(self) -> _Watched:
        watched, advance = self, self._advance

        def look(firmware: Firmware, duration: int) -> None:
            if watched.firmware is not firmware:
                watched.firmware, watched.start = firmware, firmware.plant.position
            advance(firmware, duration)
            plant = firmware.plant
            watched.position = max(watched.position, abs(plant.position - watched.start))
            watched.speed = max(watched.speed, abs(plant.velocity))
            if firmware.energised and firmware.values["mode"] in (4, 10):
                command = abs(firmware.values["torque_target"]) * 1e-3 * firmware.axis.rated
                watched.torque = max(watched.torque, command)

        Firmware.advance = look  # type: ignore[method-assign, assignment]
        return self

    def __exit__(self, *exc: object) -> None:
        Firmware.advance = self._advance  # type: ignore[method-assign]


def one(seed: int, home: Path) -> Outcome:
    """One job on the axis that `seed` draws."""
    link, options, gain = _drawn(seed)
    code = 0
    with in_process(), _Watched() as watched, Journal(home) as journal:
        desk = Desk(journal, Interruption(), lambda text: None, lambda question, word: True)
        try:
            axis = axis_of(f"{link}&state={home / 'drive.json'}")
            if seed % _EVERY == 0:
                axis = axis.model_copy(update={"profile": TWO_KEY})
            identify(axis, options, desk)
        except Failure as failure:
            code = failure.error.exit_code
        firmware = watched.firmware
        energised = False
        if firmware is not None:
            firmware.advance(_LET_REST)
            energised = firmware.energised
    assert options.travel is not None
    assert options.max_speed is not None
    assert options.max_torque is not None
    return Outcome(
        link, code, watched.position / options.travel, watched.speed / options.max_speed,
        (watched.torque - 1e-3) / options.max_torque, energised,
        gain(watched.torque) / options.max_speed,
    )  # fmt: skip


def _some(seeds: list[int]) -> list[Any]:
    with tempfile.TemporaryDirectory() as home:
        return [(seed, one(seed, Path(home))) for seed in seeds]


def main() -> int:
    """Run N axes (default 10 000); the last line is `limits: N axes, M held`."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    chunks = [list(range(begin, min(begin + 50, count))) for begin in range(0, count, 50)]
    out, held, done, gained = sys.stdout, 0, 0, 0
    codes: dict[int, int] = {}
    worst = {"travel": 0.0, "speed": 0.0, "torque": 0.0}
    with multiprocessing.get_context("spawn").Pool() as pool:
        for found in pool.imap_unordered(_some, chunks):
            for seed, outcome in found:
                done += 1
                held += outcome.held
                gained += outcome.beyond_drive
                codes[outcome.code] = codes.get(outcome.code, 0) + 1
                worst = {n: max(value, getattr(outcome, n)) for n, value in worst.items()}
                if not outcome.held:
                    out.write(f"  seed {seed}: {outcome}\n")
            out.write(f"{done} of {count}\n")
            out.flush()
    shares = ", ".join(f"{name} {100 * value:.1f} %" for name, value in worst.items())
    out.write(
        f"faster than the drive holds, until its limiter ({_LIMITER * 1000:g} ms and lag) acts: "
        f"{gained}\n"
    )
    out.write(f"exit codes {dict(sorted(codes.items()))}; most of a limit: {shares}\n")
    out.write(f"limits: {done} axes, {held} held\n")
    return 0 if held == done else 1


if __name__ == "__main__":
    sys.exit(main())
