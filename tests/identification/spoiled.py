"""A good record of relay tests on the virtual bench axis, and many ways to spoil it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from commissioning.identification.record import Record
from drivers.virtual.axes import configured

COULOMB = 0.1  # N.m, of the bench axis


def relay_tests(
    options: dict[str, str] | None = None,
    *,
    amplitudes: tuple[float, ...] = (0.18, 0.33),
    hysteresis: float = 0.03,
    cycle: float = 0.001,
    periods: int = 6,
) -> Record:
    """Relay tests from rest on `bench` with options, sampled at `cycle`,
    command delayed by 2 ms."""
    axis = configured("bench", options or {})
    plant, now, in_force = axis.build(), 0.0, 0.0
    pending: list[tuple[float, float]] = []
    rows = []
    for d in amplitudes:
        sign, switches = 1, 0
        while switches < 2 * periods:
            y = round(plant.position / axis.resolution) * axis.resolution
            if sign * y > hysteresis:
                sign, switches = -sign, switches + 1
            rows.append((now, y, sign * d))
            pending.append((now + axis.delay, sign * d))
            until = now + cycle
            while now < until - 1e-12:
                due = [u for t, u in pending if t <= now + 1e-12]
                if due:
                    in_force = due[-1]
                    pending = [(t, u) for t, u in pending if t > now + 1e-12]
                step = min([until, *[t for t, _ in pending]])
                plant.advance(step - now, in_force)
                now = step
    time, position, command = np.array(rows).T
    return Record.of(time, position, time, command, axis.resolution)


def changed(record: Record, **arrays: Any) -> Record:
    """The record with some of its columns replaced."""
    columns = {
        name: arrays.get(name, getattr(record, name))
        for name in ("time", "position", "sent", "command", "resolution")
    }
    return Record.of(**columns)


def _stamps(r: Record) -> Record:
    rng = np.random.default_rng(0)
    time = np.maximum.accumulate(r.time + rng.normal(0, 1e-3, len(r.time)))
    return changed(r, time=time + np.arange(len(time)) * 1e-9)


def _rounded(r: Record, counts: int) -> Record:
    step = counts * r.resolution
    return changed(r, position=np.round(r.position / step) * step, resolution=step)


def _late(r: Record, share: float) -> Any:
    return r.time > r.time[int(share * len(r.time))]


# name: (how the record is spoiled, verdict, words of a reason)
SPOILED: dict[str, tuple[Callable[[Record], Record], str, str]] = {
    "torque with the wrong sign": (
        lambda r: changed(r, command=-r.command), "rejected", "sign or unit wrong",
    ),
    "torque halved midway: the drive limits": (
        lambda r: changed(r, command=np.where(_late(r, 0.5), 0.5, 1.0) * r.command),
        "rejected", "unexplained",
    ),
    "torque of another axis": (
        lambda r: changed(r, command=np.random.default_rng(0).permutation(r.command)),
        "rejected", "no axis moves like this",
    ),
    "position of 40 counts of half-swing": (
        lambda r: _rounded(r, 40), "usable", "encoder counts",
    ),
    "position of 6 counts of half-swing": (
        lambda r: _rounded(r, 300), "rejected", "encoder counts",
    ),
    "somebody pushes: 0.03 N.m at 3.3 Hz": (
        lambda r: changed(r, command=r.command + 0.03 * np.sin(2 * np.pi * 3.3 * r.time)),
        "usable", "of the torque is unexplained",
    ),
    "a load of 0.03 N.m falls off midway": (
        lambda r: changed(r, command=r.command + 0.03 * _late(r, 0.5)),
        "usable", "of the torque is unexplained",
    ),
    "friction drifts by 20 %": (
        lambda r: changed(
            r,
            command=r.command
            + 0.02 * (r.time / r.time[-1] - 0.5) * np.sign(np.gradient(r.position, r.time)),
        ),
        "usable", "% a second while it was measured, 19",
    ),
    "time stamps wrong by 1 ms rms": (_stamps, "rejected", "of the torque unexplained"),
    "lost counts, twice": (
        lambda r: changed(
            r,
            position=r.position
            + r.resolution * (200.0 * _late(r, 0.5) - 90.0 * _late(r, 0.33)),
        ),
        "usable", "of the torque is unexplained",
    ),
    "noise of 100 counts": (
        lambda r: changed(
            r,
            position=r.position
            + np.random.default_rng(0).normal(0, 100 * r.resolution, len(r.time)),
        ),
        "rejected", "of the torque unexplained",
    ),
    "resonance at 25 Hz, half of the inertia behind it": (
        lambda r: relay_tests({"resonance": "25", "damping": "0.05"}),
        "rejected", "elastic",
    ),
    "play of 0.02 rad": (
        lambda r: relay_tests({"resonance": "60", "backlash": "0.02"}),
        "rejected", "has play",
    ),
    "soft friction over 3 rad/s": (
        lambda r: relay_tests({"soft": "3"}), "usable", "soft friction",
    ),
    "cogging of 30 % of f": (
        lambda r: relay_tests({"cogging": "0.03", "pitch": "0.05"}),
        "usable", "position-dependent torque of ±0.0",
    ),
}  # fmt: skip
