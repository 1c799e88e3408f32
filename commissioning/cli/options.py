"""Options that every command has."""

from __future__ import annotations

import click

__all__ = ["verbose"]

# the entry point looks for it on the command line, whatever failed
verbose = click.option(
    "-v",
    "--verbose",
    is_flag=True,
    expose_value=False,
    help="With a traceback, if there is a bug.",
)
