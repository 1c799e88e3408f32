"""tworelay fleet rehearse FLEET."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.fleet.run import Outputs, check_outputs, conduct, run_options
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen
from drivers.errors import LinkError

if TYPE_CHECKING:
    from commissioning.result.fleet import FleetJob

__all__ = ["command", "served"]


@click.command("rehearse", cls=Helpful)
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
    from commissioning.fleet.loading import load_fleet
    from commissioning.fleet.running import FleetWishes
    from commissioning.fleet.twins import on_twins, twins_of
    from drivers.home import home

    check_outputs(junit, json_target, csv_target)
    screen = Screen("-" if "-" in (junit, json_target, csv_target) else None, yes=True)
    plan = load_fleet(fleet, job)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        twins = twins_of(plan, folder)
        links = stack.enter_context(served(fleet, len(twins.names))) if twins.names else []
        os.environ["TWORELAY_HOME"] = str(home() / "rehearsal")
        wishes = FleetWishes(only, at_once, yes=True)
        outputs = Outputs(junit, json_target, csv_target)
        conduct(on_twins(plan, twins, links), wishes, screen, outputs)


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
