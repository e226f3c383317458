"""Headless Chromium for tests of web pages, over its debugging pipe."""

import itertools
import json
import os
import shutil
import subprocess
from collections.abc import Generator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--remote-debugging-pipe",
)  # fmt: skip


class Page:
    """One open page."""

    def __init__(self, to_browser: int, answers: BufferedReader) -> None:
        self._to, self._from = to_browser, answers
        self._numbers = itertools.count(1)
        self._unread = b""
        self._session: str | None = None

    def open(self, page: Path | str, width: int = 960, height: int = 640) -> None:
        """Open a file or an address, and wait until it has loaded."""
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._call("Page.enable")
        self.size(width, height)
        self._call("Page.navigate", url=page if isinstance(page, str) else page.as_uri())
        self.run("new Promise(done => document.readyState === 'complete' ? done() : addEventListener('load', done))")

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression; awaited if it is a promise. Raises RuntimeError for an exception."""
        answer = self._call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"])[:2000])
        return answer["result"].get("value")

    def size(self, width: int, height: int) -> None:
        self._call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def screenshot(self) -> str:
        """PNG of the page in base64."""
        return self._call("Page.captureScreenshot", format="png")["data"]

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self._unread:
                more = self._from.read1(1 << 20)
                if not more:
                    raise RuntimeError("the browser has ended")
                self._unread += more
            text, self._unread = self._unread.split(b"\0", 1)
            answer = json.loads(text)
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]


@contextmanager
def browser(profile: Path) -> Generator[Page]:
    """Start Chromium with an empty profile in a folder."""
    assert CHROMIUM is not None
    read_end, to_browser = os.pipe()
    from_browser, write_end = os.pipe()

    # Chromium reads from 3 and writes to 4.
    start = f'exec "$@" 3<&{read_end} 4>&{write_end}'
    process = subprocess.Popen(
        ["bash", "-c", start, "bash", CHROMIUM, *_OPTIONS, f"--user-data-dir={profile}"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, pass_fds=(read_end, write_end),
    )  # fmt: skip
    os.close(read_end)
    os.close(write_end)
    with os.fdopen(from_browser, "rb") as answers:
        try:
            yield Page(to_browser, answers)
        finally:
            process.kill()
            process.wait()
            os.close(to_browser)
