"""A fleet run at a terminal: its table, its questions, and what is typed."""

from __future__ import annotations

import os
import re
import select
import sys
import time
from pathlib import Path

import pytest

from tests.command import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs a pseudo-terminal")
PATIENCE = 100.0  # s


def typed(arguments: list[str], answers: list[tuple[str, bytes]]) -> tuple[str, int]:
    """What a command shows on a terminal, and its exit code; each answer after its question."""
    import pty

    pid, terminal = pty.fork()
    if not pid:
        os.chdir(ROOT)
        os.environ |= {"TERM": "xterm", "COLUMNS": "140"}
        os.execv(sys.executable, [sys.executable, "-m", "commissioning", *arguments])
    shown, seen, until = b"", 0, time.monotonic() + PATIENCE
    try:
        while time.monotonic() < until:
            if not select.select([terminal], [], [], 0.1)[0]:
                continue
            try:
                new = os.read(terminal, 65536)
            except OSError:
                break
            shown += new
            if answers and answers[0][0].encode() in shown[seen:]:
                seen = len(shown)
                os.write(terminal, answers.pop(0)[1])
    finally:
        os.close(terminal)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode("utf-8", "replace"))
    return text, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def test_a_word_is_asked_for_again_and_enter_says_no(tmp_path: Path) -> None:
    path = tmp_path / "line.toml"
    path.write_text(
        'job = "identify"\nconfirm = "group"\n[groups.gantry]\n'
        '[[axes]]\nname = "x"\nlink = "virtual://bench?seed=1"\ngroup = "gantry"\n'
        '[[axes]]\nname = "z"\nlink = "virtual://bench?seed=3"\n'
    )
    shown, code = typed(
        ["fleet", "run", str(path)],
        [("Type x", b"y\n"), ("Type x", b"x\n"), ("Type z", b"\n")],
    )
    assert code == 9, shown
    assert "'x' up to ±3.142 rad about its present position" in shown
    assert "that is not x" in shown
    assert "not confirmed: nothing was moved" in shown
    assert "running: " in shown
    assert "finished: 1 done, 1 refused" in shown


def test_a_closed_input_leaves_all_to_be_resumed(tmp_path: Path) -> None:
    path = tmp_path / "line.toml"
    path.write_text(
        'job = "identify"\nconfirm = "each"\n[[axes]]\nname = "x"\nlink = "virtual://bench"\n'
    )
    shown, code = typed(["fleet", "run", str(path)], [("Type x", b"\x04")])
    assert code == 3, shown
    assert "nobody is at the terminal" in shown
    assert "--resume" in shown
