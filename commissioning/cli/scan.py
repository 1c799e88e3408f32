"""tworelay scan LINK."""

from __future__ import annotations

from typing import Any

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text
from commissioning.cli.quantity import Measure
from commissioning.cli.terminal import Screen

__all__ = ["command"]


@click.command("scan", cls=Helpful)
@click.argument("link")
@click.option("--units", default="1-247", show_default=True, metavar="A-B", help="Modbus units.")
@click.option(
    "--timeout",
    type=Measure("time", low=0.01, high=5),
    metavar="T",
    help="'200ms', for one unit or node.",
)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def command(link: str, units: str, timeout: float | None, as_json: bool) -> None:
    """Which drives are on a bus, who they are, and which profile fits. Only reads.

    LINK is a link without node or unit: canopen://socketcan/can0, modbus-tcp://HOST,
    modbus-rtu:///dev/ttyUSB0?baudrate=57600.
    """
    from commissioning.ownership import owned
    from drivers.scan import scan

    screen = Screen("-" if as_json else None, yes=True)
    asked = _range(units)
    with owned(link, "scan"), screen.counting(f"scan of {link}", len(asked)) as tell:
        found = scan(link, asked, timeout, tell)
    if as_json:
        rows = [
            {
                "address": f.address, "link": f.link, "profiles": list(f.profiles), "note": f.note,
                "identity": None if f.identity is None else f.identity.model_dump(),
            }
            for f in found
        ]  # fmt: skip
        document(json_text(rows))
        return
    if not found:
        screen.say("nobody answers; 'tworelay doctor LINK' looks for the reason")
        return
    screen.table(
        f"{len(found)} found", ["address", "who", "profile", "note"], [_row(item) for item in found]
    )
    for item in found:
        screen.say(item.link)


def _row(item: Any) -> list[str]:
    return [
        str(item.address),
        "–" if item.identity is None else str(item.identity),
        ", ".join(item.profiles) or "none fits: --profile, or 'tworelay profile new'",
        item.note,
    ]


def _range(text: str) -> range:
    first, dash, last = text.partition("-")
    ends = (first, last if dash else first)
    if not all(end.isdigit() for end in ends) or not 0 <= int(ends[0]) <= int(ends[1]) <= 255:
        raise click.BadParameter(f"'{text}' must be A-B with 0 ≤ A ≤ B ≤ 255", param_hint="--units")
    return range(int(ends[0]), int(ends[1]) + 1)
