"""Renders the pictures of README and guide that need no window: rain at three intensities, and every look."""

import tempfile
from pathlib import Path
from typing import get_args

from PIL import Image, ImageDraw, ImageFont

from app.main import run
from gsrain_engine.recolor.recolor import wet_scene
from gsrain_engine.render.renderer import RenderMode
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.open import load_scene
from gsrain_engine.scene.progress import run_to_end

IMAGES = Path(__file__).parent / "images"
_INTENSITIES_MM_H = ("1.2", "8.5", "12.0")
_MOMENT_S = "1.6"
"""A lorry stands near, and the car ahead is well in view."""
_LOOKS_IN_A_ROW = 4
_QUALITY = 88


def still(scene: str, folder: Path, size: str, *options: str) -> Image.Image:
    """Render a scene by the command that a reader would give."""
    file = folder / "still.png"
    code = run(["render", scene, "-o", str(file), "--size", size, "--time", _MOMENT_S, *options])
    if code != 0:
        raise SystemExit(code)
    with Image.open(file) as picture:
        return picture.convert("RGB")


def keep(picture: Image.Image, name: str) -> None:
    """Write a picture where the pages look for it."""
    IMAGES.mkdir(exist_ok=True)
    picture.save(IMAGES / f"{name}.jpg", quality=_QUALITY, optimize=True)
    print(f"docs/images/{name}.jpg", flush=True)


def render_rain(folder: Path) -> None:
    """The street in its wet look, in light, heavy and very heavy rain."""
    write_scene(run_to_end(wet_scene(load_scene("street"))), folder / "wet")
    for intensity in _INTENSITIES_MM_H:
        keep(still(str(folder / "wet"), folder, "960x640", "--rain", intensity, "--wetness", "1"), f"rain_{intensity}")


def render_looks(folder: Path) -> None:
    """All looks of one moment on one sheet, each with its name."""
    looks = get_args(RenderMode)
    width, height = 330, 220
    rows = -(-len(looks) // _LOOKS_IN_A_ROW)
    sheet = Image.new("RGB", (width * _LOOKS_IN_A_ROW, height * rows))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(13)
    for place, look in enumerate(looks):
        left, top = width * (place % _LOOKS_IN_A_ROW), height * (place // _LOOKS_IN_A_ROW)
        sheet.paste(still("street", folder, f"{width}x{height}", "--mode", look, "--rain", "0"), (left, top))
        corner = (left + 6, top + height - 8)
        draw.text(corner, look, "white", font, anchor="ls", stroke_width=2, stroke_fill="black")
    keep(sheet, "looks")


def main() -> None:
    """Render all of them."""
    with tempfile.TemporaryDirectory() as folder:
        render_rain(Path(folder))
        render_looks(Path(folder))


if __name__ == "__main__":
    main()
