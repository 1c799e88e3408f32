"""tworelay analyze FILE."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.acting import at_desk, check_json, write_json
from commissioning.cli.helping import Helpful
from commissioning.cli.junit import junit_option
from commissioning.cli.options import verbose
from commissioning.cli.quantity import DURATION, POSITION, SHARE, TORQUE, Measure
from commissioning.cli.targets import axis_from
from commissioning.cli.terminal import Screen
from commissioning.result.readings import MethodName

__all__ = ["command"]


@click.command("analyze", cls=Helpful)
@click.argument("files", nargs=-1, required=True, metavar="FILE…", type=click.Path(path_type=Path))
@click.option("--time", metavar="COL[:UNIT]", help="s, ms, us. Default: time_s.")
@click.option(
    "--position",
    metavar="COL[:UNIT]",
    help="rad, deg, rev, m, mm, um, or counts with --encoder. Default: position_rad, position_m, "
    "or the only column in such a unit.",
)
@click.option("--velocity", metavar="COL[:UNIT]", help="rad/s, deg/s, rpm, m/s, mm/s.")
@click.option(
    "--torque",
    metavar="COL[:SCALE UNIT]",
    help="Nm, mNm, N, kN, or A, mA with --torque-constant, % with --rated-torque; a scale before "
    "the unit may be the name of a scalar of a .mat file. Default: command_Nm, torque_Nm, force_N, "
    "or the only column in such a unit.",
)
@click.option(
    "--period", type=DURATION, metavar="T",
    help="Between two rows, where no column is a time: '2ms'.",
)  # fmt: skip
@click.option(
    "--encoder", type=Measure(low=0, above=True), metavar="N",
    help="Counts per revolution, of a position in counts.",
)  # fmt: skip
@click.option(
    "--feed", type=POSITION, metavar="X",
    help="Way per revolution, of such a position on a linear axis.",
)  # fmt: skip
@click.option(
    "--torque-constant", type=Measure("torque constant", low=0, above=True), metavar="K",
    help="N.m/A, of a torque in A or mA.",
)  # fmt: skip
@click.option(
    "--rated-torque", type=TORQUE, metavar="M", help="What 100 % are, of a torque in per cent."
)  # fmt: skip
@click.option("--steady", is_flag=True, help="Recordings at constant speeds, one or more a file.")
@click.option(
    "--method",
    type=click.Choice(
        [
            name.value
            for name in (
                MethodName.AUTO,
                MethodName.OUTPUT_ERROR,
                MethodName.MODULATING,
                MethodName.LOCK_IN,
            )
        ]
    ),
    default="auto",
    show_default=True,
)
@click.option(
    "--json", "json_target", metavar="F", help="Result as JSON to F, '-' for standard output."
)
@click.option(
    "--for", "target", metavar="TARGET",
    help="The axis that was recorded: its drive is read, and what 'apply' would write is proposed.",
)  # fmt: skip
@click.option(
    "--profile", metavar="P", help="With --for: drive profile, a built-in name or a file."
)
@click.option(
    "--fraction", type=SHARE, default="85 %", metavar="P", show_default=True,
    help="With --for: share of the friction to compensate; the offset is compensated whole.",
)  # fmt: skip
@verbose
@junit_option("analyze")
def command(
    files: tuple[Path, ...],
    time: str | None,
    position: str | None,
    velocity: str | None,
    torque: str | None,
    period: float | None,
    encoder: float | None,
    feed: float | None,
    torque_constant: float | None,
    rated_torque: float | None,
    steady: bool,
    method: str,
    json_target: str | None,
    target: str | None,
    profile: str | None,
    fraction: float,
) -> None:
    """Friction from a recording: CSV of any kind, .mat or .npz. Nothing is moved.

    COL is a column's name, or its number from 1.

    Oscillations are read by output error where a law explains their positions; else two steady
    ones of one period by the exact harmonic balance and by modulating functions, any other motion
    by the latter.
    """
    from commissioning.cli import show
    from commissioning.recordings.reading import Scales
    from commissioning.rig.results import Rejected
    from commissioning.session.analyze import analyze

    check_json(json_target)
    screen = Screen(json_target, yes=True)
    columns = {"time": time, "position": position, "velocity": velocity, "torque": torque}
    try:
        with screen.working("analysing"):
            bases = Scales(encoder, feed, torque_constant, rated_torque, period)
            result = analyze(files, columns, bases, steady=steady, method=method, tell=screen.tell)
    except Rejected as error:
        write_json(error.result, json_target)
        raise
    if target is not None:
        from commissioning.ending import ended, erring, untouched
        from commissioning.session.recorded import for_drive
        from profiles.errors import TwoRelayError

        try:
            with at_desk(screen) as desk:
                result = for_drive(result, axis_from(target, profile), fraction, desk)
        except TwoRelayError as error:
            result = ended(erring(result, error), None, untouched(error), error.said_by or None)
            write_json(result, json_target)
            show.ending(result, screen)
            raise
    write_json(result, json_target)
    show.summary(result, screen)
    if target is not None:
        show.outcome(result, screen)
        show.ending(result, screen)
