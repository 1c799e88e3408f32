"""Tuning rules: a point of the plant or its parameters in, gains out. One pure function a rule.

A point is G(jω) of the loop's plant, torque to position, with the loop's own hold and dead time:
gain in rad/(N.m) or m/N, phase in degrees, ω in rad/s. No rule knows whether its loop will be any
good: that is for `margins`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, radians, sqrt, tan

__all__ = [
    "Cascade",
    "Pid",
    "astrom_hagglund",
    "cascade",
    "landau_voda_pi",
    "landau_voda_pid",
    "symmetrical_optimum",
    "tyreus_luyben_pi",
    "tyreus_luyben_pid",
    "ziegler_nichols_pi",
    "ziegler_nichols_pid",
]


@dataclass(frozen=True, slots=True)
class Pid:
    """PID of the position.

    U = K·(e + ∫e/Ti − Td·ẏ), the derivative of the position and not of the error.

    Attributes
    ----------
    gain : K, N.m/rad or N/m
    integral_time : Ti, s; infinite: no integral part
    derivative_time : Td, s
    """

    gain: float
    integral_time: float
    derivative_time: float = 0.0


@dataclass(frozen=True, slots=True)
class Cascade:
    """P of the position over PI of the velocity, as drives have it.

    U = Kv·(e + ∫e/Ti), e = Kp·(r − y) − ẏ.

    Attributes
    ----------
    velocity_gain : Kv, N.m.s/rad or N.s/m
    integral_time : Ti of the velocity loop, s
    position_gain : Kp, 1/s; 0: the velocity loop alone
    """

    velocity_gain: float
    integral_time: float
    position_gain: float = 0.0


def ziegler_nichols_pi(ku: float, tu: float) -> Pid:
    """PI 0.45·Ku, Tu/1.2 (Ziegler and Nichols 1942), from the point at −180°.

    Ku = 1/|G|, Tu = 2π/ω.

    Made for a quarter-decay of disturbances in processes; an axis, which is nearly two integrators,
    is usually unstable with it.
    """
    return Pid(0.45 * ku, tu / 1.2)


def ziegler_nichols_pid(ku: float, tu: float) -> Pid:
    """PID 0.6·Ku, Tu/2, Tu/8 (Ziegler and Nichols 1942), from the point at −180°. Hardly damped."""
    return Pid(0.6 * ku, tu / 2, tu / 8)


def tyreus_luyben_pi(ku: float, tu: float) -> Pid:
    """PI Ku/3.2, 2.2·Tu (Tyreus and Luyben 1992), from the point at −180°.

    For lags and an integrator.
    """
    return Pid(ku / 3.2, 2.2 * tu)


def tyreus_luyben_pid(ku: float, tu: float) -> Pid:
    """PID Ku/2.2, 2.2·Tu, Tu/6.3 (Luyben's version with derivative), from the point at −180°."""
    return Pid(ku / 2.2, 2.2 * tu, tu / 6.3)


def astrom_hagglund(
    gain: float, phase_deg: float, frequency: float, margin_deg: float = 45.0, ratio: float = 4.0
) -> Pid:
    """PID that turns any point to e^(j(−π + margin)) (Åström and Hägglund 1984), Ti = `ratio`·Td.

        K = cos(φb − φa)/ra,   ω·Td − 1/(ω·Ti) = tan(φb − φa),   G = ra·e^(j(−π + φa)),  φb = margin

    The loop's crossover lies at the point's own frequency, so the margin is met exactly there.
    Raises ValueError where the controller would have to lead by 75° or more, or to lag by more than
    60°.
    """
    lead = margin_deg - (phase_deg + 180)
    if not -60 < lead < 75:
        raise ValueError(
            f"the point at {phase_deg:.0f}° would have to be turned by {lead:.0f}°, more than a "
            "PID does"
        )
    slope = tan(radians(lead))
    derivative = (slope + sqrt(slope**2 + 4 / ratio)) / (2 * frequency)
    return Pid(cos(radians(lead)) / gain, ratio * derivative, derivative)


def landau_voda_pid(gain: float, frequency: float, beta: float = 1.0) -> Pid:
    """PID of Kessler, Landau and Voda (1992.

    Here after secondary sources), from the point at −135°.

    K = (4+β)/(8√2·g), Ti = (4+β)/(β·ω), Td = 4/((4+β)·ω), β in 1…2. For plants that go on falling
    after −135° as one lag does.
    """
    if not 1 <= beta <= 2:
        raise ValueError(f"beta is {beta:g}: must be 1…2")
    return Pid(
        (4 + beta) / (8 * sqrt(2) * gain), (4 + beta) / (beta * frequency),
        4 / ((4 + beta) * frequency)
    )  # fmt: skip


def landau_voda_pi(gain: float, frequency: float) -> Pid:
    """PI of Kessler, Landau and Voda from the point at −135°: K = 1/(2√2·g), Ti = 4/ω.

    Equals the symmetrical optimum for an integrator with one lag; 36.9° of margin there.
    """
    return Pid(1 / (2 * sqrt(2) * gain), 4 / frequency)


def symmetrical_optimum(inertia: float, delay: float) -> Cascade:
    """PI of the velocity by the symmetrical optimum (Kessler 1958): Kv = J/(2T), Ti = 4T.

    From the plant 1/(J·s) with the sum T of the loop's small delays, s. 36.9° with a lag T, 34.8°
    with a dead time T. The velocity loop alone.
    """
    return Cascade(inertia / (2 * delay), 4 * delay)


def cascade(
    inertia: float, viscous: float, delay: float, fastest: float = inf, ratio: float = 4.0
) -> Cascade:
    """Velocity PI and position P, damped.

    Kv = J/(a·T), Ti = min(a²·T, J/B), Kp = 1/(5·a·T), a = `ratio`.

    T is the sum of the loop's small delays, s, or more where the crossover 1/(a·T) is to stay below
    `fastest`, rad/s.

    The extended symmetrical optimum (Preitl and Precup 1999) with a = 4 in place of 2; where the
    axis' own time constant J/B is shorter than a²·T, the integral part cancels it (modulus
    optimum). The position gain is a fifth of the velocity loop's crossover. 50° and more at the
    plant's input.
    """
    delay = max(delay, 1 / (ratio * fastest))
    integral = ratio**2 * delay
    if viscous > 0:
        integral = min(integral, inertia / viscous)
    return Cascade(inertia / (ratio * delay), integral, 1 / (5 * ratio * delay))
