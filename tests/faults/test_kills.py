"""Jobs die at the steps of their journal: nothing is lost, and `restore` brings everything back."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.command import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


def test_some_steps() -> None:
    """`make kills` tries every one; the jobs fork, so they want a process without threads."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.faults.kills", "140"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=150,
    )  # fmt: skip
    last = done.stdout.splitlines()[-1]
    cases, held = (int(word) for word in last.split() if word.isdigit())
    assert cases == held > 15, done.stdout + done.stderr
