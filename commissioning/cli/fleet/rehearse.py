"""tworelay fleet rehearse FLEET."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.fleet.run import conducted, run_options, write_outputs
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen, check_json
from drivers.errors import LinkError

if TYPE_CHECKING:
    from commissioning.result.fleet import FleetJob

__all__ = ["command", "served"]

_NOTHING_STARTED = 3


@click.command("rehearse")
@click.argument("fleet", type=click.Path(path_type=Path))
@run_options
@verbose
def command(
    fleet: Path,
    job: FleetJob | None,
    only: str | None,
    at_once: int | None,
    junit: str | None,
    json_target: str | None,
    csv_target: str | None,
) -> None:
    """The run of FLEET against virtual twins of all its axes, in simulated time.

    Buses are shared as in the file, twins behave by its profiles; no drive is touched, and what
    comes of it lies apart, in the folder 'rehearsal' of the home.
    """
    from commissioning.fleet.plan import load_fleet
    from commissioning.fleet.running import FleetWishes
    from commissioning.fleet.twins import on_twins, twins_of
    from drivers.home import home

    for target in (junit, json_target, csv_target):
        check_json(target)
    screen = Screen(json_target, yes=True)
    plan = load_fleet(fleet, job)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        twins = twins_of(plan, folder)
        links = stack.enter_context(served(fleet, len(twins.names))) if twins.names else []
        on_loopback = on_twins(plan, twins, links)
        os.environ["TWORELAY_HOME"] = str(home() / "rehearsal")
        wanted = FleetWishes(only, at_once, yes=True)
        with conducted(on_loopback, wanted, screen) as result:
            write_outputs(result, junit, json_target, csv_target)
    if not any(axis.began for axis in result.axes):
        sys.exit(_NOTHING_STARTED)
    sys.exit(result.exit_code)


@contextlib.contextmanager
def served(fleet: Path, count: int) -> Generator[Sequence[str]]:
    """The links of `count` twins, which another process serves meanwhile."""
    from commissioning.processes import start

    with start(
        "commissioning", "virtual", "serve", str(fleet.resolve()), "--clock", "step",
        stdout=subprocess.PIPE, text=True,
    ) as server:  # fmt: skip
        try:
            assert server.stdout is not None
            links = [server.stdout.readline().strip() for _ in range(count)]
            if not all(links):
                raise LinkError(
                    "the twins of the fleet did not start; their own line says why",
                    code="link.demo",
                )
            yield links
        finally:
            server.terminate()
