"""The product as it is delivered: README, wheel, JSON Schema, report, help."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from html.parser import HTMLParser
from pathlib import Path

import jsonschema
import pytest

from tests.command import ROOT
from tests.conftest import Serve, Tworelay
from tests.serving import WIRES

SCHEMA = json.loads((ROOT / "docs" / "run.schema.json").read_text("utf-8"))


def readme_commands() -> list[str]:
    """Every `$ tworelay …` of the README that needs no machine."""
    text = (ROOT / "README.md").read_text("utf-8")
    found = re.findall(r"^\$ tworelay ([^#\n]+)", text, re.MULTILINE)
    return [line.strip() for line in found]


def test_the_readme_s_first_screen_has_the_two_commands() -> None:
    first = (ROOT / "README.md").read_text("utf-8").splitlines()[:15]
    assert any("make demo" in line for line in first)
    assert any("make test" in line for line in first)


def test_the_readme_s_commands_work_in_their_order(tworelay: Tworelay, tmp_path: Path) -> None:
    ran = 0
    for line in readme_commands():
        if any(word in line for word in ("192.168", ".toml", "serve", ".csv", "/dev/", "can0")):
            continue  # a machine, a server or a file: shown, not run
        words = shlex.split(line)
        done = tworelay(*(str(tmp_path / w) if w.endswith(".pdf") else w for w in words))
        assert done.returncode == 0, (line, done.stderr)
        ran += 1
    assert ran >= 4


def test_the_examples_work_in_their_order(tworelay: Tworelay) -> None:
    text = (ROOT / "examples" / "README.md").read_text("utf-8")
    lines = re.findall(r"^\$ tworelay ([^\n]+)", text, re.MULTILINE)
    for line in lines:
        done = tworelay(*shlex.split(line))
        assert done.returncode == 0, (line, done.stderr)
    files = {path.name for path in (ROOT / "examples").glob("*.toml")}
    assert files == set(re.findall(r"examples/(\S+\.toml)", text)), "each is shown"


def test_the_demo_does_the_whole_job_and_names_its_report(tworelay: Tworelay) -> None:
    done = tworelay("demo")
    assert done.returncode == 0, done.stderr
    assert "found against true" in done.stdout
    assert "Coulomb friction" in done.stdout
    off = re.search(r"Coulomb friction .* ([+-][0-9.]+) %", done.stdout)
    assert off is not None
    assert abs(float(off[1])) <= 1.0
    report = re.search(r"^report (\S+)$", done.stdout, re.MULTILINE)
    assert report is not None
    assert "Does it help?" in Path(report[1]).read_text("utf-8")
    taken_back = tworelay("restore", "--yes", "last", "--link", "modbus-tcp://127.0.0.1:1")
    assert taken_back.returncode == 4, "its drive is gone with it"


def test_results_keep_to_the_json_schema(tworelay: Tworelay) -> None:
    good = tworelay("identify", "virtual://bench", "--yes", "--json", "-")
    jsonschema.validate(json.loads(good.stdout), SCHEMA)
    every = tworelay("identify", "virtual://bench", "--method", "all", "--yes", "--json", "-")
    result = json.loads(every.stdout)
    jsonschema.validate(result, SCHEMA)
    assert set(result["methods"]) == {
        "output-error", "modulating", "lock-in", "two-relay", "two-relay-delay", "phase-locked",
    }  # fmt: skip
    page = tworelay("report", "last")
    assert "Modulating functions" in Path(page.stdout.strip()).read_text("utf-8")
    linear = tworelay("identify", "virtual://emps", "--yes", "--json", "-")
    result = json.loads(linear.stdout)
    jsonschema.validate(result, SCHEMA)
    assert result["units"]["effort"] == "N"
    for arguments in (["virtual://bench?coulomb=1.5"], ["virtual://bench", "--travel", "0.001"]):
        bad = tworelay("identify", *arguments, "--yes", "--json", "-")
        assert bad.returncode >= 3
        jsonschema.validate(json.loads(bad.stdout), SCHEMA)
    unreachable = tworelay("identify", "modbus-tcp://127.0.0.1:1", "--yes", "--json", "-")
    assert unreachable.returncode == 4
    jsonschema.validate(json.loads(unreachable.stdout), SCHEMA)


class _Resources(HTMLParser):
    """What a page would fetch, and its visible text."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        is_within = tag == "script" and not values.get("src")
        if tag in ("script", "link", "img", "iframe") and not is_within:
            self.fetched.append(values.get("src") or values.get("href") or tag)

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_the_report_is_one_file_that_needs_nothing_else(
    tworelay: Tworelay, after: Tworelay
) -> None:
    assert after("commission", "virtual://bench", "--yes").returncode == 0
    path = Path(tworelay("report", "last").stdout.strip())
    page = _Resources()
    page.feed(path.read_text("utf-8"))
    assert page.fetched == []
    text = " ".join(" ".join(page.text).split())
    for words in (
        "N·m",
        "oscillator",
        "Friction against speed",
        "What was written",
        "written, read back",
        "coulomb_positive",
    ):
        assert words in text, words
    page_of = path.read_text("utf-8")
    assert page_of.split("<footer>")[0].count("<svg") == 8
    assert len(page_of) < 3_000_000
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page_of)
    assert policy is not None
    assert html.unescape(policy[1]).startswith("default-src 'none';")
    scripts = re.findall(r"<script>(.*?)</script>", page_of, re.DOTALL)
    hashes = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    assert len(scripts) == 3
    assert re.findall(r"'sha256-([^']*)'", html.unescape(policy[1])) == hashes


def test_what_comes_from_outside_is_escaped_in_the_report(
    tworelay: Tworelay, after: Tworelay, tmp_path: Path
) -> None:
    assert after("commission", "virtual://bench", "--yes").returncode == 0
    folder = tmp_path / "exported"
    assert tworelay("export", "last", str(folder)).returncode == 0
    result = json.loads((folder / "run.json").read_text())
    result["identity"]["vendor"] = "<script>alert(1)</script>"
    (folder / "run.json").write_text(json.dumps(result))
    path = tworelay("report", str(folder)).stdout.strip()
    text = Path(path).read_text("utf-8")
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text


def test_a_refused_run_has_a_report_too(tworelay: Tworelay) -> None:
    assert tworelay("identify", "virtual://bench?coulomb=1.5", "--yes").returncode == 6
    done = tworelay("report", "last")
    assert done.returncode == 0, done.stderr
    assert "no motion up to 1 N.m" in Path(done.stdout.strip()).read_text("utf-8")


def test_help_imports_no_heavy_library() -> None:
    code = "import sys; from commissioning.cli import main\ntry: main()\nexcept SystemExit: pass\n"
    heavy = "numpy", "scipy", "pydantic", "pymodbus", "can", "rich"
    code += f"print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code, "--help"], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert done.stdout.strip().endswith("[]")
    assert "commission" in done.stdout


@pytest.mark.parametrize("arguments", [["profile", "list"], ["virtual", "list"]])
def test_lists_for_people_and_machines(tworelay: Tworelay, arguments: list[str]) -> None:
    text, machine = tworelay(*arguments), tworelay(*arguments, "--json")
    names = {item["name"] for item in json.loads(machine.stdout)}
    assert names
    assert all(name in text.stdout for name in names)


def test_a_profile_shown_is_a_profile(tworelay: Tworelay, tmp_path: Path) -> None:
    path = tmp_path / "copy.toml"
    path.write_text(tworelay("profile", "show", "virtual-canopen").stdout)
    done = tworelay("profile", "check", str(path))
    assert done.returncode == 0
    assert "performed on its own twin" in done.stdout


def test_environment_variables_stand_in_for_options(tworelay: Tworelay) -> None:
    done = tworelay(
        "identify", "virtual://bench", "--json", "-",
        environment={"TWORELAY_IDENTIFY_YES": "1", "TWORELAY_IDENTIFY_CYCLE": "0.002"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["experiment"]["cycle"] == 0.002


def test_an_axis_file_carries_link_travel_and_mechanics(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    link = serve("vertical", *WIRES["socketcand"], "--clock", "step")[0]
    path = tmp_path / "press-7-z.toml"
    path.write_text(
        f'link = "{link}"\ntravel = 12.0\ncycle = 0.002\n[mechanics]\nheld_by = "brake"\n'
    )
    done = tworelay("identify", str(path), "--yes", "--json", "-")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["axis"] == "press-7-z"
    assert result["friction"]["coulomb"]["value"] == pytest.approx(0.08, rel=0.08)
    assert result["friction"]["offset"]["value"] == pytest.approx(0.15, abs=0.005)


def test_the_trace_of_a_modbus_run_is_a_pcap_and_of_can_is_candump(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    for wire, check in (("modbus-tcp", _check_pcap), ("socketcand", _check_candump)):
        link = serve("bench", *WIRES[wire], "--clock", "step")[0]
        path = tmp_path / f"{wire}.trace"
        done = tworelay("identify", link, "--travel", "3", "--yes", "--trace", str(path))
        assert done.returncode == 0, done.stderr
        check(path)


def _check_pcap(path: Path) -> None:
    data = path.read_bytes()
    assert data[:4] == b"\xd4\xc3\xb2\xa1"  # 0xA1B2C3D4, little endian
    at, packets, sent = 24, 0, 0
    while at < len(data):
        length = int.from_bytes(data[at + 8 : at + 12], "little")
        assert data[at + 16] == 0x45, "an IPv4 packet"
        sent += data[at + 16 + 12 : at + 16 + 16] == b"\x7f\x00\x00\x01"  # from the client
        at += 16 + length
        packets += 1
    assert at == len(data)
    assert packets > 1000
    assert packets == 2 * sent, "each request once, and each answer once"


def _check_candump(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert len(lines) > 1000
    # as `candump -L` writes them: (seconds.microseconds) interface identifier#data, R for a remote
    # frame
    pattern = re.compile(r"\(\d+\.\d{6}\) can0 [0-9A-F]{3}#(([0-9A-F]{2}){0,8}|R)")
    assert all(pattern.fullmatch(line) for line in lines)


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_wireshark_reads_the_trace_of_a_can_run(
    tworelay: Tworelay, serve: Serve, tmp_path: Path
) -> None:
    link = serve("bench", *WIRES["socketcand"], "--clock", "step")[0]
    path = tmp_path / "can.log"
    assert (
        tworelay("identify", link, "--travel", "3", "--yes", "--trace", str(path)).returncode == 0
    )
    seen = subprocess.run(
        ["tshark", "-r", str(path), "-c", "100"], capture_output=True, text=True, check=True
    )
    assert len(seen.stdout.splitlines()) == 100
    assert "SDO" in seen.stdout


def test_the_wheel_has_all_that_it_needs(tmp_path: Path) -> None:
    build = "from hatchling.build import build_wheel; import sys; print(build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)], capture_output=True, text=True, cwd=ROOT,
        check=True,
    )  # fmt: skip
    wheel = tmp_path / done.stdout.strip().splitlines()[-1]
    folder = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
        assert not [n for n in archive.namelist() if n.startswith(("tests", "benchmarks"))]
    code = "import commissioning; print(commissioning.__file__); "
    code += "from commissioning.cli import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code, "commission", "virtual://bench", "--yes"],
        capture_output=True, text=True, cwd=tmp_path, check=False,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert str(folder) in run.stdout
    assert "report" in run.stdout
