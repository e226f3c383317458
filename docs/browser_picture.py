"""Takes the picture of the window in a browser: python -m docs.browser_picture (needs viser and Chromium)."""

import base64
import sys
import tempfile
import time
from io import BytesIO
from pathlib import Path

from PIL import Image

import gsrain as gr

ROOT = Path(__file__).resolve().parent.parent
_SIZE_PX = (1440, 810)
_WAIT_S, _SETTLED_S = 300.0, 10.0
_CLOSE_NOTICE = "document.querySelectorAll('.mantine-Notification-closeButton').forEach(each => each.click())"


def main() -> None:
    """Write docs/images/browser.jpg."""
    sys.path.insert(0, str(ROOT / "tests"))
    from browser import browser

    file = ROOT / "docs" / "images" / "browser.jpg"
    rain = gr.Rain(8.5)
    with (
        gr.BrowserViewer(gr.wet(gr.load("street")), rain, port=0) as window,
        tempfile.TemporaryDirectory() as profile,
        browser(Path(profile)) as page,
    ):
        page.open(window.url, *_SIZE_PX)
        began = time.monotonic()
        while window.pictures == 0 and time.monotonic() < began + _WAIT_S:
            time.sleep(0.1)
        page.run(_CLOSE_NOTICE)  # of a browser without a GPU
        time.sleep(_SETTLED_S)
        with Image.open(BytesIO(base64.b64decode(page.screenshot()))) as picture:
            picture.convert("RGB").save(file, quality=88, optimize=True)
    print(f"wrote {file}")


if __name__ == "__main__":
    main()
