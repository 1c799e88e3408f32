"""Random axes of every class that friction is met in (method.md 10), as links anybody can repeat."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log, pi, sqrt

from drivers.virtual.axes import VirtualAxis, configured

__all__ = ["CLASSES", "RIGID", "Case", "case"]

Options = dict[str, float]

# what the product's own experiments do on a rigid axis, by which the classes' shares are taken:
# torques 1.7 and 3.06 times the friction
_PERIOD, _CYCLES, _DEAD_TIMES = 0.1, 24, 12
_SWING_1, _SWING_2, _PEAK = 0.035, 0.0854, 0.683  # of f/J·T² twice, and of f/J·T
_PUSH = 3.5  # torque of the worst push, of the friction
_ROOM = 2.5  # of what the worst stop takes


@dataclass(frozen=True)
class Case:
    """One axis of a class, and how it is measured.

    Attributes
    ----------
    link : the virtual axis
    cycle, watchdog : s
    travel : rad, on either side
    """

    kind: str
    number: int
    link: str
    cycle: float
    travel: float
    watchdog: float

    @property
    def axis(self) -> VirtualAxis:
        """The axis itself."""
        name, _, query = self.link.removeprefix("virtual://").partition("?")
        return configured(name, dict(part.split("=") for part in query.split("&")))


@dataclass
class Drawn:
    """A base axis while its class changes it."""

    draw: random.Random
    options: Options
    cycle: float
    name: str = "bench"

    def log(self, low: float, high: float) -> float:
        return exp(self.draw.uniform(log(low), log(high)))

    def flat(self, low: float, high: float) -> float:
        return self.draw.uniform(low, high)

    def sign(self) -> float:
        return self.draw.choice((-1.0, 1.0))

    @property
    def f(self) -> float:
        return self.options["coulomb"]

    @property
    def ratio(self) -> float:
        """f/J, rad/s2."""
        return self.f / self.options["inertia"]

    @property
    def period(self) -> float:
        """About the one that the experiments choose, s."""
        dead = self.options["delay"] + self.options["lag"] + self.options.get("tick", 0.0)
        return max(_PERIOD, _CYCLES * self.cycle, _DEAD_TIMES * dead)

    @property
    def swing(self) -> float:
        """A: half-swing of the smaller oscillation, rad."""
        return _SWING_1 * self.ratio * self.period**2

    @property
    def peak(self) -> float:
        """v_p: peak speed of the larger one, rad/s."""
        return _PEAK * self.ratio * self.period

    def counts(self, number: float) -> None:
        """Encoder of so many counts a half-swing."""
        self.options["encoder"] = min(max(2 * pi / self.swing * number, 16.0), 2.0**30)

    @property
    def count(self) -> float:
        """Position of one count, rad."""
        return 2 * pi / self.options["encoder"]


def _base(draw: random.Random) -> Drawn:
    drawn = Drawn(draw, {}, 0.0)
    drawn.cycle = drawn.log(1e-3, 20e-3)
    ratio, inertia = drawn.log(30, 1000), drawn.log(1e-5, 0.01)
    drawn.options = {
        "inertia": inertia, "coulomb": ratio * inertia, "delay": drawn.flat(0.3, 3) * drawn.cycle,
        "lag": drawn.flat(0, 1e-3), "viscous": 0.0,
    }  # fmt: skip
    drawn.counts(drawn.log(300, 30_000))
    drawn.options["viscous"] = drawn.flat(0, 0.8) * drawn.f / drawn.peak
    drawn.options["rated"] = drawn.f / drawn.flat(0.05, 0.25)
    return drawn


def _again(d: Drawn) -> None:
    """What was chosen by the period, chosen anew."""
    share = d.flat(0, 0.8)
    d.counts(d.log(300, 30_000))
    d.options["viscous"] = share * d.f / d.peak


# -- the classes ------------------------------------------------------------------------------------


def rigid(d: Drawn) -> None:
    d.options |= {
        "load": d.flat(-0.5, 0.5) * d.f, "asymmetry": d.flat(-0.15, 0.15),
        "breakaway": d.flat(1, 1.3) * d.f,
    }  # fmt: skip


def direction(d: Drawn) -> None:
    d.options["asymmetry"] = d.sign() * d.flat(0.1, 0.4)


def deadtime(d: Drawn) -> None:
    d.options["delay"] = d.log(1e-3, 40e-3)
    _again(d)


def lag(d: Drawn) -> None:
    d.options["lag"] = d.log(0.3e-3, 3e-3)
    _again(d)


def cycle(d: Drawn) -> None:
    d.cycle = d.log(1e-3, 50e-3)
    d.options["delay"] = d.flat(0.3, 3) * d.cycle
    _again(d)


def encoder(d: Drawn) -> None:
    d.options["encoder"] = round(d.log(400, 1e6))


def coarse_torque(d: Drawn) -> None:
    d.options["rated"] = d.f / d.log(0.004, 0.04)


def no_torque(d: Drawn) -> None:
    d.options["torque_seen"] = -1


def noise(d: Drawn) -> None:
    d.options["noise"] = d.log(0.5, 20) * d.count


def eccentric(d: Drawn) -> None:
    d.options["eccentricity"] = d.log(1e-4, 0.02)


def late(d: Drawn) -> None:
    d.options |= {"jitter": d.flat(0.02, 0.3), "loss": d.flat(0, 0.1)}


def stamps(d: Drawn) -> None:
    d.options["stamp"] = d.log(0.05, 0.5) * d.cycle


def fine_stamps(d: Drawn) -> None:
    d.options["stamp"] = d.log(0.005, 0.2) * d.cycle


def async_(d: Drawn) -> None:
    d.options["tick"] = d.log(0.25e-3, 4e-3)


def torque_noise(d: Drawn) -> None:
    d.options["torque_noise"] = d.log(0.01, 0.2) * d.options["rated"]


def gain(d: Drawn) -> None:
    d.options |= {
        "torque_gain": d.flat(0.8, 1.25), "torque_ripple": d.flat(0, 0.08),
        "ripple_waves": d.draw.choice((4, 6, 12, 24, 36)),
    }  # fmt: skip


def gain_seen(d: Drawn) -> None:
    gain(d)
    d.options["torque_seen"] = 1


def saturation(d: Drawn) -> None:
    d.options["torque_clip"] = d.flat(1.5, 3.3) * d.f


def stribeck(d: Drawn) -> None:
    d.options |= {
        "breakaway": d.f * (1 + d.flat(0.15, 0.8)), "stribeck": d.log(0.005, 0.8) * d.peak,
        "stribeck_exponent": d.draw.choice((0.5, 1.0, 2.0)),
    }  # fmt: skip


def drag(d: Drawn) -> None:
    d.options["drag"] = d.flat(0.1, 1) * d.f / d.peak**2


def load(d: Drawn) -> None:
    d.options["load_friction"] = d.flat(0.02, 0.25)


def drift(d: Drawn) -> None:
    d.options["drift"] = d.sign() * d.log(0.001, 0.012)


def position(d: Drawn) -> None:
    if d.draw.random() < 0.5:
        d.options["position_slope"] = d.sign() * d.flat(0.05, 0.6) / d.swing
    else:
        d.options |= {
            "position_wave": d.flat(0.05, 0.4), "position_pitch": d.log(0.5, 6) * d.swing,
        }  # fmt: skip


def spring(d: Drawn) -> None:
    d.options["spring"] = d.sign() * d.flat(0.05, 0.5) * d.f / d.swing


def gravity(d: Drawn) -> None:
    d.options |= {"gravity": d.flat(0.1, 0.7) * d.f, "gravity_angle": d.flat(-pi, pi)}
    if d.draw.random() < 0.3:
        d.name = "vertical"
        d.options |= {"gravity": d.flat(0.7, 2) * d.f, "load": 0.0}


def cogging(d: Drawn) -> None:
    first = d.swing / d.log(0.3, 8)
    d.options |= {
        "cogging": d.flat(0.02, 0.3) * d.f, "pitch": first, "cogging_2": d.flat(0, 0.15) * d.f,
        "pitch_2": first / d.draw.choice((2, 3, 0.5, 6)), "angle_2": d.flat(-pi, pi),
    }  # fmt: skip


def dahl(d: Drawn) -> None:
    d.options["dahl"] = d.log(1e-3, 0.15) * d.swing


def presliding(d: Drawn) -> None:
    reach = d.log(1e-4, 5e-3) * d.swing
    if d.draw.random() < 0.5:
        d.options["dahl"] = reach
    else:
        _bristles(d, reach)


def lugre(d: Drawn) -> None:
    _bristles(d, d.log(5e-4, 0.06) * d.swing)


def _bristles(d: Drawn, reach: float) -> None:
    stiffness = d.f / reach
    damping = 2 * d.flat(0.2, 1) * sqrt(stiffness * d.options["inertia"])
    d.options |= {
        "lugre": stiffness, "lugre_damping": damping, "breakaway": d.f * (1 + d.flat(0, 0.6)),
        "stribeck": d.log(0.005, 0.8) * d.peak,
    }  # fmt: skip


def maxwell(d: Drawn) -> None:
    d.options["maxwell"] = d.log(1e-3, 0.25) * d.swing


def gms(d: Drawn) -> None:
    maxwell(d)
    d.options |= {
        "gms": d.f / (d.log(0.002, 0.05) * d.period), "breakaway": d.f * (1 + d.flat(0, 0.5)),
        "stribeck": d.log(0.02, 0.8) * d.peak,
    }  # fmt: skip


def twomass(d: Drawn) -> None:
    _two(d, d.log(5, 100), d.log(0.01, 0.08))


def belt(d: Drawn) -> None:
    _two(d, d.log(8, 40), d.log(0.02, 0.25))


def stiff(d: Drawn) -> None:
    _two(d, min(d.log(4, 25) / d.period, 400.0), d.log(0.01, 0.08))


def backlash(d: Drawn) -> None:
    _two(d, d.log(5, 100), d.log(0.01, 0.08))
    d.options["backlash"] = d.log(0.005, 0.5) * 2 * d.swing


def _two(d: Drawn, resonance: float, damping: float) -> None:
    share, f = d.flat(0, 0.6), d.f
    d.options |= {
        "resonance": resonance, "damping": damping, "ratio": d.log(0.2, 4),
        "load_coulomb": share * f, "coulomb": (1 - share) * f,
    }  # fmt: skip


def mixed(d: Drawn) -> None:
    d.options |= {
        "breakaway": d.f * (1 + d.flat(0.05, 0.3)), "stribeck": d.log(0.01, 0.3) * d.peak,
        "stribeck_exponent": d.draw.choice((0.5, 1.0, 2.0)), "asymmetry": d.flat(-0.1, 0.1),
        "load": d.flat(-0.2, 0.2) * d.f, "cogging": d.flat(0, 0.08) * d.f,
        "pitch": d.swing / d.log(0.5, 4), "torque_ripple": d.flat(0, 0.02), "ripple_waves": 6,
        "jitter": d.flat(0, 0.1), "loss": d.flat(0, 0.02), "noise": d.flat(0, 1) * d.count,
    }  # fmt: skip


RIGID: dict[str, Callable[[Drawn], None]] = {
    "rigid": rigid, "direction": direction, "deadtime": deadtime, "lag": lag, "cycle": cycle,
    "encoder": encoder, "coarse torque": coarse_torque, "no torque": no_torque, "noise": noise,
    "eccentric": eccentric, "late": late,
}  # fmt: skip
CLASSES: dict[str, Callable[[Drawn], None]] = RIGID | {
    "stamps": stamps, "fine stamps": fine_stamps, "async": async_, "torque noise": torque_noise,
    "gain": gain, "gain seen": gain_seen, "saturation": saturation, "stribeck": stribeck,
    "drag": drag, "load": load, "drift": drift, "position": position, "spring": spring,
    "gravity": gravity, "cogging": cogging, "dahl": dahl, "presliding": presliding, "lugre": lugre,
    "maxwell": maxwell, "gms": gms, "twomass": twomass, "belt": belt, "stiff": stiff,
    "backlash": backlash, "mixed": mixed,
}  # fmt: skip


def case(kind: str, seed: int, number: int) -> Case:
    """Axis `number` of a class: the same for the same seed, whatever else is drawn."""
    drawn = _base(random.Random(f"{seed}/{kind}/{number}"))
    CLASSES[kind](drawn)
    options = drawn.options
    slack = 12 if options.get("jitter") else 5  # cycles
    watchdog = max(0.02, slack * drawn.cycle)
    silent = watchdog + options["delay"] + 3 * drawn.cycle
    push = _PUSH * drawn.ratio
    fast = drawn.peak + push * silent
    swing = _SWING_2 * drawn.ratio * drawn.period**2
    stop = drawn.peak * silent + push * silent**2 / 2 + fast**2 / (2 * push)
    travel = _ROOM * (swing + stop)
    options |= {
        "cycle": drawn.cycle, "peak": 3 * options["rated"], "speed": min(8 * fast, 1e4),
        "travel": travel, "watchdog": watchdog, "seed": number + 1000 * (seed % 1000),
    }  # fmt: skip
    query = "&".join(f"{key}={value!r}" for key, value in options.items())
    return Case(kind, number, f"virtual://{drawn.name}?{query}", drawn.cycle, travel, watchdog)
