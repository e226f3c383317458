"""Draws the Mermaid diagrams of docs/*.md as pictures, light and dark: `make diagrams`. Needs npm and a Chromium.

Pages of the site then ask nothing of other servers, and need no script to show a diagram.
"""

import html
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

from docs.site_pages import DIAGRAMS, diagram_name

DOCS = Path(__file__).parent
MERMAID = "mermaid@11.17.2"
_FENCE = re.compile(r"^```mermaid\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_THEMES = {"light": "neutral", "dark": "dark"}
_WAIT_MS = 20_000
_PAGE = """<!doctype html><meta charset="utf-8"><pre id="source">{source}</pre>
<script src="mermaid.min.js"></script><script>
mermaid.initialize({{startOnLoad: false, theme: "{theme}", fontFamily: "Helvetica, Arial, sans-serif",
  htmlLabels: false, flowchart: {{htmlLabels: false, wrappingWidth: 230}}}});
mermaid.render("diagram", document.getElementById("source").textContent)
  .then(({{svg}}) => {{ document.body.innerHTML = svg; }})
  .catch(error => {{ document.body.textContent = "ERROR " + error.message; }});
</script>"""


def main() -> None:
    """Draw what has changed, and remove the pictures of diagrams that are gone."""
    folder = DOCS / DIAGRAMS
    folder.mkdir(parents=True, exist_ok=True)
    wanted = {folder / f"{diagram_name(source)}_{scheme}.svg": (source, scheme) for source, scheme in _diagrams()}
    for file in set(folder.glob("*.svg")) - set(wanted):
        file.unlink()
    missing = {file: what for file, what in wanted.items() if not file.is_file()}
    if not missing:
        return
    with tempfile.TemporaryDirectory() as place:
        room = Path(place)
        _unpack_mermaid(room)
        for file, (source, scheme) in missing.items():
            file.write_text(_drawn(source, scheme, room), encoding="utf-8")
            print(file.relative_to(DOCS.parent))


def _diagrams() -> Iterator[tuple[str, str]]:
    for page in sorted(DOCS.rglob("*.md")):
        for source in _FENCE.findall(page.read_text(encoding="utf-8")):
            yield from ((source, scheme) for scheme in _THEMES)


def _unpack_mermaid(room: Path) -> None:
    subprocess.run(["npm", "pack", "--silent", MERMAID], cwd=room, check=True, stdout=subprocess.DEVNULL)
    with tarfile.open(next(room.glob("*.tgz"))) as package:
        script = package.extractfile("package/dist/mermaid.min.js")
        assert script is not None
        (room / "mermaid.min.js").write_bytes(script.read())


def _drawn(source: str, scheme: str, room: Path) -> str:
    page = room / "page.html"
    page.write_text(_PAGE.format(source=html.escape(source), theme=_THEMES[scheme]), encoding="utf-8")
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("make diagrams needs chromium on the path")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={room}/browser", "--dump-dom"]
    command = [browser, *flags, f"--virtual-time-budget={_WAIT_MS}", page.as_uri()]
    dom = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = re.search(r"<svg.*</svg>", dom, re.DOTALL)
    if found is None:
        sys.exit(f"Mermaid could not draw a diagram: {re.sub('<[^>]*>', '', dom)[-300:].strip()}")
    return found[0].replace("<br>", "<br/>") + "\n"


if __name__ == "__main__":
    main()
