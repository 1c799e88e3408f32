"""The one loop that joins experiment, drive, envelope and recorder, and stops the axis."""

from __future__ import annotations

import gc
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeVar

from commissioning.envelope import Envelope
from commissioning.errors import FeedbackReversed, Interrupted
from commissioning.experiments.plan import Plan
from commissioning.guardian import NOBODY, Guardian
from commissioning.interruption import Interruption
from commissioning.ownership import stopped_by
from commissioning.watching import NOBODY as NO_WATCHER
from commissioning.watching import Watcher
from drivers.drive import Drive, StopReport
from drivers.errors import DriveFault
from drivers.realtime import real_time
from drivers.sample import Sample
from profiles.errors import TwoRelayError
from profiles.procedures import Mode

__all__ = ["Phase", "Recorder", "run", "verified"]

_STOP_IS_RECENT = 5.0  # s

T = TypeVar("T")


class Phase(NamedTuple):
    """What happens from a sample on.

    Attributes
    ----------
    at : index of that sample
    kind : a step of the job, or a detail within one
    text : one line for people
    """

    at: int
    kind: Literal["step", "detail"]
    text: str


@dataclass
class Recorder:
    """Every sample of a run, and where its phases begin.

    Attributes
    ----------
    samples : in the order of time
    phases : in the order of time
    watcher : told about each phase, and shown each sample
    """

    samples: list[Sample] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    watcher: Watcher = NO_WATCHER

    def phase(self, text: str) -> None:
        """From the next sample on, `text` happens."""
        self.phases.append(Phase(len(self.samples), "step", text))
        self.watcher.phase(text)

    def detail(self, text: str) -> None:
        """From the next sample on, `text` happens within a step."""
        self.phases.append(Phase(len(self.samples), "detail", text))
        self.watcher.phase(text)


def run(
    plan: Plan[T],
    drive: Drive,
    envelope: Envelope,
    recorder: Recorder,
    interruption: Interruption,
    *,
    mode: Mode = Mode.TORQUE,
    rest: float = 0.0,
    leave_moving: bool = False,
    guardian: Guardian = NOBODY,
) -> T:
    """Drive `plan` to its end; the axis is stopped and de-energised on every way out.

    Parameters
    ----------
    rest : set-point in force before the first and after the last command
    leave_moving : the plan ends in motion and the stop path ends it
    guardian : fed once a cycle

    Raises
    ------
    TwoRelayError
        Of the plan, the drive, the envelope or an interruption; its message says also how the stop
        went when that is not verified.
    """
    watch = envelope.watch(drive.read("position_actual").si)
    record, check = recorder.samples.append, watch.check
    admit = watch.admit if mode is Mode.TORQUE else watch.admit_position
    exchange, send, feed = drive.exchange, plan.send, guardian.feed
    samples, show = recorder.samples, recorder.watcher.cycle
    urgent = real_time() if drive.in_real_time else nullcontext()
    with interruption.deferred(), _collector_off(), urgent:
        try:
            interruption.check()
            drive.enable(mode, rest)
            set_point = next(plan)
            guardian.arm()
            try:
                while True:
                    admit(set_point)
                    sample = exchange(set_point)
                    feed()
                    record(sample)
                    if not sample.status.enabled:
                        raise _left_operation(drive)
                    check(sample)
                    show(samples, mode)
                    if interruption.signal is not None:
                        interruption.check()
                    set_point = send(sample)
            except StopIteration as end:
                result: T = end.value
            guardian.rest()
            if leave_moving:
                verified(drive.stop(interruption.hurried), None)
            else:
                drive.disable()
        except BaseException as error:
            guardian.rest()
            no_brake = isinstance(error, FeedbackReversed)
            report = drive.stop((lambda: True) if no_brake else interruption.hurried)
            plan.close()
            acted = guardian.acted()
            if acted and not isinstance(error, Interrupted):
                verified(report, fault := DriveFault(acted, "the guardian", code="guardian.acted"))
                raise fault from error
            verified(report, error)
            raise
    return result


def verified(report: StopReport, error: BaseException | None) -> None:
    """Raise, or say in `error`, that a stop could not be verified."""
    if report.deenergised:
        return
    if isinstance(error, TwoRelayError):
        error.also(report)
    elif error is None:
        raise DriveFault(str(report), code="stop.not-verified")


def _left_operation(drive: Drive) -> DriveFault:
    """Why the drive is no longer enabled."""
    if stopper := stopped_by(drive.link, _STOP_IS_RECENT):
        return DriveFault(
            f"the drive was stopped from outside, by {stopper}: the job ends here",
            f"another tworelay ({stopper})",
            code="stop.from-outside",
        )
    try:
        state = drive.state().text
        if not drive.state().in_fault:
            return DriveFault(
                f"the drive left operation and is in no fault (it says: {state}; a code may be "
                "older): was it disabled from outside: 'tworelay stop', another master, STO, an "
                "enable input or a limit switch?",
                "somebody outside of tworelay, or the drive",
                code="drive.left",
            )
    except TwoRelayError as error:
        return DriveFault(
            f"the drive left operation and cannot be asked why ({error})", code="drive.left"
        )
    return DriveFault(
        f"the drive stopped by itself: {state}",
        f"the drive ({state})",
        code="drive.stopped",
        hint="remove the cause, then try again",
    )


@contextmanager
def _collector_off():  # type: ignore[no-untyped-def]
    """No garbage collection pauses while the loop runs."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
