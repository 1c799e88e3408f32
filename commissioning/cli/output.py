"""Where text leaves: the only place that writes to standard output and standard error.

What it writes acts on no terminal. A stream that takes no more – a full disk, a reader that went
away – ends no job: the rest of what it would have said is lost, which is told on the other stream
once.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Generator
from pathlib import Path
from textwrap import wrap
from typing import Any

import click

from profiles.plain import plain, plain_lines

RESULT, AXIS = "tworelay.result", "tworelay.axis"  # what a command has come to, in its context

_NARROWEST, _USUAL = 40, 80  # characters of a terminal: at least, and where it does not say
_DEEPEST = 16  # characters that a line is set back by, at most


__all__ = ["AXIS", "RESULT", "document", "giving_up", "json_text", "say", "written"]


def say(text: str = "", *, err: bool = False, style: str | None = None) -> None:
    """One line for people, folded between words on a terminal.

    `style` : a colour, on terminals that are to have any
    """
    shown = "\n".join(_folded(plain(text), sys.stderr if err else sys.stdout))
    plainly = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    is_coloured = style is not None and not plainly
    _write((click.style(shown, fg=style) if is_coloured else shown) + "\n", err=err)


def _folded(text: str, stream: Any) -> list[str]:
    """Lines of a terminal's width; of anything else as it is."""
    try:
        if len(text) <= _NARROWEST or not stream.isatty():
            return [text]
        width = max(os.get_terminal_size(stream.fileno()).columns or _USUAL, _NARROWEST)
    except (OSError, ValueError):
        return [text]
    indent = " " * min(len(text) - len(text.lstrip()) + 2, _DEEPEST)
    return wrap(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    ) or [text]


def document(text: str, *, err: bool = False) -> None:
    """A text of several lines, with their ends."""
    _write(plain_lines(text), err=err)


def json_text(tree: Any) -> str:
    """JSON for a file or a stream, in ASCII."""
    import json

    return json.dumps(tree, indent=1, allow_nan=False) + "\n"


def _write(text: str, *, err: bool) -> None:
    with giving_up(err=err):
        click.echo(text, err=err, nl=False)


def written(content: bytes, asked: str | None, usual: Path, run: str) -> Path:
    """Write a file to where it is `asked` for, else to its `usual` place; returns where.

    Where that cannot be written – somebody else's home, a read-only medium – it goes to the working
    directory, by the run's name. Raises UsageError.
    """
    from profiles.errors import UsageError
    from profiles.files import replace

    target = usual if asked is None else Path(asked)
    try:
        if asked is not None:
            target.write_bytes(content)
            return target
        try:
            replace(target, content)
        except OSError as error:
            if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
                raise
            target = Path(f"{run}-{usual.name}")
            replace(target, content)
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}") from None
    return target


@contextlib.contextmanager
def giving_up(*, err: bool) -> Generator[None]:
    """A stream that takes no more from the body is given up, not the job."""
    try:
        yield
    except (OSError, SystemExit) as error:  # rich ends a program whose reader has gone
        _abandon(sys.stderr if err else sys.stdout)
        if isinstance(error, OSError) and not isinstance(error, BrokenPipeError) and not err:
            with contextlib.suppress(OSError):
                click.echo(f"tworelay: standard output takes no more: {error.strerror}", err=True)


def _abandon(stream: Any) -> None:
    """What is still to come on a stream goes nowhere: its end is no error, either."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)
