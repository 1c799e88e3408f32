"""The report in a real browser: it draws, zooms, says no error, and asks nobody for anything."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from tests.conftest import Tworelay

NAMES = "chromium", "chromium-browser", "google-chrome"
BROWSER = next((found for name in NAMES if (found := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
_PATIENCE = 60.0  # s
_ERRORS = "Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled"


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """Where a browser listens."""
    assert BROWSER is not None
    process = subprocess.Popen(
        [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0",
            f"--user-data-dir={tmp_path / 'browser'}", "--window-size=1100,1400", "about:blank",
        ],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    try:
        yield next(line.split()[-1] for line in process.stderr if "DevTools listening" in line)
    finally:
        process.terminate()
        process.communicate(timeout=30)


class Page:
    """One page of the browser, and what it has told."""

    def __init__(self, line: WebSocketClientConnection) -> None:
        self._line = line
        self._number = 0
        self.session: str | None = None
        self.events: list[dict[str, Any]] = []

    async def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        number = self._number
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self.session is not None:
            message["sessionId"] = self.session
        await self._line.write_message(json.dumps(message))
        while True:
            text = await asyncio.wait_for(self._line.read_message(), _PATIENCE)
            assert text is not None
            heard = json.loads(text)
            if heard.get("id") == number:
                assert "error" not in heard, heard
                return dict(heard["result"])
            self.events.append(heard)

    async def value(self, script: str) -> Any:
        told = await self.ask("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in told, told
        return told["result"].get("value")

    async def until(self, script: str) -> None:
        for _ in range(int(_PATIENCE * 10)):
            if await self.value(script):
                return
            await asyncio.sleep(0.1)
        pytest.fail(f"never true: {script}")

    def told(self, *methods: str) -> list[dict[str, Any]]:
        return [event["params"] for event in self.events if event.get("method") in methods]


# bokeh's own pictures, also those within shadows; the ends of the first one's time; its place
VIEWS = """(() => { const found = []; const walk = v => {
 if (v.model.type === "Figure") found.push(v); (v.child_views || []).forEach(walk); };
 (Bokeh.index.roots || Object.values(Bokeh.index)).forEach(walk); return found; })()"""
ENDS = f"(() => {{ const r = {VIEWS}[0].model.x_range; return [r.start, r.end]; }})()"
BOX = f"""(() => {{ const e = {VIEWS}[0].el; e.scrollIntoView({{block: "center"}});
 const r = e.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; }})()"""
LINKED = f"{VIEWS}.filter(v => v.model.x_range === {VIEWS}[0].model.x_range).length"


async def looked_at(address: str, path: Path, *, dark: bool, width: int) -> None:
    line = await websocket_connect(address, max_message_size=1 << 28)
    try:
        await driven(Page(line), path, dark=dark, width=width)
    finally:
        line.close()
        while await line.read_message() is not None:
            pass


async def driven(page: Page, path: Path, *, dark: bool, width: int) -> None:
    target = await page.ask("Target.createTarget", url="about:blank")
    attached = await page.ask("Target.attachToTarget", targetId=target["targetId"], flatten=True)
    page.session = attached["sessionId"]
    for domain in ("Page", "Runtime", "Log", "Network"):
        await page.ask(f"{domain}.enable")
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    await page.ask("Emulation.setEmulatedMedia", features=[scheme])
    await page.ask(
        "Emulation.setDeviceMetricsOverride", width=width, height=1400, deviceScaleFactor=1,
        mobile=False,
    )  # fmt: skip
    await page.ask("Page.navigate", url=path.as_uri())
    await page.until("typeof Bokeh !== 'undefined' && Bokeh.documents.length > 0")
    await page.until(f"{VIEWS}.length >= 5")
    await page.until(f"Number.isFinite({ENDS}[1])")
    assert await page.value("document.documentElement.scrollWidth") <= width, "nothing sticks out"
    before = await page.value(ENDS)
    box = await page.value(BOX)
    x, y = box[0] + 0.4 * box[2], box[1] + 0.5 * box[3]
    await asyncio.sleep(0.3)
    moves = (("mousePressed", 0), ("mouseMoved", 0.1), ("mouseMoved", 0.2), ("mouseReleased", 0.2))
    for kind, share in moves:
        await page.ask(
            "Input.dispatchMouseEvent", type=kind, x=x + share * box[2], y=y + share * box[3] / 2,
            button="left", buttons=1, clickCount=1,
        )  # fmt: skip
    shorter = (before[1] - before[0]) * 0.8
    await page.until(f"(() => {{ const e = {ENDS}; return e[1] - e[0] < {shorter}; }})()")
    assert await page.value(LINKED) == 3, "position, torque and velocity move together"
    errors = [
        told for told in page.told(*_ERRORS)
        if told.get("entry", {}).get("level") == "error" or "exceptionDetails" in told
        or told.get("type") == "error"
    ]  # fmt: skip
    assert errors == []
    asked = [told["request"]["url"] for told in page.told("Network.requestWillBeSent")]
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_the_report_in_a_browser(
    address: str, tworelay: Tworelay, after: Tworelay, tmp_path: Path
) -> None:
    assert after("commission", "virtual://bench", "--yes").returncode == 0
    path = Path(tworelay("report", "last", "--output", str(tmp_path / "r.html")).stdout.strip())
    for dark, width in ((False, 1100), (True, 390)):
        asyncio.run(looked_at(address, path, dark=dark, width=width))
