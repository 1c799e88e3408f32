"""tworelay profile list | show P | check P | new."""

from __future__ import annotations

import click

__all__ = ["command"]


@click.group("profile")
def command() -> None:
    """List, show and check drive profiles."""


@command.command("list")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def list_profiles(as_json: bool) -> None:
    """The built-in profiles."""
    from profiles.library import builtin_names, load_profile

    found = [load_profile(name) for name in builtin_names()]
    if as_json:
        import json

        keys = ("name", "version", "bus", "title", "status")
        click.echo(json.dumps([{key: getattr(p, key) for key in keys} for p in found], indent=1))
        return
    for p in found:
        click.echo(f"{p.name:<18} {p.bus:<8} {p.compensation.law:<18} {p.status:<15} {p.title}")


@command.command("show")
@click.argument("profile")
def show(profile: str) -> None:
    """The profile as it is written (TOML)."""
    from profiles.library import source_text

    click.echo(source_text(profile), nl=False)


@command.command("check")
@click.argument("profile")
def check_profile(profile: str) -> None:
    """Find what is wrong with PROFILE, a built-in name or a file. Errors end with exit code 2."""
    from profiles.errors import ProfileError
    from profiles.library import check, load_profile

    loaded = load_profile(profile)
    findings = check(loaded)
    for finding in findings:
        click.echo(f"{finding.severity}: {finding.text}")
    errors = sum(finding.severity == "error" for finding in findings)
    if errors:
        raise ProfileError(f"profile '{loaded.name}' has {errors} error(s)")
    click.echo(
        f"{loaded.name} {loaded.version}: {len(loaded.parameters)} parameters, {loaded.bus}, "
        f"compensation {loaded.compensation.law}: usable, {len(findings)} warning(s)"
    )


@command.command("new")
@click.option("--eds", required=True, metavar="F", help="EDS or DCF of a CANopen drive.")
@click.option("--output", required=True, metavar="F", help="The profile that is written (.toml).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def new(eds: str, output: str, force: bool) -> None:
    """Draft a profile from a description file, and say what the file does not tell."""
    from pathlib import Path

    from profiles.errors import UsageError
    from profiles.library import check, draft_from_eds, load_profile

    target = Path(output)
    if target.suffix != ".toml":
        raise UsageError(f"--output {target}: a profile's file ends with .toml")
    if target.exists() and not force:
        raise UsageError(f"--output {target}: exists already; --force overwrites it")
    draft = draft_from_eds(Path(eds))
    try:
        target.write_text(draft.text, "utf-8")
    except OSError as error:
        raise UsageError(f"--output {target}: cannot be written: {error.strerror}") from None
    for note in draft.notes:
        click.echo(f"note: {note}")
    loaded = load_profile(str(target))
    for finding in check(loaded):
        click.echo(f"{finding.severity}: {finding.text}")
    click.echo(
        f"{target}: profile '{loaded.name}', {len(loaded.parameters)} parameters; what comes next: "
        "docs/bring-your-own-drive.md"
    )
