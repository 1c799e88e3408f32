"""Measure one axis: from the link to a proposal. Nothing is changed for good."""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np

from commissioning.compensation import Known, host_terms
from commissioning.identification.critical_point import (
    CriticalPoint,
    corrected,
    friction_of,
)
from commissioning.identification.estimate import Estimate
from commissioning.identification.verdict import (
    Reason,
    Weight,
    dwell_share,
    is_unsigned,
    of_torque,
    torque_gain,
)
from commissioning.runner import Recorder
from commissioning.session.armed import experiment_json, in_a_run
from commissioning.session.desk import Desk, Options
from commissioning.session.measurement import Measurement
from commissioning.session.methods import PACE_IS_LONG, Measured
from commissioning.session.proposal import own_estimate, proposal
from commissioning.session.result import (
    QUANTITIES,
    changes_json,
    critical_points,
    cycles_json,
    friction_json,
    judge,
    methods_json,
)
from drivers.drive import Drive
from profiles.axis import Axis
from profiles.errors import MeasurementRejected

__all__ = ["identify"]

_LEAST_PERIOD = 20  # dead times, for the methods of the thesis
_LEAST_CYCLES = 25, 15  # a period, for the methods of the thesis and for the others
_MANY_LATE = 0.01  # of the cycles
_LIMITED_SHARE, _MUCH_LIMITED = 0.002, 0.2  # of the cycles


def identify(axis: Axis, options: Options, desk: Desk) -> dict[str, Any]:
    """Run the experiments on `axis` and return the result JSON; raises Failure."""

    def work(job: Measurement, result: dict[str, Any]) -> None:
        measured = job.measure()
        try:
            _fill(result, measured, job, job.drive, options)
        except ValueError as error:  # a limit cycle that no relay makes
            raise MeasurementRejected(f"the oscillations contradict themselves: {error}") from None
        known = _known(measured)
        drive = job.drive
        reasons = result["quality"]["reasons"]
        result["compensation"] = changes_json(proposal(drive, known, options.fraction, reasons))
        reasons += filter(None, [own_estimate(drive, known.coulomb)])
        added = host_terms(drive.profile, drive.scaling, known, options.fraction)
        result["host_compensation"] = asdict(added) if added else None

    return in_a_run(axis, options, desk, work)


def _fill(
    result: dict[str, Any],
    measured: Measured,
    job: Measurement,
    drive: Drive,
    options: Options,
) -> None:
    """Put the numbers into the result; raises MeasurementRejected where they cannot be trusted."""
    axis, recorder, limits, known = job.axis, job.recorder, job.limits, job.known
    estimates = {name: measured.estimate(name) for name in QUANTITIES}
    spread = _spread(measured.repeats)
    coulomb = estimates["coulomb"]
    if spread is not None and coulomb is not None:
        low, high = min(coulomb.low, spread.low), max(coulomb.high, spread.high)
        estimates["coulomb"] = Estimate(spread.value, low, high)
    result["methods"] = methods_json(measured)
    result["friction"] = friction_json(
        measured.method, estimates, axis, drive.profile, drive.scaling
    )
    right, complex_coulomb = _right_point(measured)
    result["critical_point"] = critical_points(measured, right)
    experiment = experiment_json(recorder, drive.cycle, measured.periods)
    begin = recorder.samples[0].sent
    result["experiment"] = experiment | {
        "cycles": cycles_json(measured.shown),
        "complex_coulomb": [complex_coulomb.real, complex_coulomb.imag],
        "spans": [[t - begin for t in one.span] for one in measured.shown],
        "tests": measured.tests,
        "repeats": measured.repeats,
        "turnaround": _turnaround(recorder),
        "loop_lag": job.loop_lag,
        "resolution": job.context.resolution,
        "bases": {
            "rated_torque": drive.scaling.rated_torque,
            "increments_per_revolution": drive.scaling.increments_per_revolution,
            "torque_constant": drive.scaling.torque_constant,
        },
        "limits": {"travel": limits.travel, "torque": limits.torque, "speed": limits.speed},
        "first_look": {
            "breakaway": known.breakaway,
            "coulomb": known.coulomb,
            "offset": known.offset,
            "viscous": known.viscous,
            "inertia": known.inertia,
            "dead_time": known.dead_time,
        },
    }
    reasons = [*measured.reasons, *_reasons(measured, job, drive.cycle, options.method)]
    judge(result, [*_of_jitter(experiment, reasons), *reasons])


def _of_jitter(experiment: dict[str, Any], reasons: list[Reason]) -> list[Reason]:
    """Late or lost cycles, before what they may be taken for."""
    late, lost = experiment["late_share"], experiment["lost_share"]
    if max(late, lost) <= _MANY_LATE or not any("elastic" in reason.text for reason in reasons):
        return []
    return [
        Reason(
            Weight.NOTE,
            f"{100 * late:.1f} % of the cycles came late and {100 * lost:.1f} % were lost, which alone can "
            f"leave torque unexplained: try a longer --cycle than {experiment['cycle'] * 1000:g} ms "
            "('tworelay latency' finds one), or a less busy computer, before the axis is taken for elastic",
        )
    ]


def _turnaround(recorder: Recorder) -> float:
    """Time from a sample to the command that answers it, s: what a loop over this link adds."""
    samples = recorder.samples
    waits = [after.sent - before.time for before, after in pairwise(samples)]
    return max(float(np.median(waits)), 0.0) if waits else 0.0


def _spread(values: list[float]) -> Estimate | None:
    """Mean of repeated measurements and what they scatter by, None for a single one."""
    if len(values) < 2:
        return None
    import numpy as np
    from scipy.stats import t

    half = float(t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / len(values) ** 0.5)
    mean = float(np.mean(values))
    return Estimate(mean, mean - half, mean + half)


def _right_point(measured: Measured) -> tuple[CriticalPoint | None, complex]:
    """The plant at the relay's own frequency, and the friction that puts the relay's locus on it."""
    point = measured.corrected
    if point is None:
        balance = measured.two_relay or measured.two_relay_delay or measured.phase_locked
        if balance is None:  # nothing explains the record
            return None, 0j
        return corrected(measured.relay, balance.complex_coulomb), balance.complex_coulomb
    return point, friction_of(measured.relay, point)


def _reasons(measured: Measured, job: Measurement, cycle: float, method: str) -> list[Reason]:
    """What the raw samples and the drive say about the measurement."""
    reasons = []
    relay, samples = measured.relay, job.recorder.samples
    for name, text in (
        ("viscous", "viscous friction"), ("inertia", "inertia"), ("dead_time", "dead time"),
    ):  # fmt: skip
        if getattr(measured.found, name, None) is not None and measured.estimate(name) is None:
            reasons.append(
                Reason(
                    Weight.NOTE,
                    f"{text} is not identifiable from this record: more travel or speed would show it",
                )
            )
    thesis = method in PACE_IS_LONG
    if thesis and relay.period < _LEAST_PERIOD * job.known.dead_time:
        reasons.append(
            Reason(
                Weight.DOUBT,
                f"the period of {relay.period * 1000:.3g} ms is short against the dead time of "
                f"{job.known.dead_time * 1000:.3g} ms; more travel would allow a longer one",
            )
        )
    cycles = relay.period / cycle
    if cycles < _LEAST_CYCLES[0 if thesis else 1]:
        reasons.append(
            Reason(
                Weight.DOUBT,
                f"a period has only {cycles:.0f} cycles of {cycle * 1000:g} ms; more travel or a "
                "shorter --cycle would give more",
            )
        )
    limited = sum(s.status.limit for s in samples) / max(len(samples), 1)
    if limited > _LIMITED_SHARE:
        reasons.append(
            Reason(
                Weight.CONTRADICTION if limited > _MUCH_LIMITED else Weight.DOUBT,
                f"the drive's own limiter acted in {100 * limited:.1f} % of the cycles, so that the "
                "axis did not get the torque that was commanded; raise the drive's limits or lower "
                "--max-torque",
            )
        )
    record, f = measured.record, measured.found.coulomb.value
    inertia = measured.estimate("inertia")
    begin, end = record.time[0], record.time[-1]
    cut = [s for s in samples if begin <= s.time <= end]
    torque, command = np.array([s.torque for s in cut]), np.array([s.command for s in cut])
    if is_unsigned(torque, command):
        reasons.append(Reason(Weight.NOTE, "the drive tells its torque without a sign"))
    reasons += of_torque(
        torque_gain(torque, command),
        dwell_share(record, inertia.value if inertia else job.known.inertia, f),
        relay.half_swing,
        record.resolution,
    )
    share = f / relay.relay_amplitude
    if not 0.2 <= share <= 0.8:
        reasons.append(
            Reason(
                Weight.DOUBT,
                f"friction is {share:.2f} of the smaller amplitude (0.2–0.8 is sound)",
            )
        )
    return reasons


def _known(measured: Measured) -> Known:
    viscous = measured.estimate("viscous")
    return Known(
        measured.found.coulomb.value,
        measured.found.offset.value,
        viscous.value if viscous else None,
        viscous.half_width if viscous else 0.0,
    )
