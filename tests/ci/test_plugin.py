"""The built wheel in a fresh environment, in a project whose own folders are called as ours are."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
import venv
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from tests.command import ROOT

CI = ROOT / "examples" / "ci"
pytestmark = pytest.mark.xdist_group("wheel")


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the built wheel; what that needs is this one's."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT, check=True, capture_output=True, timeout=150,
    )  # fmt: skip
    (wheel,) = folder.glob("*.whl")
    home = folder / "venv"
    venv.create(home, symlinks=os.name != "nt")
    names = {"base": str(home), "platbase": str(home)}
    packages = Path(sysconfig.get_path("purelib", "venv", names))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    # a .pth in a folder that a .pth names is not read: this project's own does not come along
    (packages / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    scripts = Path(sysconfig.get_path("scripts", "venv", names))
    return scripts / ("python.exe" if os.name == "nt" else "python")


def run(python: Path, folder: Path, *words: str, **environment: str) -> str:
    """Standard output of a module run there."""
    hidden = ("PYTHONPATH", "TWORELAY_HOME", "TWORELAY_COMMAND", "PYTEST_ADDOPTS")
    kept = {k: v for k, v in os.environ.items() if k not in hidden}
    done = subprocess.run(
        [str(python), *words], cwd=folder, env={**kept, **environment}, capture_output=True,
        text=True, timeout=170, stdin=subprocess.DEVNULL, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    return done.stdout


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A machine builder's, with folders and a module that are called as ours are."""
    folder = tmp_path / "machine"
    shutil.copytree(CI, folder)
    for name in ("drivers", "profiles", "commissioning"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("OURS = False\n")
    (folder / "pytest.ini").write_text("[pytest]\npythonpath = .\ntworelay_fleet = line.toml\n")
    (folder / "test_own.py").write_text(
        "import drivers, profiles\n\n"
        "def test_the_projects_own_folders_are_its_own(fleet_axis, tworelay_home):\n"
        "    assert not drivers.OURS and not profiles.OURS\n"
        "    assert fleet_axis.name in ('gantry-x', 'table')\n"
    )
    return folder


@pytest.mark.parametrize(
    ("words", "says"),
    [(("-n", "2"), "8 passed"), (("-p", "no:xdist", "-k", "own or line or told"), "5 passed")],
    ids=["with xdist", "without"],
)
def test_a_foreign_project_runs_its_tests(
    python: Path, project: Path, words: tuple[str, ...], says: str
) -> None:
    pytest_there = ["-m", "pytest", "-q", "-p", "no:cacheprovider"]
    said = run(python, project, *pytest_there, *words, CI="true", PYTHONPATH=str(project))
    assert says in said
    assert "warning" not in said


def test_the_wheel_is_the_one_that_is_tried(python: Path, project: Path) -> None:
    code = "import pytest_tworelay; print(pytest_tworelay.__file__)"
    said = run(python, project, "-P", "-c", code)
    assert not Path(said.strip()).is_relative_to(ROOT)


def commands(file: Path) -> list[str]:
    """What a CI file lets run, without what installs."""
    text = file.read_text("utf-8")
    if file.name == ".gitlab-ci.yml":
        block = text.split("  script:\n")[1].split("  artifacts:")[0]
        found = [line.strip()[2:] for line in block.splitlines()]
    else:
        found = re.findall(r"^\s+run: (.+)$", text, re.MULTILINE)
    return [one for one in found if not one.startswith("pip ")]


def test_the_examples_for_ci_run(python: Path, tmp_path: Path) -> None:
    folder = tmp_path / "line"
    shutil.copytree(CI, folder)
    lines = commands(CI / ".gitlab-ci.yml")
    assert commands(CI / ".github" / "workflows" / "commissioning.yml") == lines
    assert [line.split()[0] for line in lines] == ["tworelay", "tworelay", "pytest"]
    home = {"TWORELAY_HOME": str(tmp_path / "home"), "CI": "true"}
    for line in lines:
        module, *words = shlex.split(line)
        if module == "pytest":  # the plugin's own tests are the other test
            words += ["-k", "press_has_the_friction"]
        module = "commissioning" if module == "tworelay" else module
        run(python, folder, "-m", module, *words, **home)
    for report in ("identify.xml", "fleet.xml", "pytest.xml"):
        suites = ET.parse(folder / report).getroot()
        assert len(list(suites.iter("testcase"))) >= 1
        assert not list(suites.iter("failure"))


def test_what_is_wrong_is_told_in_a_line(python: Path, project: Path) -> None:
    for path in project.glob("test_*.py"):
        path.unlink()
    (project / "test_wrong.py").write_text(
        "import pytest\n\n"
        "def test_no_such_axis(virtual_drive):\n    virtual_drive('bensh')\n\n"
        "def test_exit_code(tworelay):\n    tworelay('identify', 'nowhere').check()\n\n"
        "@pytest.mark.fleet('absent.toml')\ndef test_fleet(fleet_axis):\n    pass\n"
    )
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "axis or code"]
    with pytest.raises(AssertionError) as caught:
        run(python, project, *words, "--deselect", "test_wrong.py::test_fleet")
    assert "absent.toml: cannot be read as a fleet file" in str(caught.value)
    (project / "test_wrong.py").write_text(
        (project / "test_wrong.py").read_text().split("@pytest.mark.fleet")[0]
    )
    with pytest.raises(AssertionError) as caught:
        run(python, project, *words)
    said = str(caught.value)
    assert "did you mean 'bench'?" in said
    assert "tworelay identify nowhere: exit code 2" in said
    assert "Traceback" not in said
    with pytest.raises(AssertionError) as caught:
        run(python, project, *words, TWORELAY_COMMAND="no-such-command")
    said = str(caught.value)
    assert "TWORELAY_COMMAND: there is no program 'no-such-command'" in said
    assert "Traceback" not in said


@pytest.mark.skipif(os.name == "nt", reason="there is no such signal")
def test_a_drive_ends_with_the_tests_however_they_end(
    python: Path, project: Path, tmp_path: Path
) -> None:
    """CI ends a job with SIGTERM, and its children with nothing."""
    told = tmp_path / "link"
    (project / "test_long.py").write_text(
        "import time\n\ndef test_long(virtual_drive):\n"
        f"    open({str(told)!r}, 'w').write(str(virtual_drive('bench').process.pid))\n"
        "    time.sleep(60)\n"
    )
    words = [str(python), "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_long.py"]
    with subprocess.Popen(words, cwd=project, stdout=subprocess.DEVNULL) as tests:
        wait_for(lambda: told.exists() and told.read_text().isdigit())
        drive = psutil.Process(int(told.read_text()))
        tests.kill()
    wait_for(lambda: not drive.is_running() or drive.status() == psutil.STATUS_ZOMBIE)


def wait_for(happened: Callable[[], bool], patience: float = 60.0) -> None:
    until = time.monotonic() + patience
    while not happened():
        assert time.monotonic() < until
        time.sleep(0.05)
