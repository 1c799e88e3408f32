"""tworelay fleet gateway."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen
from profiles.errors import UsageError

__all__ = ["command"]


@click.command("gateway", cls=Helpful)
@click.option("--listen", default="127.0.0.1:8786", show_default=True, metavar="HOST:PORT",
              help="Where clients come in; loopback, unless said otherwise.")  # fmt: skip
@click.option("--axes", required=True, metavar="DIR",
              type=click.Path(exists=True, file_okay=False, path_type=Path),
              help="Folder with the axis files of this computer.")  # fmt: skip
@click.option("--keys", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder with its certificate (default: 'keys' in the home).")  # fmt: skip
@click.option("--name", metavar="NAME",
              help="Which certificate, if there are several: gateway-NAME.crt.")  # fmt: skip
@verbose
def command(listen: str, axes: Path, keys: Path | None, name: str | None) -> None:
    """Serve the buses of this computer: a fleet run on another one can move the axes in DIR.

    It keeps its own ledger, locks and guardians: no axis is moved twice, whatever becomes of the
    network. Ctrl-C: what moves is finished, nothing more starts; once more stops it.
    """
    from commissioning.fleet.gateway.serving import run_gateway
    from commissioning.interruption import Interruption
    from drivers.home import home

    host, _, port = listen.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(f"--listen {listen}: must be HOST:PORT, as in 127.0.0.1:8786")
    screen = Screen(None, yes=True)
    with Interruption() as interruption:
        run_gateway(
            (host.strip("[]"), int(port)), axes, keys or home() / "keys", name, screen.say,
            interruption,
        )  # fmt: skip
