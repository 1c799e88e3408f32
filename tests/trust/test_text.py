"""What others wrote acts on no terminal.

An escape in any field is shown as one on every way out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commissioning.cli import output
from commissioning.cli.terminal import Screen
from profiles.dcf import dcf
from profiles.library import load_profile, source_text
from profiles.plain import plain, plain_lines
from tests.command import ROOT, in_process
from tests.conftest import Serve, Tworelay

EVIL = "\x1b]0;owned\x07\x1b[2J\u202egnp\u2028\x9b31m\x7f"
SEEN = r"\x1b]0;owned\x07\x1b[2J\u202egnp\u2028\x9b31m\x7f"


def acts(text: str) -> list[str]:
    """Characters on which a terminal or an editor acts, ours not counted."""
    spaces = "\n\t\u00a0\u202f\u2009\u2002"
    return [c for c in text if not c.isprintable() and c not in spaces]


def test_a_text_is_shown_as_it_is_and_what_acts_as_an_escape() -> None:
    assert (
        plain("Coulomb friction ±0,5 N·m – größer 日本")
        == "Coulomb friction ±0,5 N·m – größer 日本"
    )
    assert plain(EVIL) == SEEN
    assert plain("a\nb\tc\r") == r"a\nb\tc\r"
    assert plain_lines("a\nb\tc\r\x1b") == "a\nb\tc\\r\\x1b"
    assert plain("\ud800") == r"\ud800"


def test_lines_tables_titles_and_questions_are_plain(capsys: pytest.CaptureFixture[str]) -> None:
    screen = Screen(None, yes=True)
    screen.say(EVIL)
    screen.table(EVIL, ["a", EVIL], [[EVIL, "[bold]x"]])
    screen.confirm(EVIL, EVIL)
    output.say(EVIL, err=True)
    output.document(f"a\n{EVIL}\n")
    told = capsys.readouterr()
    assert not acts(told.out + told.err)
    assert told.out.count("owned") >= 5
    assert "[bold]x" in told.out


def planted(tree: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where there is a text."""
    if isinstance(tree, dict):
        for key, item in tree.items():
            yield from planted(item, (*way, key))
    elif isinstance(tree, list):
        for k in sorted({0, len(tree) - 1}) if tree else ():
            yield from planted(tree[k], (*way, k))
    elif isinstance(tree, str):
        yield way


@pytest.fixture
def sent(after: Tworelay, tworelay: Tworelay, tmp_path: Path) -> Path:
    """A tuned run of another computer."""
    assert after("tune", "virtual://bench", "--yes").returncode == 0
    folder = tmp_path / "sent"
    assert tworelay("export", "last", str(folder)).returncode == 0
    return folder


def test_an_escape_in_every_field_of_a_run(tworelay: Tworelay, sent: Path, tmp_path: Path) -> None:
    trees = {name: json.loads((sent / name).read_text()) for name in ("run.json", "journal.json")}
    other = {"TWORELAY_HOME": str(tmp_path / "other")}
    fields = 0
    for name, tree in trees.items():
        text = json.dumps(tree)
        for way in planted(tree):
            changed = place = json.loads(text)
            for key in way[:-1]:
                place = place[key]
            place[way[-1]] += EVIL
            (sent / name).write_text(json.dumps(changed))
            fields += 1
            done = tworelay("adopt", str(sent), environment=other)
            assert not acts(done.stdout + done.stderr), way
            assert len(done.stderr.splitlines()) <= 1, way
        (sent / name).write_text(text)
    assert fields > 60

    def everywhere(tree: Any) -> Any:  # where any text is allowed
        if isinstance(tree, dict):
            keep = {
                "schema",
                "status",
                "loop",
                "source",
                "verdict",
                "how",
                "kind",
                "state",
                "position",
                "weight",
                "ending",
            }
            return {
                k: v if k in keep and isinstance(v, str | dict) else everywhere(v)
                for k, v in tree.items()
            }
        if isinstance(tree, list):
            return [everywhere(item) for item in tree]
        return tree + EVIL if isinstance(tree, str) else tree

    for name, tree in trees.items():
        (sent / name).write_text(json.dumps(everywhere(tree)))
    out = tmp_path / "out"
    for words in (
        ["report", str(sent)], ["plot", "loci", str(sent)], ["export", str(sent), str(out)],
        ["tune", str(sent)], ["apply", str(sent), "--yes"], ["adopt", str(sent)], ["restore",
        str(sent)],
    ):  # fmt: skip
        done = tworelay(*words, environment=other)
        assert not acts(done.stdout + done.stderr), words
    page = (sent / "report.html").read_text("utf-8")
    assert not acts(page)
    assert "owned" in page
    assert "default-src 'none'" in page
    assert not acts((sent / "loci.svg").read_text("utf-8"))
    for path in out.iterdir():
        if path.suffix in (".csv", ".json", ".dcf"):
            assert not acts(path.read_text("utf-8")), path


@pytest.mark.parametrize("kind", ["csv", "mat"])
def test_an_escape_in_the_columns_of_a_recording(
    tworelay: Tworelay, tmp_path: Path, kind: str
) -> None:
    path = tmp_path / f"r{EVIL.replace('/', '')}.{kind}"
    if kind == "csv":
        rows = "".join(f"{k},{k % 7},{k % 5}\n" for k in range(60))
        path.write_text(f"t{EVIL.replace(chr(0x2028), '')},x,y\n{rows}")
    else:
        import scipy.io

        name = "t" + EVIL.replace("\u202e", "").replace("\u2028", "").replace("\x9b", "")
        scipy.io.savemat(path, {"x": np.arange(60.0), name: np.arange(60.0)})
    for words in ([], ["--time", EVIL], ["--time", f"x:{EVIL}"], ["--method", EVIL]):
        done = tworelay("analyze", str(path), *words)
        assert done.returncode == 2
        assert not acts(done.stdout + done.stderr)
        assert len(done.stderr.splitlines()) == 1


def test_an_escape_in_what_is_typed(tworelay: Tworelay, tmp_path: Path) -> None:
    for words in (
        [EVIL], ["identify", EVIL], ["identify", f"virtual://{EVIL}"],
        ["identify", "virtual://bench", f"--{EVIL}"],
        ["identify", "virtual://bench", "--profile", EVIL], ["identify", f"{EVIL}.toml"],
        ["report", EVIL],
        ["restore", EVIL], ["profile", "show", EVIL], ["profile", "check", f"{EVIL}.toml"],
        ["virtual", "serve", EVIL], ["scan", f"modbus-tcp://{EVIL}"], ["export", EVIL,
        str(tmp_path)],
        ["virtual", "serve", "bench", "--modbus-tcp", EVIL], ["adopt", EVIL], ["doctor", f"canopen://{EVIL}"],
    ):  # fmt: skip
        done = tworelay(*words)
        assert done.returncode in (2, 3), (words, done.stdout)
        assert not acts(done.stdout + done.stderr), words
        assert len(done.stderr.splitlines()) == 1, words


def test_an_escape_in_a_profile_and_what_is_made_of_it(tworelay: Tworelay, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    said = EVIL.encode("unicode_escape").decode().replace("\\x", "\\u00")
    text = source_text("virtual-modbus").replace('title = "', f'title = "{said}')
    path.write_text(text)
    for words in (["profile", "show", str(path)], ["profile", "check", str(path)],
                  ["identify", "virtual://bench", "--profile", str(path), "--yes"]):  # fmt: skip
        done = tworelay(*words)
        assert done.returncode == 0, done.stderr
        assert not acts(done.stdout + done.stderr), words
    profile = load_profile("virtual-canopen")
    titled = profile.model_copy(update={"title": f"x\n[6040]\n{EVIL}"})
    assert not acts(dcf(titled, {"coulomb_positive": 1}, 5))
    assert "\n[6040]" not in dcf(titled, {"coulomb_positive": 1}, 5)


def test_an_escape_in_what_a_drive_says(
    serve: Serve, tworelay: Tworelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    from drivers.modbus.client import Client

    monkeypatch.setattr(Client, "identification", lambda client: {0: EVIL, 1: EVIL, 2: EVIL})
    link = serve("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "step")[0]
    for words in (
        ["identify", link, "--yes"], ["scan", link.partition("?")[0], "--units", "1"], ["doctor",
        link],
        ["stop", link],
    ):  # fmt: skip
        done = tworelay(*words)
        assert "owned" in done.stdout + done.stderr or words[0] == "doctor", words
        assert not acts(done.stdout + done.stderr), words


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is full")
def test_a_full_device_does_not_undo_a_job_that_was_done(tmp_path: Path) -> None:
    home = {"TWORELAY_HOME": str(tmp_path / "home")}
    words = ["identify", "virtual://bench", "--yes", "--json"]
    done = in_process(*words, "/dev/full", environment=home)
    assert done.returncode == 0, done.stderr
    assert "--json /dev/full: cannot be written: No space left on device; run 2" in done.stderr
    for more in ([*words, "-"], ["commission", "virtual://bench", "--yes"], ["profile", "list"]):
        with Path("/dev/full").open("w") as full:
            cut = subprocess.run(
                [sys.executable, "-m", "commissioning", *more], stdout=full, stderr=subprocess.PIPE,
                cwd=ROOT, env={**os.environ, **home}, stdin=subprocess.DEVNULL, check=False,
                text=True,
            )  # fmt: skip
        assert cut.returncode == 0, cut.stderr
        assert "standard output takes no more: No space left on device" in cut.stderr
