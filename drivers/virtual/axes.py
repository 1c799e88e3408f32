"""The virtual axes: published machines and a bench, with every figure an option.

Each axis names its source in `AXES`; [M] marks a figure that was given from memory there and is not
verified. `bench` and `vertical` are made up. `thesis-motor` is section 4.10 of Blaha's thesis with
k_DT read as 8e-3 and a Coulomb friction of ours; its output filter is the option
`output_filter=20`.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

from drivers.virtual.compliant_plant import CompliantParameters, CompliantPlant
from drivers.virtual.electronics import Electronics, Imperfections
from drivers.virtual.friction import Dry, Elements, Friction, LuGre, Soft
from drivers.virtual.plant import Plant, PlantParameters
from profiles.errors import UnknownName, UsageError

__all__ = ["AXES", "VirtualAxis", "configured"]

_TURN = 6.283185307179586  # rad


def _later(default: float) -> float:
    """A figure that drives of older versions did not have: with it they stay the same drives."""
    return field(default=default, repr=False, metadata={"later": True})


@dataclass(frozen=True, slots=True)
class VirtualAxis:
    """One virtual drive with its axis.

    Rotary axes are in rad, N.m, kg.m2; for a linear one read m, N, kg: its drive counts a
    revolution as 2 pi m.

    Parameters
    ----------
    inertia, viscous, coulomb, breakaway, load, asymmetry, lag : see PlantParameters
    stribeck : speed within which friction falls from breakaway to Coulomb, rad/s or m/s; 0: at once
    soft, soft_shift : width and shift of a friction that rises smoothly through zero speed, rad/s
        or m/s
    stribeck_exponent : of the Stribeck curve, 2 by its paper
    lugre, lugre_damping : stiffness (N.m/rad or N/m) and damping of the bristles; 0: none
    dahl : deflection z₀ within which Dahl's bristles reach the friction, rad or m; 0: none
    maxwell : deflection within which the last of six elements slips, rad or m; 0: none
    gms : rate at which elements that slip come to their share, N.m/s or N/s (needs maxwell)
    load_friction, cogging, pitch, resonance, ratio, damping, backlash, load_coulomb, output_filter
        : see CompliantParameters
    drag, drift, position_slope, position_wave, position_pitch, spring, gravity, gravity_angle,
    cogging_2, pitch_2, angle_2, torque_gain, torque_ripple, ripple_waves : see CompliantParameters
    torque_clip, torque_noise, tick, noise, eccentricity : see Imperfections
    torque_seen : 1: the drive measures the torque on the shaft; 0: it tells what it demands; -1: it
        measures no torque and always tells 0
    jitter : share of the cycles that are late, by an exponential time of mean one cycle
    loss : share of the cycles without a sample
    stamp : rms error of the time stamps, s
    temperature : of the motor, °C, as the drive tells it
    delay : s, from a torque command to its torque
    encoder : counts per turn, or per metre
    cycle : s, of the link, where the link has no other
    rated, peak : torque or force of the motor, N.m or N
    speed : rad/s or m/s, as delivered limit of the drive
    travel : room on either side, rad or m
    watchdog : s, as delivered
    brake : holding brake fitted
    memory : file of its own that keeps what it stores; '': the one of its name and options
    """

    name: str
    title: str
    motion: Literal["rotary", "linear"]
    inertia: float
    viscous: float
    coulomb: float
    rated: float
    peak: float
    speed: float
    travel: float
    breakaway: float | None = None
    load: float = 0.0
    asymmetry: float = 0.0
    lag: float = 0.0
    delay: float = 0.002
    encoder: float = 131072.0
    cycle: float = 0.001
    watchdog: float = 0.05
    brake: bool = False
    seed: int = 0
    stribeck: float = 0.0
    soft: float = 0.0
    soft_shift: float = 0.0
    stribeck_exponent: float = _later(2.0)
    lugre: float = 0.0
    lugre_damping: float = 0.0
    load_friction: float = 0.0
    cogging: float = 0.0
    pitch: float = _TURN / 12
    resonance: float = 0.0
    ratio: float = 1.0
    damping: float = 0.02
    backlash: float = 0.0
    load_coulomb: float = 0.0
    output_filter: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    stamp: float = 0.0
    dahl: float = _later(0.0)
    maxwell: float = _later(0.0)
    gms: float = _later(0.0)
    drag: float = _later(0.0)
    drift: float = _later(0.0)
    position_slope: float = _later(0.0)
    position_wave: float = _later(0.0)
    position_pitch: float = _later(_TURN)
    spring: float = _later(0.0)
    gravity: float = _later(0.0)
    gravity_angle: float = _later(0.0)
    cogging_2: float = _later(0.0)
    pitch_2: float = _later(_TURN / 36)
    angle_2: float = _later(0.0)
    torque_gain: float = _later(1.0)
    torque_ripple: float = _later(0.0)
    ripple_waves: float = _later(6.0)
    torque_clip: float = _later(0.0)
    torque_noise: float = _later(0.0)
    torque_seen: float = _later(0.0)
    tick: float = _later(0.0)
    noise: float = _later(0.0)
    eccentricity: float = _later(0.0)
    temperature: float = field(default=25.0, repr=False)  # no other drive for it
    memory: str = field(default="", repr=False)

    @property
    def is_rigid(self) -> bool:
        """Whether one rigid mass with Coulomb friction is all there is: solved in closed form."""
        return not (
            self.stribeck or self.soft or self.lugre or self.dahl or self.maxwell
            or self.load_friction or self.cogging or self.cogging_2 or self.resonance
            or self.backlash or self.load_coulomb or self.output_filter or self.drag or self.drift
            or self.position_slope or self.position_wave or self.spring or self.gravity
            or self.torque_gain != 1 or self.torque_ripple
        )  # fmt: skip

    @property
    def held_by(self) -> float:
        """Torque that the axis withstands at rest, N.m or N."""
        return self.coulomb if self.breakaway is None else self.breakaway

    def build(self) -> Plant | CompliantPlant | Electronics:
        """The mechanics of this axis, at rest at 0; raises ValueError."""
        mechanics, electronics = self._mechanics(), self.imperfections
        return mechanics if electronics.is_none else Electronics(mechanics, electronics)

    @property
    def imperfections(self) -> Imperfections:
        """Of the drive's electronics."""
        return Imperfections(
            self.torque_clip, self.torque_noise, self.tick, self.noise, self.eccentricity,
            shows_shaft=self.torque_seen > 0, seed=self.seed,
        )  # fmt: skip

    def _mechanics(self) -> Plant | CompliantPlant:
        if self.is_rigid:
            return Plant(
                PlantParameters(
                    self.inertia, self.viscous, self.coulomb, self.held_by, self.load,
                    self.asymmetry, self.lag,
                )
            )  # fmt: skip
        return CompliantPlant(
            CompliantParameters(
                self.inertia, self.viscous, self._friction(), self.load, self.asymmetry,
                self.load_friction, self.lag, self.cogging, self.pitch, self.resonance, self.ratio,
                self.damping, self.backlash, self.load_coulomb, self.output_filter, self.cogging_2,
                self.pitch_2, self.angle_2, self.drag, self.drift, self.position_slope,
                self.position_wave, self.position_pitch, self.spring, self.gravity,
                self.gravity_angle, self.torque_gain, self.torque_ripple, self.ripple_waves,
            )
        )  # fmt: skip

    def _friction(self) -> Friction:
        exponent = self.stribeck_exponent
        if self.lugre:
            return LuGre(
                self.coulomb, self.held_by, self.stribeck or 1.0, self.lugre, self.lugre_damping,
                exponent,
            )  # fmt: skip
        if self.dahl:
            return LuGre(self.coulomb, self.coulomb, 0.0, self.coulomb / self.dahl, 0.0)
        if self.maxwell:
            return Elements(
                self.coulomb, self.held_by, self.maxwell, self.gms, self.stribeck, exponent
            )
        if self.soft:
            return Soft(self.coulomb, self.soft, self.soft_shift)
        return Dry(self.coulomb, self.held_by, self.stribeck, exponent)

    @property
    def resolution(self) -> float:
        """Position of one encoder count, rad or m."""
        return (_TURN if self.motion == "rotary" else 1.0) / self.encoder

    @property
    def serial(self) -> int:
        """Serial number: an axis with the same options and the same memory is the same drive."""
        told = [
            f"{one.name}={value!r}"
            for one in fields(self)
            if one.metadata and (value := getattr(self, one.name)) != one.default
        ]
        return zlib.crc32((repr(self) + "".join(told) + self.memory).encode())


AXES: dict[str, VirtualAxis] = {
    axis.name: axis
    for axis in (
        VirtualAxis(
            name="bench", title="Bench axis: servo motor with a flywheel", motion="rotary",
            inertia=1e-3, viscous=2e-3, coulomb=0.1,
            rated=1.0, peak=3.0, speed=300.0, travel=3.141592653589793,
        ),
        VirtualAxis(
            name="thesis-motor", title="DC motor of the thesis, 1 V as 1 N.m and as 1 rad",
            motion="rotary", inertia=7.035e-3, viscous=0.2513, coulomb=0.3,
            rated=3.0, peak=10.0, speed=40.0, travel=10.0,
        ),
        VirtualAxis(
            name="vertical", title="Vertical axis with a holding brake", motion="rotary",
            inertia=1e-4, viscous=2e-4, coulomb=0.08, load=0.15,
            rated=1.3, peak=3.9, speed=300.0, travel=12.566370614359172, brake=True,
        ),
        # Janot, Gautier, Brunot 2019, nonlinearbenchmark.org
        VirtualAxis(
            name="emps", title="EMPS ball-screw slide", motion="linear",
            inertia=95.1089, viscous=203.5034, coulomb=20.3935, load=-3.1648,
            rated=117.2, peak=351.5, speed=1.0, travel=0.12, encoder=2e7,
        ),
        # Mablekos-Alexiou et al., IEEE T-RO 37(4) 2021, fits of its data
        VirtualAxis(
            name="epos-screw", title="Small servo with a lead screw: Stribeck friction",
            motion="rotary", inertia=2.204e-6, viscous=3.4e-5, coulomb=2.59e-3, breakaway=3.11e-3,
            stribeck=3.54, load=0.36e-3, rated=9.84e-3, peak=29.5e-3, speed=800.0, travel=60.0,
            encoder=4096,
        ),
        VirtualAxis(
            name="epos-antibacklash", title="Small servo with a preloaded screw: much friction",
            motion="rotary", inertia=2.25e-6, viscous=2.14e-5, coulomb=4.76e-3, load=0.12e-3,
            rated=9.84e-3, peak=29.5e-3, speed=800.0, travel=60.0, encoder=4096,
        ),
        VirtualAxis(
            name="epos-worm", title="Small servo with a worm gear 60:1: Stribeck friction",
            motion="rotary", inertia=6.5e-7, viscous=1.25e-5, coulomb=1.37e-3, breakaway=1.61e-3,
            stribeck=0.31, load=0.46e-3, rated=9.84e-3, peak=29.5e-3, speed=1500.0, travel=100.0,
            encoder=4096,
        ),
        # malik-robert/HSM150-data
        VirtualAxis(
            name="hsm150", title="Servo motor whose friction differs by direction", motion="rotary",
            inertia=1.2e-4, viscous=1e-4, coulomb=0.0195, asymmetry=0.02,
            rated=0.39, peak=1.17, speed=400.0, travel=12.566370614359172, encoder=10000,
        ),
        # shamilmamedov/dynamic_calibration; limit 330 N.m [M]
        VirtualAxis(
            name="ur10e", title="Joint 1 of a robot arm: harmonic drive, much viscous friction",
            motion="rotary", inertia=8.17, viscous=31.97, coulomb=20.83,
            rated=165.0, peak=330.0, speed=6.0, travel=2.0,
        ),
        # Gaz et al., RA-L 2019: phi1 0.546, phi2 5.1, phi3 0.0395; inertia 0.2 [M]
        VirtualAxis(
            name="franka", title="Joint 1 of a robot arm: soft friction", motion="rotary",
            inertia=0.2, viscous=0.0, coulomb=0.273, soft=2 / 5.1, soft_shift=0.0395,
            rated=12.0, peak=87.0, speed=20.0, travel=2.5,
        ),
        # Rhoban/bam, model M1; 4096 counts [M]
        VirtualAxis(
            name="mx106", title="Hobby servo with a high gear ratio", motion="rotary",
            inertia=0.0266, viscous=0.0352, coulomb=0.1035,
            rated=2.0, peak=8.0, speed=30.0, travel=3.0, encoder=4096,
        ),
        # Rhoban/bam; 19 bit [M]. Its Stribeck speed has no amplitude in our source: left out
        VirtualAxis(
            name="erob", title="Robot joint whose friction grows with the torque", motion="rotary",
            inertia=0.959, viscous=8.392, coulomb=5.611, load_friction=0.166,
            rated=40.0, peak=120.0, speed=20.0, travel=3.0, encoder=524288,
        ),
        # robotics-toolbox-matlab; Corke and Armstrong-Helouvry 1994: +0.395/-0.435 N.m; link 1.14
        # kg.m2 [M]
        VirtualAxis(
            name="puma", title="Joint 1 of a robot arm at its motor: friction differs by direction",
            motion="rotary", inertia=4.9e-4, viscous=1.48e-3, coulomb=0.415, asymmetry=-0.0482,
            rated=2.0, peak=6.0, speed=400.0, travel=25.0, encoder=1000,
        ),
        # geez0x1/CompliantJointToolbox: k 6000 N.m/rad between 0.3594 and 0.1120 kg.m2
        VirtualAxis(
            name="tree", title="Series elastic joint: resonance at 42 Hz", motion="rotary",
            inertia=0.4714, viscous=3.44, coulomb=3.3, load_coulomb=3.7, resonance=42.19,
            ratio=0.1120 / 0.3594, rated=40.0, peak=120.0, speed=15.0, travel=3.0,
        ),
        # enactic/openarm: 0.572*tanh(193.8 v); inertia 0.05 [M]
        VirtualAxis(
            name="openarm", title="Robot arm joint: nearly hard friction", motion="rotary",
            inertia=0.05, viscous=0.522, coulomb=0.572, soft=1 / 193.8, load=0.012,
            rated=5.0, peak=20.0, speed=20.0, travel=3.0,
        ),
    )
}  # fmt: skip

# what the drive's registers can hold, and what its firmware can step
_RANGES = {
    "encoder": (16, 2**30), "cycle": (1e-5, 1.0), "rated": (1e-3, 4000.0),
    "speed": (1e-3, 1e4), "delay": (0, 1.0), "watchdog": (0, 60.0), "lag": (0, 10.0),
    "stribeck": (0, 1e4), "soft": (0, 1e4), "lugre": (0, 1e9), "lugre_damping": (0, 1e6),
    "load_friction": (0, 0.9), "pitch": (1e-6, 1e4), "resonance": (0, 2000.0), "ratio": (1e-3, 1e3),
    "damping": (0, 1.0), "backlash": (0, 1e3), "load_coulomb": (0, 1e6), "output_filter": (0, 1e4),
    "jitter": (0, 1.0), "loss": (0, 0.3), "stamp": (0, 0.1), "cogging": (-1e6, 1e6),
    "temperature": (-100.0, 300.0), "stribeck_exponent": (0.1, 5.0), "dahl": (0, 1e3),
    "maxwell": (0, 1e3), "gms": (0, 1e9), "drag": (0, 1e9), "drift": (-0.1, 0.1),
    "position_slope": (-1e3, 1e3), "position_wave": (-0.99, 0.99), "position_pitch": (1e-6, 1e4),
    "spring": (-1e9, 1e9), "gravity": (-1e6, 1e6), "gravity_angle": (-10, 10),
    "cogging_2": (-1e6, 1e6), "pitch_2": (1e-6, 1e4), "angle_2": (-10, 10),
    "torque_gain": (0.01, 100.0), "torque_ripple": (-0.9, 0.9), "ripple_waves": (0, 1e6),
    "torque_clip": (0, 1e6), "torque_noise": (0, 1e6), "torque_seen": (-1, 1), "tick": (0, 1.0),
    "noise": (0, 10.0), "eccentricity": (-1.0, 1.0), "load": (-1e6, 1e6),
    "inertia": (1e-9, 1e9), "viscous": (0, 1e9), "coulomb": (0, 1e9), "asymmetry": (-0.99, 0.99),
}  # fmt: skip

_OPTIONS = {
    field.name: field
    for field in fields(VirtualAxis)
    if field.name not in {"name", "title", "motion", "brake", "seed"}
}


def configured(name: str, options: dict[str, str], memory: str | Path | None = None) -> VirtualAxis:
    """The axis `name` with `options` (text, as in a LINK) put in; raises UsageError, UnknownName.

    `memory` : file of its own, which makes it a drive of its own
    """
    if name not in AXES:
        raise UnknownName("virtual axis", name, list(AXES))
    changes: dict[str, float | int] = {}
    for key, text in options.items():
        if key == "seed":
            changes[key] = _number(key, text, int)
        elif key in _OPTIONS:
            changes[key] = _number(key, text, float)
        else:
            raise UnknownName(
                "option of a virtual axis", key, [*_OPTIONS, "seed", "state", "habit"]
            )
    own = "" if memory is None else str(Path(memory).absolute())
    axis = replace(AXES[name], **changes, memory=own)  # type: ignore[arg-type]
    for key in ("encoder", "cycle", "rated", "peak", "speed", "travel"):
        if not getattr(axis, key) > 0:
            raise UsageError(f"virtual axis '{name}': {key} is {getattr(axis, key):g}: must be > 0")
    for key, (low, high) in _RANGES.items():
        if not low <= getattr(axis, key) <= high:
            raise UsageError(
                f"virtual axis '{name}': {key} is {getattr(axis, key):g}: must be {low:g}…{high:g}"
            )
    try:
        axis.build()
    except ValueError as error:
        raise UsageError(f"virtual axis '{name}': {error}") from None
    if axis.held_by < axis.coulomb and not axis.stribeck:
        raise UsageError(
            f"virtual axis '{name}': breakaway is {axis.held_by:g}: must be at least coulomb, "
            f"{axis.coulomb:g}"
        )
    _check_friction(axis)
    if axis.backlash and not axis.resonance:
        raise UsageError(
            f"virtual axis '{name}': backlash lies between motor and load: give resonance too"
        )
    if not axis.rated <= axis.peak <= 30 * axis.rated:
        raise UsageError(
            f"virtual axis '{name}': peak is {axis.peak:g}: must be {axis.rated:g}…"
            f"{30 * axis.rated:g} (1 to 30 times rated)"
        )
    return axis


def _check_friction(axis: VirtualAxis) -> None:
    """Kinds that exclude each other; raises UsageError."""
    named = f"virtual axis '{axis.name}': "
    kinds = [kind for kind in ("soft", "lugre", "dahl", "maxwell") if getattr(axis, kind)]
    if len(kinds) > 1:
        raise UsageError(f"{named}{' and '.join(kinds)} exclude each other")
    if axis.stribeck and (axis.soft or axis.dahl):
        raise UsageError(f"{named}stribeck and {kinds[0]} exclude each other")
    if (axis.lugre or axis.dahl or axis.maxwell) and not axis.coulomb > 0:
        raise UsageError(f"{named}{kinds[0]} friction needs coulomb > 0")
    if axis.gms and not axis.maxwell:
        raise UsageError(f"{named}gms needs maxwell, the deflection of its elements")


def _number(key: str, text: str, kind: type[int] | type[float]) -> float | int:
    try:
        value = kind(text)
    except ValueError:
        raise UsageError(f"option {key}={text!r}: must be a number") from None
    if not abs(value) < 1e300:
        raise UsageError(f"option {key}={text!r}: must be finite")
    return value
