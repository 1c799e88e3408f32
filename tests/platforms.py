"""make platforms.

The built wheel and sdist, installed on every Python that is found, do their jobs.

On the oldest Python also with the lowest versions of what tworelay depends on directly. The last
line is `platforms: N rows, M held`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
MINORS = range(11, 15)
COMPLETE = ("Makefile", "requirements.lock", "CONTRIBUTING.md", ".ci/run", "tests/conftest.py")
LIMIT = 180  # s for one command


@dataclass(frozen=True)
class Row:
    """One installation: of what, on which Python, with which versions of the dependencies."""

    python: Path
    archive: Path
    lowest: bool


class Broken(Exception):
    """A command did not do what it should."""


def run(*words: object, folder: Path, home: Path | None = None) -> str:
    """Standard output of a command; raises Broken."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    if home is not None:
        environment["TWORELAY_HOME"] = str(home)
    done = subprocess.run(
        [str(word) for word in words], cwd=folder, env=environment, capture_output=True, text=True,
        timeout=LIMIT, stdin=subprocess.DEVNULL, check=False,
    )  # fmt: skip
    if done.returncode:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:]
        raise Broken(f"{Path(str(words[0])).name} {words[1]}: exit {done.returncode}: {last}")
    return done.stdout


def pythons() -> list[Path]:
    """Each Python 3.11 to 3.14 of this machine, one a minor version."""
    found = []
    for minor in MINORS:
        named = shutil.which(f"python3.{minor}")
        known = sorted((Path.home() / ".pyenv" / "versions").glob(f"3.{minor}.*/bin/python"))
        for candidate in [Path(sys.executable), *([Path(named)] if named else []), *known]:
            asked = subprocess.run(
                [candidate, "-c", "import sys; print(sys.version_info[:2])"],
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            if asked.stdout.strip() == f"(3, {minor})":
                found.append(candidate)
                break
    return found


def archives(folder: Path) -> tuple[Path, Path]:
    """Wheel and sdist of this tree.

    Raises Broken where the sdist lacks what it is built and tested with.
    """
    build = "import hatchling.build as b, sys; print(getattr(b, sys.argv[1])(sys.argv[2]))"
    wheel, sdist = (
        folder / run(sys.executable, "-c", build, what, folder, folder=ROOT).split()[-1]
        for what in ("build_wheel", "build_sdist")
    )
    with tarfile.open(sdist) as archive:
        there = {name.partition("/")[2] for name in archive.getnames()}
    if missing := set(COMPLETE) - there:
        raise Broken(f"the sdist lacks {', '.join(sorted(missing))}")
    return wheel, sdist


def installed(row: Row, folder: Path) -> Path:
    """The command `tworelay` of a fresh environment."""
    uv = Path(sys.executable).parent / "uv"
    run(uv, "venv", "--quiet", "--python", row.python, folder / "env", folder=folder)
    resolution = "lowest-direct" if row.lowest else "highest"
    run(
        uv, "pip", "install", "--quiet", "--python", folder / "env" / "bin" / "python",
        "--resolution", resolution, row.archive, folder=folder,
    )  # fmt: skip
    return folder / "env" / "bin" / "tworelay"


def jobs(tworelay: Path, folder: Path) -> dict[str, Callable[[], object]]:
    """The smoke jobs by name."""
    home = folder / "home"

    def command(*words: str) -> str:
        return run(tworelay, *words, folder=folder, home=home)

    def over(*wire: str) -> None:
        serving = [str(tworelay), "virtual", "serve", "bench", *wire, "--clock", "step"]
        with subprocess.Popen(
            [*serving, "--state", str(folder / "drive.json")],
            cwd=folder, stdout=subprocess.PIPE, text=True,
        ) as server:  # fmt: skip
            assert server.stdout is not None
            try:
                link = server.stdout.readline().strip()
                command("identify", link, "--travel", "20", "--cycle", "0.004", "--yes")
            finally:
                server.terminate()

    return {
        "identify": lambda: command("identify", "virtual://bench", "--yes"),
        "report": lambda: command("report", "last"),
        "tune": lambda: command("tune", "virtual://bench", "--yes"),
        "demo": lambda: command("demo"),
        "slcan": lambda: over("--slcan", "pty"),
        "socketcand": lambda: over("--socketcand", "127.0.0.1:0"),
        "RTU pty": lambda: over("--modbus-rtu", "pty"),
    }


def tried(row: Row) -> tuple[list[str], bool]:
    """Cells of the table, and whether all held."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        version = run(
            row.python, "-c", "import platform as p; print(p.python_version())", folder=folder
        )
        kind = "sdist" if row.archive.suffix == ".gz" else "wheel"
        cells = [version.strip(), kind, "lowest" if row.lowest else "newest"]
        try:
            tworelay = installed(row, folder)
        except (Broken, subprocess.TimeoutExpired) as error:
            return [*cells, str(error)], False
        holds = True
        for job in jobs(tworelay, folder).values():
            try:
                job()
                cells.append("ok")
            except (Broken, subprocess.TimeoutExpired) as error:
                cells.append(str(error))
                holds = False
        return cells, holds


def main() -> int:
    """Each installation, a row."""
    out = sys.stdout
    with tempfile.TemporaryDirectory() as folder:
        wheel, sdist = archives(Path(folder))
        found = pythons()
        rows = [Row(python, wheel, False) for python in found]
        rows += [Row(found[0], sdist, False), Row(found[0], wheel, True)]
        out.write("| Python | from | dependencies | " + " | ".join(jobs(wheel, wheel)) + " |\n")
        out.write("| --- |" + " --- |" * (2 + len(jobs(wheel, wheel))) + "\n")
        held = 0
        for row in rows:
            cells, holds = tried(row)
            held += holds
            out.write("| " + " | ".join(cells) + " |\n")
            out.flush()
    missing = [f"3.{m}" for m in MINORS if not any(f"3.{m}" in str(p.resolve()) for p in found)]
    if missing:
        out.write(f"not on this machine: Python {', '.join(missing)}\n")
    out.write(f"platforms: {len(rows)} rows, {held} held\n")
    return 0 if held == len(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
