"""tworelay latency LINK."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from commissioning.cli.acting import at_desk
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text
from commissioning.cli.quantity import POSITION, SPEED, TORQUE
from commissioning.cli.targets import axis_from
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from commissioning.result.found import Quantity

__all__ = ["command"]

_BARS, _WIDTH = 12, 40
_LEAST_CYCLE = 1e-3  # s, of the experiment


@click.command("latency", cls=Helpful)
@click.argument("target", metavar="LINK")
@click.option("--profile", metavar="P", help="Drive profile: a built-in name or a file.")
@click.option("--count", type=click.IntRange(50, 100_000), default=500, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@click.option("--move", is_flag=True, help="MOVE the axis: how late a torque acts, by small steps.")
@click.option("--travel", type=POSITION, metavar="±X", help="With --move: '20 deg', the room.")
@click.option("--max-torque", type=TORQUE, metavar="X", help="With --move: '0,5 Nm', N.m or N.")
@click.option("--max-speed", type=SPEED, metavar="X", help="With --move: '300 rpm', rad/s or m/s.")
@click.option("--without-watchdog", is_flag=True, help="With --move: as in identify.")
@click.option("--yes", is_flag=True, help="With --move: confirm in advance.")
@verbose
def command(
    target: str,
    profile: str | None,
    count: int,
    as_json: bool,
    move: bool,
    travel: float | None,
    max_torque: float | None,
    max_speed: float | None,
    without_watchdog: bool,
    yes: bool,
) -> None:
    """Round trip and cycle of a link, the fastest cycle that it holds, and what that means.

    The drive stays de-energised and every output at zero, unless --move asks for the dead time,
    too.
    """
    import numpy as np

    from commissioning.desk import Options
    from commissioning.rig.armed import Failure
    from commissioning.session.latency import dead_time, latency

    screen = Screen("-" if as_json else None, yes=yes)
    axis = axis_from(target, profile)
    options = Options(travel, max_torque, max_speed, without_watchdog=without_watchdog)
    late: Quantity | None = None
    with at_desk(screen) as desk, screen.working("measuring"):
        found = latency(axis, count, desk)
        if move:
            options = replace(options, cycle=max(found.cycle, _LEAST_CYCLE))
            try:
                late = dead_time(axis, options, desk).friction.dead_time
            except Failure as failure:
                raise failure.error from None
    rows = {
        "one read": found.service, "one exchange": found.exchange,
        f"lateness at {found.cycle * 1000:g} ms": found.lateness,
    }  # fmt: skip
    if as_json:
        tree: dict[str, object] = {
            name: dict(zip(("median", "p99", "worst"), _three(values), strict=True))
            for name, values in zip(("service", "exchange", "lateness"), rows.values(), strict=True)
        }
        tree |= {
            "cycle": found.cycle, "late_share": found.late_share, "missed": found.missed,
            "shortest_period": found.shortest_period, "watchdog": found.watchdog,
            "dead_time": late
            and {"value": late.value, "low": late.low, "high": late.high, "unit": late.unit},
        }  # fmt: skip
        document(json_text(tree))
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
        f"fastest cycle that the link holds: {found.cycle * 1000:g} ms (--cycle {found.cycle:g}); "
        f"of {len(found.lateness)} cycles {100 * found.late_share:.1f} % were late and "
        f"{found.missed} without a sample"
    )
    if found.watchdog > found.bears:
        screen.say(
            f"the drive's watchdog bears {found.bears * 1000:g} ms of silence, and the slowest "
            f"exchange took {found.exchange.max() * 1000:.3g} ms: give --watchdog "
            f"{found.watchdog:g} with it"
        )
    screen.say(
        f"at that cycle an oscillation lasts at least {found.shortest_period * 1000:.0f} ms: the "
        "shorter it can be, the less travel an experiment takes"
    )
    if late is not None:
        low, high = 1000 * (late.low or 0.0), 1000 * (late.high or 0.0)
        screen.say(
            f"dead time from command to motion: {1000 * late.value:.3g} ms ({low:.3g} … {high:.3g} "
            "ms)"
        )


def _three(values: Any) -> tuple[float, float, float]:
    import numpy as np

    return float(np.median(values)), float(np.quantile(values, 0.99)), float(np.max(values))
