"""--junit of single acts."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from commissioning.cli import output
from commissioning.cli.terminal import check_json
from profiles.errors import TwoRelayError

if TYPE_CHECKING:
    from commissioning.result.document import RunResult

__all__ = ["junit_option"]


def junit_option(act: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """--junit F of a command: what became of it, however it ends."""

    def decorated(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def wrapped(*args: Any, junit: str | None, **kwargs: Any) -> Any:
            if junit is None:
                return function(*args, **kwargs)
            check_json(junit, "--junit")
            began = time.monotonic()
            error: BaseException | None = None
            try:
                return function(*args, **kwargs)
            except BaseException as caught:
                error = caught
                raise
            finally:
                named = kwargs.get("target") or kwargs.get("run") or act
                _write(junit, act, str(named), error, time.monotonic() - began)

        option = click.option("--junit", metavar="F", help="Outcome as JUnit XML to F, for CI.")
        return option(wrapped)

    return decorated


def _write(target: str, act: str, named: str, error: BaseException | None, seconds: float) -> None:
    from commissioning.result.junit import Case, case_of_exit, junit_text, numbers_of_run
    from commissioning.result.words import act_ended

    meta = click.get_current_context().meta
    result: RunResult | None = meta.get(output.RESULT)
    group: str | None = meta.get(output.GROUP)
    case = Case(
        f"{result.axis if result else named}: {act}",
        f"tworelay.{group}" if group else "tworelay",
        case_of_exit(_exit_code(error)),
        seconds,
        getattr(error, "code", type(error).__name__ if error else ""),
        str(error or ""),
        tuple(numbers_of_run(result)) if result else (),
        (act_ended(result),) if result and result.ending else (),
    )
    try:
        Path(target).write_text(junit_text("tworelay", [case]), "utf-8")
    except OSError as problem:
        output.say(f"tworelay: --junit {target}: cannot be written: {problem.strerror}", err=True)


def _exit_code(error: BaseException | None) -> int:
    if error is None:
        return 0
    if isinstance(error, TwoRelayError):
        return error.exit_code
    return 130 if isinstance(error, KeyboardInterrupt | click.exceptions.Abort) else 1
