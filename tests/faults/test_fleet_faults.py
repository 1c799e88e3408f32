"""Fleet runs break at their transitions: no axis moves twice, and all is accounted for."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.command import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


def test_some_cases() -> None:
    """`make fleet-faults` tries every one; they fork, so they want a process without threads."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.faults.fleet", "7/107"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=150,
    )  # fmt: skip
    last = done.stdout.splitlines()[-1]
    cases, held = (int(word) for word in last.split() if word.isdigit())
    assert cases == held > 4, done.stdout + done.stderr
