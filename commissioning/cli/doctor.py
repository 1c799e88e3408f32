"""tworelay doctor [LINK]."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from drivers.doctor import Check

__all__ = ["command"]

_MARKS = {"ok": "ok      ", "note": "note    ", "warning": "warning ", "problem": "PROBLEM "}


@click.command("doctor", cls=Helpful)
@click.argument("link", required=False)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def command(link: str | None, as_json: bool) -> None:
    """Adapters, drivers, permissions, clock of this machine; with LINK, why it does not answer.

    Only reads. Ends with exit code 4 where a problem keeps the link from working.
    """
    from drivers.doctor import of_machine

    screen = Screen("-" if as_json else None, yes=True)
    findings = []
    with screen.working("looking"):
        for finding in chain(of_machine(), _of_link(link, screen) if link else ()):
            findings.append(finding)
            if not as_json:
                screen.say(_MARKS[finding.level] + finding.text)
    if as_json:
        document(json_text([{"level": f.level, "text": f.text} for f in findings]))
    if link and any(f.level == "problem" for f in findings):
        sys.exit(4)


def _of_link(link: str, screen: Screen) -> Iterator[Check]:
    """What is found on a link that nobody else uses; raises Refused."""
    from commissioning.ownership import owned
    from drivers.doctor import of_link

    with owned(link, "doctor"):
        yield from of_link(link, screen.say)
