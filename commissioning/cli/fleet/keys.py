"""tworelay fleet keys [DIR]."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen
from profiles.errors import UsageError

__all__ = ["command"]


@click.command("keys", cls=Helpful)
@click.argument("folder", required=False, metavar="[DIR]", type=click.Path(path_type=Path))
@click.option("--gateway", "gateways", multiple=True, metavar="NAME",
              help="A certificate for a gateway, called as in the fleet file.")  # fmt: skip
@click.option("--client", "clients", multiple=True, metavar="NAME",
              help="A certificate for a computer that may command gateways.")  # fmt: skip
@click.option("--days", type=click.IntRange(1, 7300), default=3650, show_default=True,
              help="For which they are valid.")  # fmt: skip
@verbose
def command(
    folder: Path | None, gateways: tuple[str, ...], clients: tuple[str, ...], days: int
) -> None:
    """Make certificates in DIR (default: 'keys' in the home); the authority, where there is none.

    Whoever holds a client's key can move every axis of every gateway of this authority, and run
    programs there: docs/security.md.
    """
    from commissioning.fleet.file import gateway_name
    from commissioning.fleet.gateway.keys import make
    from drivers.home import home

    if not gateways and not clients:
        raise UsageError("name who gets a certificate: --gateway NAME, --client NAME")
    for name in (*gateways, *clients):
        try:
            gateway_name(name)
        except ValueError as error:
            raise UsageError(f"'{name}' {error}") from None
    screen = Screen(None, yes=True)
    folder = folder or home() / "keys"
    for role, name, files in make(folder, gateways, clients, days):
        screen.say(f"{role} '{name}': {files.ca.name}, {files.certificate.name}, {files.key.name}")
    screen.say(
        f"in {folder}; copy to each computer its three files, over a way that you trust. ca.key "
        "stays here: who has it can make more"
    )
