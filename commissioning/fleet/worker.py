"""A process that looks at axes and moves them, one after the other, as its runner says.

Orders come on standard input, reports leave on standard output. It never moves an axis that the
ledger does not grant it, and keeps the end of a job there before it tells anybody: whether its
runner still lives changes nothing.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import traceback
from collections.abc import Generator
from typing import TextIO

from commissioning.desk import Desk
from commissioning.ending import error_of
from commissioning.errors import Interrupted
from commissioning.fleet.acts import Step, carry_out, look_at
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.messages import Order, Report
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.result.endings import Error
from commissioning.result.fleet import OF_EXIT_CODE, JobState, Outcome
from commissioning.result.fleet_codec import json_of, of_json
from drivers.home import home
from profiles.errors import TwoRelayError

__all__ = ["main"]

_PULSE = 0.25  # s
_LATE = 0.5  # of a cycle: from here on it came late


class _Mouth:
    """Says reports, as long as somebody hears them."""

    def __init__(self, stream: TextIO) -> None:
        self._stream: TextIO | None = stream
        self._lock = threading.Lock()

    def say(self, report: Report) -> None:
        """One report, one line."""
        with self._lock:
            if self._stream is None:
                return
            try:
                self._stream.write(json_of(report) + "\n")
                self._stream.flush()
            except (OSError, ValueError):  # the runner is gone: the ledger hears of the end
                self._stream = None


def main() -> int:
    """Serve orders until standard input ends."""
    mouth = _Mouth(_own_output())
    try:
        mouth.say(Report("ready"))
        for line in sys.stdin:
            _serve(of_json(line, Order), mouth)
    except KeyboardInterrupt:
        return 130
    return 0


def _own_output() -> TextIO:
    """Standard output for reports alone; what anything else prints goes to standard error."""
    own = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return own


def _serve(order: Order, mouth: _Mouth) -> None:
    with Interruption() as interruption:
        try:
            if order.act == "look":
                _look(order, interruption, mouth)
            else:
                _job(order, interruption, mouth)
        except Interrupted as error:
            mouth.say(Report("ended", state=JobState.STOPPED, error=error_of(error)))


def _desk(journal: Journal, interruption: Interruption, mouth: _Mouth) -> Desk:
    """A desk at which all is confirmed: the runner has asked, and the order says what for."""
    return Desk(
        journal,
        interruption,
        lambda text: mouth.say(Report("tell", text=text)),
        lambda _question, _word: True,
    )


def _look(order: Order, interruption: Interruption, mouth: _Mouth) -> None:
    try:
        with Journal(home()) as journal:
            looked = look_at(order, _desk(journal, interruption, mouth))
    except TwoRelayError as error:
        mouth.say(Report("looked", error=error_of(error), exit_code=error.exit_code))
    except Exception as error:
        mouth.say(Report("looked", error=_bug(error), exit_code=1))
    else:
        mouth.say(Report("looked", looked=looked))


def _job(order: Order, interruption: Interruption, mouth: _Mouth) -> None:
    """The job, if the ledger grants it: from there to its end nothing here loses track of it."""
    of_it = order.fleet_run, order.name, order.attempt
    with contextlib.ExitStack() as stack:
        try:
            ledger = stack.enter_context(Ledger(home()))
            desk = _desk(stack.enter_context(Journal(home())), interruption, mouth)
        except TwoRelayError as error:
            mouth.say(Report("void", text=str(error)))
            return
        granted, ended = False, None
        try:
            with interruption.deferred():
                granted = ledger.start(*of_it)
            if granted:
                with _pulse(desk, mouth):
                    ended = carry_out(order, desk, _stepper(mouth))
        except TwoRelayError as error:  # a signal beside the acts, or a ledger that failed
            if not granted:
                mouth.say(Report("void", text=str(error)))
                return
            ended = ended or (_state(error), Outcome(error=error_of(error)))
        except Exception as error:
            ended = JobState.UNKNOWN, Outcome(error=_bug(error))
        if ended is None:
            mouth.say(Report("void", text="not granted"))
            return
        state, outcome = ended
        with contextlib.suppress(Interrupted), interruption.deferred():
            why = outcome.error.text if outcome.error else outcome.remark
            try:
                ledger.end(*of_it, state, outcome, why)
            except TwoRelayError as error:
                mouth.say(Report("tell", text=str(error)))
            mouth.say(Report("ended", state=state, outcome=outcome, error=outcome.error))


def _state(error: TwoRelayError) -> JobState:
    return OF_EXIT_CODE.get(error.exit_code, JobState.UNKNOWN)


def _stepper(mouth: _Mouth) -> Step:
    def step(number: int, of: int, text: str) -> None:
        mouth.say(Report("step", text=text, step=number, steps=of))

    return step


def _bug(error: Exception) -> Error:
    """What is told of an error that nobody expected; its place is in the log."""
    traceback.print_exc(file=sys.stderr)
    return Error("internal", f"internal error ({type(error).__name__}: {error})")


@contextlib.contextmanager
def _pulse(desk: Desk, mouth: _Mouth) -> Generator[None]:
    """Tell now and then how the motion goes, from beside it."""
    over = threading.Event()
    beat = threading.Thread(target=_beat, args=(desk, mouth, over), daemon=True)
    beat.start()
    try:
        yield
    finally:
        over.set()
        beat.join()


def _beat(desk: Desk, mouth: _Mouth, over: threading.Event) -> None:
    seen = 0
    while not over.wait(_PULSE):
        recorder = desk.recorder
        samples = recorder.samples if recorder is not None else []
        count = len(samples)
        if count <= seen:
            seen = min(seen, count)
            mouth.say(Report("pulse"))
            continue
        new = samples[seen:count]
        seen = count
        step = (new[-1].time - new[0].sent) / len(new)
        late = sum(sample.lateness > _LATE * step for sample in new) / len(new)
        mouth.say(Report("pulse", moving=new[-1].status.enabled, late=late))


if __name__ == "__main__":
    sys.exit(main())
