"""Draw the window's icons from the SVG files beside this one; needs `pip install resvg-py`."""

from pathlib import Path

import resvg_py

HERE = Path(__file__).parent
SIZES = {"gsrain-small.svg": (16, 24), "gsrain.svg": (32, 48, 64, 256)}
"""Side lengths in px by drawing: below 32 px only a drop and one contour can be told apart."""


def draw_icons(folder: Path) -> None:
    """Write `SIZE.png` for each size into `folder`."""
    folder.mkdir(exist_ok=True)
    for drawing, sizes in SIZES.items():
        for size in sizes:
            picture = resvg_py.svg_to_bytes(svg_string=(HERE / drawing).read_text("utf-8"), width=size, height=size)
            (folder / f"{size}.png").write_bytes(bytes(picture))


if __name__ == "__main__":
    draw_icons(HERE.parent / "app" / "icons")
