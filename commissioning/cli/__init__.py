"""The command line. Each command lives in a module of its own, imported when it is called."""

from __future__ import annotations

import errno
import io
import os.path
import sys
from importlib import import_module

import click

from commissioning.child import shadow
from commissioning.cli.helping import HelpfulGroup

__all__ = ["main"]

_ROOT = os.path.realpath(os.path.join(os.path.dirname(__file__), "..", ".."))  # noqa: PTH118, PTH120

# name: (module, help line); help lines stand here so that --help imports no command
_COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "The whole job on a virtual drive served over Modbus TCP, with a report."),
    "identify": ("identify", "Measure the friction of an axis; change nothing for good."),
    "apply": ("apply", "Write what a run proposed, read it back, store it."),
    "verify": ("verify", "Prove that the compensation helps; leave the best in the drive."),
    "commission": ("commission", "Identify, apply, verify, report."),
    "restore": ("restore", "Put parameters back; finish what a crash interrupted."),
    "stop": ("stop", "Make safe what a dead process left energised."),
    "adopt": ("adopt", "Take in a run that was exported on another computer."),
    "tune": ("tune", "Gains from a run or an axis, and what each is worth."),
    "analyze": ("analyze", "Friction from a recording of any tool."),
    "plot": ("plot", "A picture of a run: loci."),
    "report": ("report", "Write the HTML report of a run."),
    "export": ("export", "Copy a run with its samples and journal to a folder."),
    "history": ("history", "The runs of this computer; of an axis its numbers, and its drift."),
    "compare": ("compare", "Two runs side by side, or two fleet runs."),
    "fleet": ("fleet", "Many axes: look, run, resume, report."),
    "scan": ("scan", "Which drives are on a bus, and which profile fits."),
    "doctor": ("doctor", "What this machine and a link have, and what is wrong with them."),
    "latency": ("latency", "Round trip, jitter and the fastest cycle of a link."),
    "profile": ("profile", "List, show and check drive profiles."),
    "virtual": ("virtual", "List virtual axes and serve them to other programs."),
}


_WITH_JUNIT = "identify", "apply", "verify", "commission", "tune", "analyze", "fleet"


class _LazyGroup(HelpfulGroup):
    """Commands by name; the module is imported when the command is needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module, _ = _COMMANDS[cmd_name]
        command: click.Command = import_module(f"commissioning.cli.{module}").command
        return command

    def format_commands(
        self,
        ctx: click.Context,
        formatter: click.HelpFormatter,
    ) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in _COMMANDS.items()])


@click.group(
    cls=_LazyGroup,
    context_settings={
        "auto_envvar_prefix": "TWORELAY",
        "max_content_width": 100,
        "help_option_names": ["-h", "--help"],
    },
)
@click.version_option(package_name="tworelay")
def cli() -> None:
    """Commission servo drives over Modbus and CANopen: find friction, compensate it, prove it.

    TARGET is a link (virtual://bench, modbus-tcp://HOST:PORT?unit=1,
    canopen://socketcan/can0?node=5) or an axis file (press-7-x.toml). RUN is an id as printed,
    'last', or, to be read, the folder of an exported run. Start with: tworelay demo
    """


def main() -> None:
    """Entry point: one plain line for every error, and its documented exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # an old code page must not end a job
    hidden = shadow(_ROOT)
    if hidden:
        sys.stderr.write(f"tworelay: {hidden}\n")  # nothing of ours can be imported
        sys.exit(2)
    try:
        cli.main(standalone_mode=False)
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except Exception as error:
        sys.exit(_report_failure(error))


def _meant(message: str, where: click.Context | None) -> str:
    """A command that is spelled nearly so."""
    import difflib
    import re

    named = re.fullmatch(r"No such command '(.+)'\.", message)
    if named is None or where is None or not isinstance(where.command, click.Group):
        return ""
    near = difflib.get_close_matches(named[1], where.command.list_commands(where), 1)
    return f" Did you mean '{near[0]}'?" if near else ""


def _junit(error: Exception, message: str, code: str, exit_code: int) -> None:
    """What --junit is to say of what ended before it began."""
    has_it = any(word in _WITH_JUNIT for word in sys.argv[1:2])
    told = getattr(error, "in_junit", False)
    if has_it and not told and any(word.startswith("--junit") for word in sys.argv):
        from commissioning.cli.junit import not_begun

        not_begun(sys.argv[1:], message, code, exit_code)


def _report_failure(error: Exception) -> int:
    from commissioning.cli.output import document, say
    from profiles.errors import TwoRelayError

    if isinstance(error, click.exceptions.Abort):
        say("tworelay: interrupted", err=True)
        return 130
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        document(error.format_message() + "\n")
        return 2
    if isinstance(error, click.ClickException):  # its own wording, on one line
        message = " ".join(error.format_message().split())
        where = getattr(error, "ctx", None)
        message += _meant(message, where)
        _junit(error, message, "usage", 2)
        hint = f" Try '{where.command_path} --help'." if where is not None else ""
        say(f"tworelay: {message}{hint}", err=True)
        return 2
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        say(f"tworelay: {error.strerror}: what was asked for cannot be said", err=True)
        return 2
    if isinstance(error, TwoRelayError):
        _junit(error, str(error), error.code, error.exit_code)
        say(f"tworelay: {error}", err=True)
        return error.exit_code
    if "-v" in sys.argv or "--verbose" in sys.argv:
        import traceback

        document(traceback.format_exc(), err=True)
    say(
        f"tworelay: internal error ({type(error).__name__}: {error}); this is a bug: please report "
        "it with the output of the same command with -v",
        err=True,
    )
    return 1
