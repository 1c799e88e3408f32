"""tworelay latency LINK."""

from __future__ import annotations

import json
from typing import Any

import click

from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen, at_desk, axis_from

__all__ = ["command"]

_BARS, _WIDTH = 12, 40


@click.command("latency")
@click.argument("target", metavar="LINK")
@click.option("--profile", metavar="P", help="Drive profile: a built-in name or a file.")
@click.option("--count", type=click.IntRange(50, 100_000), default=500, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def command(target: str, profile: str | None, count: int, as_json: bool) -> None:
    """Round trip and cycle of a link, the fastest cycle that it holds, and what that means.

    The drive stays de-energised and every output at zero.
    """
    import numpy as np

    from commissioning.session.latency import latency

    screen = Screen("-" if as_json else None, yes=True)
    axis = axis_from(target, profile)
    with at_desk(screen) as desk, screen.working("measuring"):
        found = latency(axis, count, desk)
    rows = {
        "one read": found.service, "one exchange": found.exchange,
        f"lateness at {found.cycle * 1000:g} ms": found.lateness,
    }  # fmt: skip
    if as_json:
        tree: dict[str, Any] = {
            name: dict(zip(("median", "p99", "worst"), _three(values), strict=True))
            for name, values in zip(("service", "exchange", "lateness"), rows.values(), strict=True)
        }
        tree |= {
            "cycle": found.cycle, "late_share": found.late_share, "missed": found.missed,
            "shortest_period": found.shortest_period,
        }  # fmt: skip
        click.echo(json.dumps(tree, indent=1))
        return
    screen.table(
        "times in ms", ["", "median", "99 %", "worst"],
        [[name, *(f"{1000 * v:.3f}" for v in _three(values))] for name, values in rows.items()],
    )  # fmt: skip
    times = found.exchange * 1000
    shown = times[times <= 1.5 * np.quantile(times, 0.98)]
    heights, edges = np.histogram(shown, _BARS)
    screen.say("one exchange, ms:")
    for height, edge in zip(heights, edges, strict=False):
        bar = "█" * round(_WIDTH * height / heights.max())
        screen.say(f"  {edge:7.3f} {height:6d} {bar}")
    if len(shown) < len(times):
        screen.say(f"   longer {len(times) - len(shown):6d}")
    screen.say(
        f"fastest cycle that the link holds: {found.cycle * 1000:g} ms (--cycle {found.cycle:g}); of "
        f"{count} cycles {100 * found.late_share:.1f} % were late and {found.missed} without a sample"
    )
    screen.say(
        f"at that cycle an oscillation lasts at least {found.shortest_period * 1000:.0f} ms: the shorter it "
        "can be, the less travel an experiment takes"
    )


def _three(values: Any) -> tuple[float, float, float]:
    import numpy as np

    return float(np.median(values)), float(np.quantile(values, 0.99)), float(np.max(values))
