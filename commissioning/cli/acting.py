"""What acts on a drive share: the desk, and the result as JSON whatever becomes of them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli import output
from commissioning.cli.terminal import Screen
from commissioning.desk import Desk
from commissioning.errors import DoesNotHelp
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.watching import NOBODY, Watcher
from drivers.home import home
from profiles.errors import Refused, TwoRelayError, UsageError

if TYPE_CHECKING:
    from commissioning.result.document import RunResult

__all__ = ["act_on", "at_desk", "check_json", "on_this_computer", "write_json"]


@contextlib.contextmanager
def at_desk(
    screen: Screen,
    trace: Callable[..., None] | None = None,
    *,
    to_stop: bool = False,
    watcher: Watcher = NOBODY,
) -> Generator[Desk]:
    """Journal open, signals caught; `to_stop`: without the journal, whatever that is like."""
    with _journal(to_stop=to_stop) as journal, Interruption() as interruption:
        yield Desk(journal, interruption, screen.tell, screen.confirm, trace, watcher=watcher)


def _journal(*, to_stop: bool) -> Journal:
    return Journal.empty() if to_stop else Journal(home())


def on_this_computer(run: str, link: str | None) -> None:
    """Raises Refused where the drive of a run is on a gateway, and no `link` leads to it."""
    from commissioning.fleet.ledger import Ledger

    if link is not None:
        return
    with Ledger(home(), reading=True) as ledger:
        found = ledger.gateway_of(run)
    if found is not None:
        fleet_run, axis, gateway = found
        raise Refused(
            f"the drive of run {run} is on gateway '{gateway}'",
            code="run.on-gateway",
            hint=f"'tworelay fleet restore {fleet_run} --axis {axis}' puts its values back there; "
            f"for anything else go to {gateway}",
        )


@contextlib.contextmanager
def act_on(run: str, desk: Desk, screen: Screen, json_target: str | None) -> Generator[None]:
    """An act on `run` that ends early writes its JSON, too, and says what is true then."""
    from commissioning.cli import show
    from commissioning.ending import of_failed

    try:
        yield
    except TwoRelayError as error:
        if error.exit_code >= 3:
            with contextlib.suppress(TwoRelayError):  # the first error is the one to be told
                result = of_failed(desk, run, error)
                write_json(result, json_target)
                if isinstance(error, DoesNotHelp):
                    show.verification(result, screen)
                show.ending(result, screen)
        raise


def check_json(target: str | None, option: str = "--json") -> None:
    """See before anything is done that the result can be written; raises UsageError."""
    if target is None or target == "-":
        return
    path = Path(target)
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise UsageError(
            f"{option} {target}: cannot be written: no such folder, or a folder itself"
        )


def write_json(result: RunResult, target: str | None) -> None:
    """Result as JSON to a file or standard output.

    Where it cannot be written, the job is no less done.
    """
    click.get_current_context().meta[output.RESULT] = result
    if target is None:
        return
    from commissioning.result.codec import text_of

    text = text_of(result)
    if target == "-":
        output.document(text)
        return
    try:
        Path(target).write_text(text, "utf-8")
    except OSError as error:
        kept = f"; run {result.run} keeps the result" if result.run else ""
        output.say(
            f"tworelay: --json {target}: cannot be written: {error.strerror}{kept}", err=True
        )
