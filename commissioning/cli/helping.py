"""What --help shows beside click's own: options in groups, and examples of every command."""

from __future__ import annotations

import click

__all__ = ["EXAMPLES", "Helpful", "HelpfulGroup"]

_GROUPS: dict[str, tuple[str, ...]] = {
    "What it may do": (
        "travel", "max_torque", "max_speed", "duration", "cycle", "watchdog", "without_watchdog",
        "yes", "dry_run", "ask_each", "check_only", "force",
    ),
    "What is measured": (
        "fraction", "method", "precision", "solver", "repeat", "points", "output_filter",
        "motor_temperature", "steady",
    ),
    "What the columns are": (
        "time", "position", "velocity", "torque", "period", "encoder", "feed", "torque_constant",
        "rated_torque",
    ),
    "What is said, and where": (
        "json_target", "as_json", "junit", "trace", "output", "pdf_target", "paper", "language",
        "picture", "csv_target", "verbose", "quiet", "help", "help_option",
    ),
}  # fmt: skip
_FEW = 8  # options that need no groups

# by the command's path; '' is 'tworelay' itself
EXAMPLES: dict[str, tuple[str, ...]] = {
    "": ("tworelay demo", "tworelay commission press-7-x.toml"),
    "demo": ("tworelay demo",),
    "identify": (
        "tworelay identify virtual://bench",
        "tworelay identify 'modbus-tcp://192.168.1.10?unit=1' --travel '±180 deg'",
    ),
    "apply": ("tworelay apply last", "tworelay apply last --gains cascade"),
    "verify": ("tworelay verify last", "tworelay verify last --check-only"),
    "commission": (
        "tworelay commission press-7-x.toml",
        "tworelay commission 'canopen://socketcan/can0?node=5' --profile cia402 --travel 20mm",
    ),
    "restore": ("tworelay restore last", "tworelay restore last --dry-run"),
    "stop": ("tworelay stop 'modbus-rtu:COM5?unit=1' --profile lichuan-lc10e",),
    "adopt": ("tworelay adopt run-of-the-laptop",),
    "tune": ("tworelay tune last", "tworelay tune virtual://bench --yes"),
    "analyze": (
        "tworelay analyze scope.csv --position 'Lage:deg' --torque 'Strom:0.12 A'",
        "tworelay analyze counts.csv --period 2ms --encoder 4096 --torque-constant 0.05",
    ),
    "plot": ("tworelay plot loci last",),
    "plot loci": ("tworelay plot loci last --output loci.pdf",),
    "report": ("tworelay report last", "tworelay report last --pdf press-7-x.pdf --language de"),
    "export": ("tworelay export last run-of-today",),
    "history": ("tworelay history", "tworelay history press-7-x"),
    "history list": ("tworelay history list press-7-x --csv press-7-x.csv",),
    "history drift": ("tworelay history drift --gate 15",),
    "history note": ("tworelay history note press-7-x 'new ball screw'",),
    "history rename": ("tworelay history rename press-7-x press-7-left",),
    "history reindex": ("tworelay history reindex",),
    "history prune": ("tworelay history prune --help",),
    "compare": ("tworelay compare last press-7-x.toml",),
    "fleet": ("tworelay fleet check line.toml", "tworelay fleet run line.toml"),
    "fleet check": ("tworelay fleet check line.toml",),
    "fleet run": ("tworelay fleet run line.toml",),
    "fleet rehearse": ("tworelay fleet rehearse line.toml",),
    "fleet status": ("tworelay fleet status",),
    "fleet stop": ("tworelay fleet stop",),
    "fleet restore": ("tworelay fleet restore last",),
    "fleet report": ("tworelay fleet report last",),
    "fleet keys": ("tworelay fleet keys keys --gateway pc-a --client laptop",),
    "fleet gateway": ("tworelay fleet gateway --axes . --listen 10.0.7.11:8786",),
    "scan": ("tworelay scan canopen://socketcan/can0", "tworelay scan 'modbus-rtu:COM5'"),
    "doctor": ("tworelay doctor", "tworelay doctor 'modbus-tcp://192.168.1.10?unit=1'"),
    "latency": ("tworelay latency 'modbus-tcp://192.168.1.10?unit=1'",),
    "profile": ("tworelay profile list", "tworelay profile check my-drive.toml"),
    "profile list": ("tworelay profile list",),
    "profile show": ("tworelay profile show cia402",),
    "profile check": ("tworelay profile check my-drive.toml",),
    "profile new": ("tworelay profile new --eds drive.eds --output my-drive.toml",),
    "virtual": ("tworelay virtual list",),
    "virtual list": ("tworelay virtual list",),
    "virtual serve": ("tworelay virtual serve bench --modbus-tcp 127.0.0.1:1502",),
}


def _examples(context: click.Context, formatter: click.HelpFormatter) -> None:
    names: list[str] = []
    while context.parent is not None:
        names.insert(0, context.info_name or "")
        context = context.parent
    found = EXAMPLES.get(" ".join(names), ())
    if found:
        with formatter.section("Examples"):
            for line in found:
                formatter.write(f"{'':{formatter.current_indent}}{line}\n")


class Helpful(click.Command):
    """A command with its options in groups, where there are many, and examples."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Options by what they are for."""
        records = {
            str(one.name): record
            for one in self.get_params(ctx)
            if (record := one.get_help_record(ctx)) is not None
        }
        if len(records) <= _FEW:
            super().format_options(ctx, formatter)
            return
        grouped = {name for names in _GROUPS.values() for name in names}
        others = [record for name, record in records.items() if name not in grouped]
        sections = [("Options", others)]
        sections += [
            (title, [records[name] for name in names if name in records])
            for title, names in _GROUPS.items()
        ]
        for title, rows in sections:
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Examples."""
        _examples(ctx, formatter)


class HelpfulGroup(click.Group):
    """A group with examples, of commands that have some."""

    command_class = Helpful

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Examples."""
        _examples(ctx, formatter)
