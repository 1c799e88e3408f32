"""Measure one axis: from the link to a proposal. Nothing is changed for good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np

from commissioning.desk import Desk, Options
from commissioning.errors import MeasurementRejected
from commissioning.experiments.design import LONG
from commissioning.identification.breaks import of_jumps
from commissioning.identification.critical_point import (
    CriticalPoint,
    corrected,
    friction_of,
)
from commissioning.identification.errors import words_of
from commissioning.identification.followed import (
    dwell_share,
    is_unsigned,
    of_torque,
    torque_gain,
)
from commissioning.identification.reasons import Reason, Weight
from commissioning.identification.repeats import Repeats
from commissioning.result.document import RunResult
from commissioning.result.experiment import Bases, Experiment, FirstLookReading, Setup
from commissioning.rig.armed import in_a_run
from commissioning.rig.measured import Measured
from commissioning.rig.methods import methods_of, repeated
from commissioning.rig.results import (
    critical_points,
    cycles,
    experiment,
    found_of,
    judged,
    repeated_of,
)
from commissioning.rig.rig import Rig
from commissioning.runner import Recorder
from commissioning.session.proposal import with_proposal
from drivers.sample import Sample
from profiles.axis import Axis

__all__ = ["identify"]

_LEAST_PERIOD = 20  # dead times, for the methods of the thesis
_LEAST_CYCLES = 25, 15  # a period, for the methods of the thesis and for the others
_MUCH_DRIFT = 0.1  # of the friction, from the first repeat to the last
_MANY_LATE = 0.01  # of the cycles
_ELASTIC = {"fit.unexplained", "balance.harmonics"}
_LIMITED_SHARE, _MUCH_LIMITED = 0.002, 0.2  # of the cycles


def identify(axis: Axis, options: Options, desk: Desk) -> RunResult:
    """Run the experiments on `axis`; raises Failure."""

    def work(rig: Rig, result: RunResult) -> RunResult:
        repeats = rig.mover.within_settings(lambda: repeated(rig))
        try:
            found = _measured(result, repeats, rig)
        except ValueError as error:  # a limit cycle that no relay makes
            raise MeasurementRejected(
                f"the oscillations contradict themselves: {words_of(error)}",
                code="measurement.contradiction",
            ) from None
        return with_proposal(found, rig.drive, options.fraction)

    return in_a_run(axis, options, desk, work)


def _measured(result: RunResult, repeats: Sequence[Measured], rig: Rig) -> RunResult:
    """`result` with the numbers; raises Rejected where they cannot be trusted."""
    drive, recorder, last = rig.drive, rig.recorder, repeats[-1]
    right, complex_coulomb = _right_point(last)
    watched = experiment(recorder, drive.cycle, sum(one.periods for one in repeats), rig.allowed)
    together = repeated_of(repeats, recorder.samples[0].sent)
    drift = together.drift
    result = replace(
        result,
        friction=found_of(repeats, result.units, rig.as_the_drive_counts),
        methods=methods_of(last),
        critical_point=critical_points(last, right),
        experiment=replace(
            watched,
            cycles=cycles(last.shown, recorder.samples[0].sent),
            complex_coulomb=(complex_coulomb.real, complex_coulomb.imag),
            tests=last.tests,
            repeats=together.values,
            spread=together.spread if len(repeats) > 1 else None,
            drift=None if drift is None else (drift.value, drift.low, drift.high),
            setup=_setup(rig, last),
            analysed=tuple(
                (begin - recorder.samples[0].sent, end - recorder.samples[0].sent)
                for begin, end in last.spans
                or ((float(last.record.time[0]), float(last.record.time[-1])),)
            ),
        ),
    )
    reasons = [*_of_drift(together), *_of_repeats(repeats)]
    reasons += _reasons(last, recorder.samples, drive.cycle)
    return judged(result, [*_of_jitter(watched, reasons), *reasons])


def _setup(rig: Rig, measured: Measured) -> Setup:
    known, scaling = measured.ready.known, rig.drive.scaling
    return Setup(
        _turnaround(rig.recorder),
        rig.context.resolution,
        Bases(scaling.rated_torque, scaling.increments_per_revolution, scaling.torque_constant),
        FirstLookReading(
            known.breakaway, known.coulomb, known.offset, known.viscous, known.inertia,
            known.dead_time,
        ),
        rig.loop_lag,
    )  # fmt: skip


def _of_repeats(repeats: Sequence[Measured]) -> list[Reason]:
    """Reasons of the last repeat, and those of the others that it does not have."""
    reasons = list(repeats[-1].reasons)
    for number, one in enumerate(repeats[:-1], 1):
        known = {(reason.code, reason.weight) for reason in reasons}
        reasons += [
            replace(reason, text=f"repeat {number}: {reason.text}")
            for reason in one.reasons
            if (reason.code, reason.weight) not in known
        ]
    return reasons


def _of_drift(together: Repeats) -> list[Reason]:
    """Repeats that go one way."""
    drift, mean = together.drift, together.mean.value
    if drift is None or drift.low <= 0 <= drift.high or not mean:
        return []
    share, minute = 100 / abs(mean), 60.0
    moved = abs(drift.value) * (together.times[-1] - together.times[0]) / abs(mean)
    return [
        Reason(
            "repeats.drift",
            Weight.DOUBT if moved > _MUCH_DRIFT else Weight.NOTE,
            f"the friction drifts by {drift.value * share * minute:+.2g} % a minute "
            f"({drift.low * share * minute:+.2g} … {drift.high * share * minute:+.2g} %), "
            f"{100 * moved:.2g} % over the {len(together.values)} repeats: the number is their "
            "mean; does the axis warm up?",
        )
    ]


def _of_jitter(watched: Experiment, reasons: list[Reason]) -> list[Reason]:
    """Late or lost cycles, before what they may be taken for."""
    late, lost = watched.late_share, watched.lost_share
    elastic = any(reason.code in _ELASTIC for reason in reasons)
    if max(late, lost) <= _MANY_LATE or not elastic:
        return []
    return [
        Reason(
            "link.irregular",
            Weight.NOTE,
            f"{100 * late:.1f} % of the cycles came late and {100 * lost:.1f} % were lost, which "
            "alone can leave torque unexplained: try a longer --cycle than "
            f"{watched.cycle * 1000:g} ms ('tworelay latency' finds one), or a less busy computer, "
            "before the axis is taken for elastic",
        )
    ]


def _turnaround(recorder: Recorder) -> float:
    """Time from a sample to the command that answers it, s: what a loop over this link adds."""
    samples = recorder.samples
    waits = [after.sent - before.time for before, after in pairwise(samples)]
    return max(float(np.median(waits)), 0.0) if waits else 0.0


def _right_point(measured: Measured) -> tuple[CriticalPoint | None, complex]:
    """The plant at the relay's frequency, and the friction that puts its locus on it."""
    point = measured.corrected
    if point is None:
        balance = measured.thesis
        if balance is None:  # nothing explains the record
            return None, 0j
        return corrected(measured.relay, balance.complex_coulomb), balance.complex_coulomb
    return point, friction_of(measured.relay, point)


def _reasons(measured: Measured, samples: list[Sample], cycle: float) -> list[Reason]:
    """What the raw samples and the drive say about the measurement."""
    reasons = []
    relay, known = measured.relay, measured.ready.known
    for name, text in (
        ("viscous", "viscous friction"), ("inertia", "inertia"), ("dead_time", "dead time"),
    ):  # fmt: skip
        if getattr(measured.found, name, None) is not None and measured.estimate(name) is None:
            reasons.append(
                Reason(
                    "quantity.unknown",
                    Weight.NOTE,
                    f"{text} is not identifiable from this record: more travel or speed would show "
                    "it",
                )
            )
    thesis = measured.ready.pace is LONG
    if thesis and relay.period < _LEAST_PERIOD * known.dead_time:
        reasons.append(
            Reason(
                "period.short",
                Weight.DOUBT,
                f"the period of {relay.period * 1000:.3g} ms is short against the dead time of "
                f"{known.dead_time * 1000:.3g} ms; more travel would allow a longer one",
            )
        )
    cycles = relay.period / cycle
    if cycles < _LEAST_CYCLES[0 if thesis else 1]:
        reasons.append(
            Reason(
                "cycles.few",
                Weight.DOUBT,
                f"a period has only {cycles:.0f} cycles of {cycle * 1000:g} ms; more travel or a "
                "shorter --cycle would give more",
            )
        )
    limited = sum(s.status.limit for s in samples) / max(len(samples), 1)
    if limited > _LIMITED_SHARE:
        reasons.append(
            Reason(
                "torque.limited",
                Weight.CONTRADICTION if limited > _MUCH_LIMITED else Weight.DOUBT,
                f"the drive's own limiter acted in {100 * limited:.1f} % of the cycles, so that "
                "the axis did not get the torque that was commanded; raise the drive's limits or "
                "lower --max-torque",
            )
        )
    record, f = measured.record, measured.found.coulomb.value
    reasons += of_jumps(record, measured.ready.units.position)
    inertia = measured.estimate("inertia")
    begin, end = record.time[0], record.time[-1]
    cut = [s for s in samples if begin <= s.time <= end]
    torque, command = np.array([s.torque for s in cut]), np.array([s.command for s in cut])
    if is_unsigned(torque, command):
        reasons.append(
            Reason("torque.unsigned", Weight.NOTE, "the drive tells its torque without a sign")
        )
    reasons += of_torque(
        torque_gain(torque, command),
        dwell_share(record, inertia.value if inertia else known.inertia, f),
        # what counts hide is in the interval of positions that are explained
        inf if measured.positions is not None else relay.half_swing,
        record.resolution,
    )
    share = f / relay.relay_amplitude
    if not 0.2 <= share <= 0.8:
        reasons.append(
            Reason(
                "share.unsound",
                Weight.DOUBT,
                f"friction is {share:.2f} of the smaller amplitude (0.2–0.8 is sound)",
            )
        )
    return reasons
