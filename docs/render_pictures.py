"""Renders the pictures of README and guide that need no window: rain, its two regions, scenarios, and every look."""

import os
import tempfile
from itertools import islice
from pathlib import Path
from typing import get_args

import av
from PIL import Image, ImageDraw, ImageFont

from app.main import run
from gsrain_engine.choices import RenderMode

IMAGES = Path(__file__).parent / "images"
_INTENSITIES_MM_H, _SHEET_MM_H = ("1.2", "8.5", "12.0"), ("0", "2.5", "8.5", "25", "50")
_MOMENT_S = "1.6"
"""A lorry stands near, and the car ahead is well in view."""
_SCENARIOS = ("cut-in", "stationary-lead")
_SCENARIO_TIMES_S = (0.0, 2.5)
"""The start, and a moment at which the other car is in the ego vehicle's lane or near."""
_LOOKS_IN_A_ROW = 4
_NEAR_AIR = """\
intensity_mm_h: 8.5
haze_region: {minimum_m: [-10, -10, -10], maximum_m: [10, 10, 10]}
"""
"""Rain as around a single object, with 10 m of air: behind it is black, not airlight, before which no rain shows."""
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
    """The street in light, heavy and very heavy rain, in the light and wet colors of rain."""
    for intensity in _INTENSITIES_MM_H:
        keep(still("street", folder, "960x640", "--rain", intensity), f"rain_{intensity}")


def render_sheets(folder: Path) -> None:
    """The street, a capture and a single object, by day and by night: dry, and in rain from moderate to very heavy."""
    render_sheet(folder, "sheet_street", "street")
    render_sheet(folder, "sheet_night", "street:night")
    data = Path(os.environ.get("GSRAIN_TEST_DATA", "../shared/data"))
    if not data.is_dir():
        print(f"{data}: not there, so that the sheets of a capture and of an object stay as they are")
        return
    capture = folder / "capture"
    if run(["reconstruct", str(data / "driving" / "dgp" / "scene_02"), "-o", str(capture)]) != 0:
        raise SystemExit(1)
    render_sheet(folder, "sheet_capture", str(capture), "--wet", "--cameras", "CAMERA_01")
    near = folder / "near.yaml"
    near.write_text(_NEAR_AIR, encoding="utf-8")
    plant = str(data / "scenes" / "plant.splat")
    render_sheet(folder, "sheet_object", plant, "--wet", "--preset", str(near))
    render_sheet(
        folder, "sheet_capture_night", by_night(str(capture), folder / "capture_night"), "--cameras", "CAMERA_01"
    )
    render_sheet(folder, "sheet_object_night", by_night(plant, folder / "object_night"), "--preset", str(near))


def by_night(scene: str, output: Path) -> str:
    """Relight a scene by the command that a reader would give; returns the new one."""
    if run(["night", scene, "-o", str(output)]) != 0:
        raise SystemExit(1)
    return str(output)


def render_sheet(folder: Path, name: str, scene: str, *options: str) -> None:
    """One view of a scene below each other: dry, and in rain from moderate to very heavy."""
    width, height = 960, 640
    sheet = Image.new("RGB", (width, height * len(_SHEET_MM_H)))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(28)
    for row, intensity in enumerate(_SHEET_MM_H):
        own = [each for each in options if each != "--wet" or intensity != "0"]  # without rain, --wet is soaked
        sheet.paste(still(scene, folder, f"{width}x{height}", "--rain", intensity, *own), (0, row * height))
        corner = (16, row * height + 12)
        draw.text(corner, f"{intensity} mm/h", "white", font, stroke_width=2, stroke_fill="black")
    keep(sheet, name)


def render_regions(folder: Path) -> None:
    """Streaks near the camera, and haze far from it, each alone: the imaging regions of the paper."""
    width, height = 720, 480
    sheet = Image.new("RGB", (2 * width, height))
    for column, other in enumerate(("--no-haze", "--no-streaks")):
        sheet.paste(still("street", folder, f"{width}x{height}", "--rain", "12", other), (column * width, 0))
    keep(sheet, "paper_regions")


def render_glass(folder: Path) -> None:
    """A windshield without wiper through a small lens opening and that of a car's camera; with wiper; and a lens."""
    width, height = 720, 480
    dash_camera = folder / "dash_camera.yaml"
    dash_camera.write_text("aperture_mm: 0.8\nfocus_distance_m: 10.0\n", "utf-8")
    views = (
        ("windshield, lens opening 0.8 mm", ["--preset", str(dash_camera), "--glass", "windshield", "--wiper", "off"]),
        ("windshield, 3.4 mm", ["--glass", "windshield", "--wiper", "off"]),
        ("windshield, 3.4 mm, wiper", ["--glass", "windshield", "--wiper", "low"]),
        ("lens, 3.4 mm", ["--glass", "lens"]),
    )
    sheet = Image.new("RGB", (2 * width, 2 * height))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(22)
    for number, (title, options) in enumerate(views):
        left, top = width * (number % 2), height * (number // 2)
        sheet.paste(still("street", folder, f"{width}x{height}", "--rain", "8.5", *options), (left, top))
        draw.text((left + 12, top + 10), title, "white", font, stroke_width=2, stroke_fill="black")
    keep(sheet, "glass")


def render_plan(folder: Path) -> None:
    """The street from above, to scale, with all marks."""
    marks = "grid,scale,boxes,paths"
    keep(still("street", folder, "1560x400", "--camera", "top", "--marks", marks, "--rain", "8.5"), "plan")


def render_scenarios(folder: Path) -> None:
    """The paper's two scenarios, by rows at two moments: front camera and top view."""
    width, height = 500, 441
    sheet = Image.new("RGB", (width * len(_SCENARIOS), height * len(_SCENARIO_TIMES_S)))
    for column, scenario in enumerate(_SCENARIOS):
        out = folder / scenario
        code = run(["drive", scenario, "--rain", "0", "--agent", "oracle-idm", "--duration", "3", "-o", str(out)])
        if code != 0:
            raise SystemExit(code)
        (file,) = out.glob("*.mp4")
        with av.open(file) as video:
            rate = float(video.streams.video[0].average_rate or 1)
            for row, time_s in enumerate(_SCENARIO_TIMES_S):
                video.seek(0)
                frame = next(islice(video.decode(video=0), round(rate * time_s), None))
                cell = frame.to_image().resize((width, height), Image.Resampling.LANCZOS)
                sheet.paste(cell, (column * width, row * height))
    keep(sheet, "paper_scenarios")


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
        render_sheets(Path(folder))
        render_regions(Path(folder))
        render_glass(Path(folder))
        render_plan(Path(folder))
        render_scenarios(Path(folder))
        render_looks(Path(folder))


if __name__ == "__main__":
    main()
