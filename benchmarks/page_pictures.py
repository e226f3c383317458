"""Pictures of `gsrain publish` in headless Chromium against those of `gsrain render`, in dB, and the page's size."""

import argparse
import base64
import io
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from tests.browser import browser

SIZE_PX = 960, 640


def gsrain(*words: str | Path) -> None:
    """Run the command line as a user does. Raises CalledProcessError where it fails."""
    subprocess.run([sys.executable, "-m", "app", *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default="street")
    parser.add_argument("--rain", type=float, nargs="+", default=[0.0, 8.5, 50.0], help="mm/h")
    parser.add_argument("--time", type=float, default=1.5, help="s")
    arguments = parser.parse_args()
    rows: list[dict[str, float]] = []
    size = "{}x{}".format(*SIZE_PX)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written = folder / "rain.html"
        gsrain("publish", arguments.scene, "-o", written)
        with browser(folder) as page:
            page.open(written, *SIZE_PX)
            page.run("gsrain.ready.then(() => true)")
            for mm_h in arguments.rain:
                script = f"gsrain.image({{mm: {mm_h:g}, t: {arguments.time}, split: 0, size: '{size}'}})"
                data = base64.b64decode(page.run(script).split(",")[1])
                rendered = folder / f"{mm_h:g}.png"
                words = ("--rain", f"{mm_h:g}", "--time", f"{arguments.time}", "--size", size, "--backend", "cpu")
                gsrain("render", arguments.scene, *words, "-o", rendered)
                theirs, ours = (
                    np.asarray(Image.open(source).convert("RGB"), float) for source in (io.BytesIO(data), rendered)
                )
                error = float(np.mean((theirs - ours) ** 2))
                rows.append({"rain_mm_h": mm_h, "psnr_db": round(10 * np.log10(255**2 / error), 1)})
        print(json.dumps({"megabytes": round(written.stat().st_size / 1e6, 2), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
