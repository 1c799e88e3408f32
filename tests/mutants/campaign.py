"""make mutants: change the code that keeps people safe, and see that some test notices.

300 mutants drawn by a fixed seed, and every comparison and every deleted call of the innermost
modules. A call goes on where the last one ended, for about nine minutes; `.mutants/` keeps what is
known. `afresh` begins anew; paths of tests that are new, or changed, add what they see, and what
lived is tried again. The last line is `mutants: N of M tried, K killed, L live`.
"""

from __future__ import annotations

import itertools
import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from tests.mutants.contexts import DURATIONS
from tests.mutants.mutate import Mutant, mutants_of

ROOT = Path(__file__).parent.parent.parent
KNOWN = ROOT / ".mutants"
EVERY = (
    "commissioning/envelope.py", "commissioning/runner.py", "commissioning/settings.py",
    "drivers/stopping.py",
)  # fmt: skip
POOL = (
    *EVERY, "commissioning/guardian.py", "commissioning/guardian_process.py",
    "commissioning/interruption.py", "commissioning/journal.py", "commissioning/ownership.py",
    "commissioning/rig/preflight.py", "drivers/power.py",
)  # fmt: skip
DRAWN, SEED, WORKERS = 300, 1, 2
MINUTES = 9.0
FIRST, ALL = 6.0, 60.0  # s of tests: the quickest that see the line, then the others
LIMIT = 240.0  # s for one mutant: it hangs, which is noticed too
_OURS = ("tests", "commissioning", "drivers", "profiles")
_HEAVY = (
    "can.interfaces.slcan", "can.interfaces.socketcand", "canopen", "click", "coverage", "jinja2",
    "jsonschema", "matplotlib.backends.backend_svg", "matplotlib.figure", "numpy", "psutil",
    "pydantic", "pymodbus.client", "pymodbus.server", "pytest", "rich.console", "rich.progress",
    "scipy.integrate", "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.sparse.linalg",
    "serial", "tomlkit",
)  # fmt: skip


def chosen() -> list[Mutant]:
    """The mutants of the campaign."""
    every = {m.name: m for file in POOL for m in mutants_of(ROOT / file, ROOT)}
    names = [n for n, m in every.items() if m.file in EVERY and m.kind in ("comparison", "call")]
    drawn = random.Random(SEED).sample(sorted(every), DRAWN)
    return [every[name] for name in dict.fromkeys([*names, *drawn])]


def look(*paths: str) -> None:
    """Find out which tests see which lines; of those at `paths` alone, added to what is known."""
    if not paths:
        shutil.rmtree(KNOWN, ignore_errors=True)
    KNOWN.mkdir(exist_ok=True)
    fresh = KNOWN / "durations.new.json"
    environment = {**os.environ, DURATIONS: str(fresh), "COVERAGE_FILE": str(KNOWN / "coverage")}
    run = ["-m", "coverage", "run", "-m", "pytest", "-p", "tests.mutants.contexts", "-q"]
    run += ["-n", "auto", "--dist", "loadgroup", "-m", "not real_time", "--timeout", "400"]
    for words in ([*run, *paths], ["-m", "coverage", "combine", "-q"]):
        subprocess.run([sys.executable, *words], cwd=ROOT, env=environment, check=True)
    from coverage import CoverageData

    data = CoverageData(str(KNOWN / "coverage"))
    data.read()
    seen = _read("seen.json")
    for file in POOL:
        known_lines = seen.setdefault(file, {})
        for line, tests in data.contexts_by_lineno(str(ROOT / file)).items():
            there = set(known_lines.get(str(line), [])) | {test for test in tests if "::" in test}
            known_lines[str(line)] = sorted(there)
    (KNOWN / "seen.json").write_text(json.dumps(seen), "utf-8")
    durations = _read("durations.json") | json.loads(fresh.read_text("utf-8"))
    (KNOWN / "durations.json").write_text(json.dumps(durations), "utf-8")


def _read(name: str) -> dict[str, Any]:
    path = KNOWN / name
    found: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {}
    return found


def tests_for(
    mutant: Mutant, seen: dict[str, dict[str, list[str]]], durations: dict[str, float]
) -> list[list[str]]:
    """The tests that run a mutant's line, the quickest first, in two batches."""
    lines = seen[mutant.file]
    tests = [] if mutant.at_import else lines.get(str(mutant.line), [])
    tests = tests or sorted({test for found in lines.values() for test in found})
    tests = sorted(tests, key=lambda test: durations.get(test, 1.0))
    spent = list(itertools.accumulate(durations.get(test, 1.0) for test in tests))
    first = [test for test, s in zip(tests, spent, strict=True) if s <= FIRST] or tests[:1]
    rest = [test for test, s in zip(tests, spent, strict=True) if s <= ALL][len(first) :]
    return [batch for batch in (first, rest) if batch]


def notice(tree: Path, mutant: Mutant, batches: list[list[str]]) -> str:
    """Which way a mutant is noticed; '' where it lives.

    Raises RuntimeError where it is not the mutant.
    """
    path = tree / mutant.file
    original = path.read_text("utf-8")
    for batch in batches:
        path.write_text(mutant.source, "utf-8")
        try:
            code = _outcome(tree, batch)
        finally:
            path.write_text(original, "utf-8")
        if code is None:
            return "hangs"
        if code > 1 and _outcome(tree, batch):  # no test failed, but could not be found or imported
            raise RuntimeError(f"these fail although nothing is changed: {batch[:3]} …")
        if code:
            return "killed"
    return ""


def _outcome(tree: Path, tests: list[str]) -> int | None:
    """pytest's exit code for some tests of a tree; None: they hang."""
    child = os.fork()
    if not child:
        _run(tree, tests)
    return _wait(child)


def _run(tree: Path, tests: list[str]) -> None:
    """The tests in this process, which ends with them."""
    import pytest

    os.setsid()
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    for name in [name for name in sys.modules if name.partition(".")[0] in _OURS]:
        del sys.modules[name]  # they are those of another tree
    null = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(null, stream)
    options = ["-x", "-q", "--timeout", "60"]
    code = 1
    try:
        code = int(pytest.main([*options, "--rootdir", str(tree), *tests]))
    finally:
        os._exit(code)


def _wait(child: int) -> int | None:
    """Its exit code; None: it hangs, and is killed with its children."""
    until = time.monotonic() + LIMIT
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, 9)
    os.waitpid(child, 0)
    return None


def copy_of_the_tree(number: int) -> Path:
    """What git knows of, and what is new, in a folder of its own beside the recordings."""
    tree = KNOWN / f"tree-{number}" / "main"
    shutil.rmtree(tree.parent, ignore_errors=True)
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    for name in listed.stdout.splitlines():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, tree / name)
    if (ROOT.parent / "shared").is_dir():
        (tree.parent / "shared").symlink_to(ROOT.parent / "shared")
    return tree


def work(number: int, todo: list[Mutant], until: float) -> None:
    """One worker's share, as far as time allows."""
    tree = copy_of_the_tree(number)
    seen, durations = _read("seen.json"), _read("durations.json")
    for file in dict.fromkeys(mutant.file for mutant in todo):
        source = (tree / file).read_text("utf-8")
        same = Mutant(file, 0, True, "other", "nothing", source)
        if notice(tree, same, [tests_for(same, seen, durations)[0][:10]]):
            raise RuntimeError(f"the tests of {file} fail although nothing is changed")
    with (KNOWN / f"results-{number}.jsonl").open("a", encoding="utf-8") as results:
        for mutant in todo:
            if time.monotonic() > until:
                return
            batches = tests_for(mutant, seen, durations)
            outcome = notice(tree, mutant, batches)
            record = {"name": mutant.name, "file": mutant.file, "outcome": outcome}
            results.write(json.dumps({**record, "tests": sum(map(len, batches))}) + "\n")
            results.flush()


def known() -> dict[str, dict[str, str]]:
    """Outcomes so far, by the mutant's name."""
    found = {}
    for path in KNOWN.glob("results-*.jsonl"):
        for line in path.read_text("utf-8").splitlines():
            record = json.loads(line)
            if record["outcome"] or record["name"] not in found:  # who tried later knew more tests
                found[record["name"]] = record
    return found


def main() -> int:
    """Go on for some minutes, then say what is known."""
    until = time.monotonic() + 60 * MINUTES
    paths = sys.argv[1:]
    if paths or not (KNOWN / "seen.json").exists():
        look(*(path for path in paths if path != "afresh"))
    mutants = chosen()
    tried = known()
    if paths:
        tried = {name: found for name, found in tried.items() if found["outcome"]}
    todo = [mutant for mutant in mutants if mutant.name not in tried]
    for name in _HEAVY:
        __import__(name)
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    children = []
    for number in range(WORKERS):
        child = os.fork()
        if not child:
            code = 1
            try:
                work(number, todo[number::WORKERS], until)
                code = 0
            except Exception as error:
                sys.stderr.write(f"{error}\n")
            finally:
                os._exit(code)
        children.append(child)
    if sum(os.waitpid(child, 0)[1] for child in children):
        return 1
    tried = {m.name: found for m in mutants if (found := known().get(m.name))}
    live = [found for found in tried.values() if not found["outcome"]]
    out = sys.stdout
    for file in POOL:
        mine = [found for found in tried.values() if found["file"] == file]
        alive = Counter(bool(found["outcome"]) for found in mine)[False]
        out.write(f"{file}: {len(mine)} tried, {len(mine) - alive} killed\n")
    for found in live:
        out.write(f"  lives: {found['name']} ({found['tests']} tests)\n")
    out.write(
        f"mutants: {len(tried)} of {len(mutants)} tried, {len(tried) - len(live)} killed, "
        f"{len(live)} live\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
