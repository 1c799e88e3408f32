"""make look: every picture that people get, into the folder look/."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from rich.console import Console  # noqa: E402

from commissioning.desk import Desk, Options  # noqa: E402
from commissioning.interruption import Interruption  # noqa: E402
from commissioning.journal import Journal  # noqa: E402
from commissioning.panel.feed import Panel  # noqa: E402
from commissioning.panel.picture import picture  # noqa: E402
from commissioning.panel.process import Ear  # noqa: E402
from commissioning.report.html import render  # noqa: E402
from commissioning.report.pdf import pdf_of  # noqa: E402
from commissioning.runs import RunFolder  # noqa: E402
from commissioning.session.commission import prove_and_store  # noqa: E402
from commissioning.session.identify import identify  # noqa: E402
from drivers.link import axis_of  # noqa: E402
from drivers.sample import Sample  # noqa: E402
from profiles.procedures import Mode  # noqa: E402

LINK = "virtual://epos-screw"
SIZES = (80, 24), (120, 40)
_AT = 0.6  # of the way of a measurement: what the panel is shown at


class Keeping(Panel):
    """A panel that nobody draws; what it would have told is heard here."""

    def __init__(self) -> None:
        super().__init__("commission", to_stderr=False, started=_nobody)
        self.ear = Ear()
        self.kept: list[tuple[dict[str, object], list[tuple[float, float]]]] = []

    def cycle(self, samples: Sequence[Sample], mode: Mode) -> None:
        super().cycle(samples, mode)
        if len(samples) % 40 == 0:
            self._samples, self._mode = samples, mode
            self.ear.hear(json.dumps(self._state()).encode())
            self.kept.append((dict(self.ear.state), list(self.ear.trace)))


def _nobody(*_arguments: str, **_streams: object) -> subprocess.Popen[bytes]:
    raise OSError("nobody draws")


def main() -> None:
    folder = HERE.parent / "look"
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as home:
        os.environ["TWORELAY_HOME"] = home
        with Journal(Path(home)) as journal, Interruption() as interruption:
            panel = Keeping()
            desk = Desk(journal, interruption, _quiet, lambda q, w: True, watcher=panel)
            result = identify(axis_of(LINK), Options(writes=True), desk)
            middle = panel.kept[int(_AT * len(panel.kept))]
            prove_and_store(str(result.run), desk, _quiet, without_watchdog=False)
            proof = panel.kept[-1]
            for name, (state, trace) in (("measuring", middle), ("proving", proof)):
                for width, height in SIZES:
                    console = Console(record=True, width=width, height=height, file=io.StringIO())
                    console.print(picture(state | {"in_real_time": True}, trace, width, height))
                    console.save_svg(
                        str(folder / f"panel-{name}-{width}x{height}.svg"), title="tworelay"
                    )
            history = journal.history(str(result.run))
            run = RunFolder.of(journal, str(result.run))
            shown, samples = run.result(history), run.samples()
            for language in ("en", "de"):
                page = render(shown, samples, history, language)
                (folder / f"report-{language}.html").write_text(page, "utf-8")
                for paper in ("a4", "letter"):
                    data = pdf_of(shown, samples, history, language, paper)
                    (folder / f"report-{language}-{paper}.pdf").write_bytes(data)
    _by_a_browser(folder)
    for path in sorted(folder.iterdir()):
        print(f"{path.stat().st_size:>9}  {path}")


def _quiet(_text: object) -> None:
    return None


def _by_a_browser(folder: Path) -> None:
    """The page at a desk, on a phone, in the dark and in print."""
    browser = next((b for n in ("chromium", "google-chrome") if (b := shutil.which(n))), None)
    if browser is None:
        print("no Chromium: the report is not shown as a browser shows it")
        return
    page = (folder / "report-en.html").as_uri()
    usual = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    usual.append("--virtual-time-budget=8000")
    dark = "--blink-settings=preferredColorScheme=0"
    views: dict[str, list[str]] = {
        "desktop.png": ["--window-size=1100,5200"], "phone.png": ["--window-size=390,6000"],
        "dark.png": ["--window-size=1100,5200", dark],
    }  # fmt: skip
    run: Callable[[list[str]], object] = lambda extra: subprocess.run(  # noqa: E731
        [*usual, *extra, page], capture_output=True, check=False, timeout=120
    )
    for name, extra in views.items():
        run([*extra, f"--screenshot={folder / name}"])
    run([f"--print-to-pdf={folder / 'print.pdf'}", "--no-pdf-header-footer"])


if __name__ == "__main__":
    main()
