"""--junit of single acts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import wraps
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from commissioning.cli import output
from commissioning.cli.acting import check_json
from profiles.errors import TwoRelayError, UsageError

if TYPE_CHECKING:
    from commissioning.result.document import RunResult
    from commissioning.result.junit import Case
    from profiles.axis import Axis

__all__ = ["junit_option", "not_begun"]


def junit_option(act: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """--junit F of a command: what became of it, however it ends."""

    def decorated(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def wrapped(*args: Any, junit: str | None, **kwargs: Any) -> Any:
            if junit is None:
                return function(*args, **kwargs)
            if junit == "-":
                raise UsageError("--junit -: give a file; --json - is for standard output")
            check_json(junit, "--junit")
            began = time.monotonic()
            error: BaseException | None = None
            try:
                return function(*args, **kwargs)
            except BaseException as caught:
                error = caught
                raise
            finally:
                if error is not None:
                    error.__dict__["in_junit"] = True
                named = kwargs.get("target") or kwargs.get("run") or act
                _write(junit, act, str(named), error, time.monotonic() - began)

        option = click.option("--junit", metavar="F", help="Outcome as JUnit XML to F, for CI.")
        return option(wrapped)

    return decorated


def _write(target: str, act: str, named: str, error: BaseException | None, seconds: float) -> None:
    from commissioning.result.junit import Case, case_of_exit, numbers_of_run

    meta = click.get_current_context().meta
    result: RunResult | None = meta.get(output.RESULT)
    axis: Axis | None = meta.get(output.AXIS)
    group = axis.group if axis else None
    name = result.axis if result else axis.name if axis else named
    outcome = case_of_exit(_exit_code(error))
    dry = outcome == "passed" and result is not None and result.quality.has("dry-run")
    case = Case(
        f"{name}: {act}",
        f"tworelay.{group}" if group else "tworelay",
        "skipped" if dry else outcome,
        seconds,
        getattr(error, "code", type(error).__name__ if error else ""),
        "dry run" if dry else str(error or ""),
        tuple(numbers_of_run(result)) if result else (),
        _lines(result) if result else (),
    )
    _put(target, case)


def _lines(result: RunResult) -> list[str]:
    """What else there is to read of a result."""
    from commissioning.result.words import VERDICTS, act_ended

    ending = act_ended(result) if result.ending else result.status
    lines = [ending, f"verdict {VERDICTS[result.quality.verdict]}"]
    lines += [f"run {result.run}"] if result.run else []
    lines += [f"serial {result.identity.serial}"] if result.identity else []
    written = ", ".join(f"{one.parameter} {one.raw}" for one in result.written)
    return [*lines, *([f"in the drive: {written}"] if written else [])]


def not_begun(arguments: Sequence[str], message: str, code: str, exit_code: int) -> None:
    """What ended before the act, where --junit is to be: no old file stays."""
    from commissioning.result.junit import Case, case_of_exit

    files = [value for word, value in pairwise(arguments) if word == "--junit"]
    files += [word.partition("=")[2] for word in arguments if word.startswith("--junit=")]
    if not files or files[-1] in ("", "-"):
        return
    words = [word for word in arguments if not word.startswith("-")]
    act = words[0] if words else "tworelay"
    named = next((word for word in words[1:] if word not in (files[-1], "run", "rehearse")), act)
    outcome = case_of_exit(exit_code)
    _put(files[-1], Case(f"{named}: {act}", "tworelay", outcome, kind=code, message=message))


def _put(target: str, case: Case) -> None:
    from commissioning.result.junit import junit_text

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
