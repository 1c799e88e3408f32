"""tworelay demo: the whole job on a virtual drive in another process."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.job import Job
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen
from commissioning.interruption import Interruption
from commissioning.processes import start
from drivers.errors import LinkError

if TYPE_CHECKING:
    from commissioning.result.document import RunResult
    from drivers.virtual.axes import VirtualAxis

__all__ = ["command"]

AXIS = "bench"


@click.command("demo", cls=Helpful)
@click.option("--clock", type=click.Choice(["step", "wall"]), default="step", show_default=True,
              help="Simulated time as fast as it goes, or real time.")  # fmt: skip
@click.option("--fleet", is_flag=True, help="Eight axes on five buses, interrupted and resumed.")
@click.option("--gateways", is_flag=True,
              help="Twelve axes on three computers, one of which dies in mid-motion.")  # fmt: skip
@verbose
def command(clock: str, fleet: bool, gateways: bool) -> None:
    """Serve the virtual axis 'bench' over Modbus TCP and commission it as a technician would."""
    if fleet:
        from commissioning.cli.fleet.demo import run_demo

        sys.exit(run_demo(Screen(None, yes=True)))
    if gateways:
        from commissioning.cli.fleet import demo_gateways

        sys.exit(demo_gateways.run_demo(Screen(None, yes=True)))
    from commissioning.cli import show
    from commissioning.cli.apply import write
    from commissioning.cli.identify import command as identify
    from commissioning.cli.identify import measure
    from commissioning.cli.report import say_report
    from commissioning.cli.verify import prove
    from commissioning.session.verify import Wishes
    from drivers.virtual.axes import AXES

    screen = Screen(None, yes=True)
    serving = ("virtual", "serve", AXIS, "--modbus-tcp", "127.0.0.1:0", "--clock", clock)
    with (
        Interruption(),  # whatever ends the demo ends its drive, too
        tempfile.TemporaryDirectory() as folder,
        start(
            "commissioning", *serving, "--state", str(Path(folder) / "drive.json"),
            stdout=subprocess.PIPE, text=True,
        ) as server,
    ):  # fmt: skip
        try:
            link = server.stdout.readline().strip() if server.stdout else ""
            if not link:
                raise LinkError(
                    "the virtual drive of the demo did not start; its own line says why",
                    code="link.demo",
                )
            truth = AXES[AXIS]
            screen.say(f"virtual drive '{AXIS}' serves {link}")
            arguments = [link, "--travel", "±3.14", "--cycle", "0.004", "--yes"]
            screen.say()
            screen.say("$ tworelay identify " + " ".join(arguments))
            asked = identify.make_context("identify", arguments).params
            with screen.watching("identify") as watcher:
                result = measure(link, screen, Job.of(asked), watcher)
            show.summary(result, screen)
            _against_truth(result, truth, screen)
            screen.say()
            run = str(result.run)
            screen.say(f"$ tworelay apply {run} --yes")
            write(run, None, screen, None)
            screen.say()
            screen.say(f"$ tworelay verify {run} --yes")
            result = prove(run, None, screen, None, Wishes())
        finally:
            server.terminate()
    screen.say()
    say_report(run, screen)
    show.in_the_drive(result, screen)
    show.ending(result, screen)


def _against_truth(result: RunResult, truth: VirtualAxis, screen: Screen) -> None:
    coulomb, offset = result.friction.coulomb, result.friction.offset
    if coulomb is None or offset is None:
        return
    f, unit = coulomb.value, coulomb.unit
    rows = [
        ["Coulomb friction", f"{f:.4g} {unit}", f"{truth.coulomb:.4g} {unit}",
         f"{100 * (f / truth.coulomb - 1):+.1f} %"],
        ["offset", f"{offset.value:.4g} {unit}", f"{truth.load:.4g} {unit}",
         f"{offset.value - truth.load:+.2g} {unit}"],
    ]  # fmt: skip
    screen.table("found against true", ["", "found", "true", "error"], rows)
