"""tworelay adopt DIR."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.acting import at_desk
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen

__all__ = ["command"]


@click.command("adopt", cls=Helpful)
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--profile", metavar="P", help="Profile of its drive as you know it; default: the built-in one."
)
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def command(folder: Path, profile: str | None, yes: bool) -> None:
    """Take in a run that was exported on another computer, to apply or restore it here.

    Shows link, axis, profile and what it wrote, and asks. Nothing is written to a drive. FOLDER may
    hold the folders of several runs, as of 'tworelay export --all'.
    """
    from commissioning.cli import show
    from commissioning.session.adopt import adopt, adopt_all, exported_in

    screen = Screen(None, yes=yes)
    several = exported_in(folder)
    if several:
        with at_desk(screen) as desk, screen.counting("taking in", len(several)) as told:
            found = adopt_all(several, profile, desk, told)
        screen.say(f"{found.taken_in} run(s) taken in, {found.known} were known")
        for line in found.refused:
            screen.say(line)
        if found.error is not None:
            raise found.error
        return
    with at_desk(screen) as desk:
        run = adopt(folder, profile, desk, lambda found: show.adopted(found, screen))
    screen.say(
        f"to write what it proposed: tworelay apply {run}; to take it back: tworelay restore {run}"
    )
    screen.say(f"run {run}")
