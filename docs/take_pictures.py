"""Takes the pictures of the guide from the running window: `make pictures`. Needs a display, or Xvfb's `xvfb-run`."""

import math
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.immapp import testing
from PIL import Image

from app.main import run
from gsrain_engine.compile_cache import use_kernel_cache
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.rain.keyframes import shower_keyframes
from gsrain_engine.scene.open import load_scene
from ui.commands.keys import chord
from ui.panels.registry import BUILT_IN_PANELS
from ui.tools import TOOLS
from ui.window import MainWindow

IMAGES = Path(__file__).parent / "images"
_SIZE = (1440, 900)
_FOR_PANELS = (1440, 1500)
_QUALITY = 88
_TOOL_WIDTH = 560
_SPLIT_WIDTH = 960
_MOMENT_S = 5.4
"""In the middle of the shower and between two cars."""
_IN_THE_DRIVE_S = 1.6
"""The car that stands is near, and the plan shows that it is seen."""
_MOST_FRAMES = 1000
_NOTICED = 8
"""Levels by which a row of a picture has to differ from an empty one."""
_MARGIN = 16
"""Pixels that the test engine takes around a window."""


class Photographer:
    """A window on the street, driven by the test engine, and a camera."""

    def __init__(self, folder: Path, dpi_scale: float = 1.0) -> None:
        self.editor = Editor(load_scene("street"))
        self.editor.playback.clock.playing = False
        self.editor.preferences.value = msgspec.structs.replace(
            self.editor.preferences.value, hint=False, known_version=version("gsrain")
        )
        self.window = MainWindow(lambda: self.editor)
        self._folder, self._dpi_scale = folder, dpi_scale

    def run(self, script: Callable[[], None]) -> None:
        """Open the window, do what the script says, close it."""
        parameters = self.window.parameters()
        parameters.ini_disable = True
        parameters.app_window_params.window_geometry.size = _SIZE
        parameters.dpi_aware_params.dpi_window_size_factor = self._dpi_scale

        def act(ctx: imgui.test_engine.TestContext) -> None:
            self.ctx = ctx
            engine = imgui.test_engine.get_io(hello_imgui.get_imgui_test_engine())
            engine.config_watchdog_kill_test = engine.config_watchdog_warning = 3600.0
            while self.window.workspace is None or not self.window.workspace.pictures.is_settled:
                ctx.yield_()
            self.frames(5)
            script()

        testing.run(test_function=act, runner_params=parameters)

    def frames(self, count: int = 4) -> None:
        """Let frames go by."""
        for _ in range(count):
            self.ctx.yield_()

    def rest(self) -> None:
        """Let the frames go by that still change the picture: exact ones, and drops in the color of a new sky."""
        assert self.window.workspace is not None
        pictures, viewport = self.window.workspace.pictures, self.editor.viewport
        results = [pictures.last]
        for _ in range(_MOST_FRAMES):
            is_settled = not (viewport.budget.is_settling or viewport.is_catching_up)
            if len(results) > 2 and is_settled and pictures.is_current:  # the second was begun after all changes
                break
            self.ctx.yield_()
            if pictures.last is not results[-1]:
                results.append(pictures.last)
        self.frames()

    def gesture(self, places: Sequence[tuple[float, float]], *, held: bool) -> None:
        """Drag through places of the picture and hold there, or click on each of them."""
        rect = self.ctx.item_info("//View/view").rect_full
        self.ctx.mouse_move("//View/view")
        for number, (x, y) in enumerate(places):
            across, down = x * (rect.max.x - rect.min.x), y * (rect.max.y - rect.min.y)
            self.ctx.mouse_move_to_pos(imgui.ImVec2(rect.min.x + across, rect.min.y + down))
            self.frames(2)
            if not held:
                self.ctx.mouse_click(0)
            elif number == 0:
                self.ctx.mouse_down(0)
            self.frames(2)

    def take(self, name: str, window: str | None = None, width: int | None = None, *, trimmed: bool = False) -> None:
        """Picture a window of the program, or all of it, for the guide; at most so wide, without empty rows below."""
        picture = self.picture(window, trimmed=trimmed)
        if width is not None:
            picture.thumbnail((width, width))
        _save(picture, name, _QUALITY)

    def picture(self, window: str | None = None, *, trimmed: bool = False) -> Image.Image:
        """Picture a window of the program, or all of it; without empty rows below if trimmed."""
        for job in self.editor.jobs.notices:
            job.is_noticed = True
        self.frames()
        self.rest()
        taken = self._folder / "picture.png"
        testing.capture(self.ctx, str(taken), window=window)
        picture = Image.open(taken).convert("RGB")
        if window is not None:
            place = imgui.internal.find_window_by_name(window).rect()
            left, top = min(place.min.x, _MARGIN), min(place.min.y, _MARGIN)
            width_px, height_px = place.max.x - place.min.x, place.max.y - place.min.y
            picture = picture.crop((left, top, left + width_px, top + height_px))
        return picture.crop((0, 0, picture.width, _filled_px(picture))) if trimmed else picture

    def take_panels(self, *titles: str) -> None:
        """Picture panels, each as `panel_ITS_TITLE`, in a window that is high enough for the whole of most."""
        hello_imgui.change_window_size(_FOR_PANELS)
        self.frames()
        self.ctx.mouse_move("//View/view")  # no tooltip is open
        for panel in BUILT_IN_PANELS:
            if panel.title in titles:
                self.ctx.window_focus(f"//{panel.title}")
                self.take(panel_picture(panel.title), panel.title, trimmed=True)
        hello_imgui.change_window_size(_SIZE)
        self.frames()


def picture_panels(camera: Photographer) -> None:
    """Each panel, in rain, with a job that has ended; but those that have something to show only later."""
    editor = camera.editor
    editor.document.change_rain("8.5 mm/h", intensity_mm_h=8.5)
    editor.viewport.options.member = "layers/houses"
    editor.calibration.measure()
    editor.wet_look.make()
    while editor.calibration.busy is not None or editor.jobs.running or editor.viewport.staged is not None:
        camera.frames(1)
    camera.take_panels(
        *(panel.title for panel in BUILT_IN_PANELS if panel.title not in ("Capture", "Drive", "Drive plots"))
    )


def picture_tools(camera: Photographer) -> None:
    """Each tool in use, in the middle of its gesture."""
    editor = camera.editor
    camera.ctx.window_focus("//View")
    editor.viewport.options.member = "actors/lead"
    for tool in TOOLS:
        steps = editor.document.history.cursor
        editor.viewport.options.tool = tool.name
        camera.frames()
        held, places = _GESTURES.get(tool.name, (False, ()))
        camera.gesture(places, held=held)
        camera.take(f"tool_{_file_name(tool.name)}", "View", _TOOL_WIDTH)
        camera.ctx.mouse_up(0)
        camera.frames()
        editor.viewport.options.tool = ""
        camera.frames()
        editor.document.go_to_step(steps)


_AROUND_THE_CAR = tuple((0.5 + 0.17 * math.cos(a / 3), 0.62 + 0.14 * math.sin(a / 3)) for a in range(19))
_GESTURES: dict[str, tuple[bool, tuple[tuple[float, float], ...]]] = {
    "Rectangle": (True, ((0.38, 0.47), (0.64, 0.75))),
    "Lasso": (True, _AROUND_THE_CAR),
    "Polygon": (False, ((0.4, 0.48), (0.6, 0.46), (0.64, 0.72), (0.38, 0.74))),
    "Brush": (True, ((0.43, 0.58), (0.5, 0.64), (0.57, 0.58))),
    "Sphere": (True, ((0.5, 0.62), (0.6, 0.62))),
    "Box": (False, ((0.5, 0.62),)),
    "Flood": (False, ((0.5, 0.6),)),
    "Color pick": (False, ((0.92, 0.85),)),
    "Measure": (False, ((0.3, 0.85), (0.7, 0.85))),
    "Level": (False, ((0.3, 0.8), (0.6, 0.9))),
    "Drop color": (True, ((0.4, 0.12), (0.6, 0.25))),
}
"""By tool: whether the button stays down for the picture, and where the mouse goes, in shares of the picture."""


def picture_pages(camera: Photographer) -> None:
    """The window as a whole in a shower, the command palette, the keyboard page."""
    editor = camera.editor
    editor.wet_look.make()
    while editor.jobs.running or editor.viewport.staged is not None:
        camera.frames(1)
    editor.document.edit_keyframes(
        "Add passing shower", replace_keyframes, shower_keyframes(duration_s=12.0, peak_mm_h=13.0)
    )
    editor.camera_path.path_from_drive(every_s=2.0)
    editor.playback.clock.seek(_MOMENT_S)
    editor.viewport.ride(True)
    for panel in ("Layers", "Rain", "Timeline", "View"):
        camera.ctx.window_focus(f"//{panel}")
    camera.ctx.mouse_move("//View/view")
    camera.frames(20)
    camera.take("window")
    camera.ctx.key_press(chord(imgui.Key.mod_ctrl, imgui.Key.p))
    camera.take("commands")
    camera.ctx.key_press(imgui.Key.escape)
    camera.frames()
    camera.ctx.key_press(imgui.Key.f1)
    camera.take("keys")
    camera.ctx.key_press(imgui.Key.escape)
    editor.preferences.set(theme="light")
    camera.take("window_light")
    editor.preferences.set(theme="dark")


def picture_wet(camera: Photographer) -> None:
    """The street clear and with a preview; at 12 mm/h, wet; undone; done again; both beside each other."""
    editor = camera.editor
    camera.ctx.window_focus("//View")
    camera.take("wet_clear", "View", _TOOL_WIDTH)
    camera.ctx.window_focus("//Wet look")
    editor.wet_look.preview()
    while editor.jobs.running or editor.viewport.options.split == "off":
        camera.frames(1)
    camera.ctx.mouse_move("//Wet look/###preview")
    camera.take("wet_look")
    editor.viewport.options.split = "off"
    camera.frames()
    camera.ctx.mouse_move("//View/view")
    editor.document.change_rain("12 mm/h", intensity_mm_h=12.0)
    editor.wet_look.make()
    while editor.jobs.running or editor.viewport.staged is not None:
        camera.frames(1)
    camera.frames(20)
    camera.take("wet_rainy", "View", _TOOL_WIDTH)
    editor.document.undo()
    camera.take("wet_undone", "View", _TOOL_WIDTH)
    editor.document.redo()
    camera.take("wet_redone", "View", _TOOL_WIDTH)
    editor.viewport.options.split = "clear | rainy"
    camera.frames(20)
    camera.take("split", "View", _SPLIT_WIDTH)
    editor.viewport.options.split = "off"


def picture_capture(camera: Photographer) -> None:
    """The street's photographs over its Gaussians, from where one was taken; which of its pixels the next one shows."""
    editor, captures = camera.editor, camera.editor.captures
    with tempfile.TemporaryDirectory() as folder:
        run(["street", folder, "--moments", "13", "--width", "480"])
        captures.open(Path(folder) / "images")
        while captures.capture is None or captures.is_working:
            camera.frames(1)
        captures.look_from(3)
        camera.ctx.window_focus("//Capture")
        while captures.is_working:
            camera.frames(1)
        camera.frames(20)
        camera.take("capture")
        camera.take_panels("Capture")
        editor.matching.is_on = editor.matching.lines = True
        editor.matching.mode = "pixels"
        while editor.matching.shown is None or editor.matching.is_working:
            camera.frames(1)
        camera.ctx.item_open("//Capture/Matching")
        camera.ctx.mouse_move("//View/view")
        camera.frames(20)
        camera.take("matching")
        editor.matching.is_on = False
        captures.close_capture()


def picture_drive(camera: Photographer) -> None:
    """Two drives towards a car that stands: one that keeps its speed, and one that brakes, in rain, which plays."""
    editor, drives = camera.editor, camera.editor.rollouts
    for agent, intensity in (("constant-velocity", 0.0), ("oracle-idm", 8.5)):
        drives.setup.settings = msgspec.structs.replace(
            drives.setup.settings, agent=agent, rain="one intensity", intensity_mm_h=intensity
        )
        drives.start()
        while editor.jobs.running or drives.is_working:
            camera.frames(1)
    drives.mosaic.rig = "nuscenes"
    for panel in ("View", "Drive", "Drive plots", "Camera rig"):
        camera.ctx.window_focus(f"//{panel}")
    drives.jump(_IN_THE_DRIVE_S)
    camera.frames(30)
    camera.take("drive")
    camera.take_panels("Drive", "Drive plots")
    drives.close_all()
    editor.playback.clock.seek(0.0)
    editor.viewport.go_home()


# Sheets of all panels, in both themes and two scales

_SHEET_WIDTH = 1344
_GAP = 12
_SHEET_KB = 390
_PARTS = {1.0: {"": ("left", "right", "bottom")}, 2.0: {"_left": ("left", "bottom"), "_right": ("right",)}}
"""Sheets of a scale by the end of their names, and the sides of their panels."""


def picture_themes(folder: Path) -> None:
    """Each panel in the dark and the light theme, at DPI 1 and 2: a sheet for each of the four."""
    for dpi_scale in (1.0, 2.0):
        camera = Photographer(folder, dpi_scale)
        camera.run(lambda camera=camera, dpi_scale=dpi_scale: _take_sheets(camera, dpi_scale))


def _take_sheets(camera: Photographer, dpi_scale: float) -> None:
    editor = camera.editor
    editor.viewport.options.shrink = 4  # the picture is not in these
    editor.document.change_rain("8.5 mm/h", intensity_mm_h=8.5)
    editor.viewport.options.member = "layers/houses"
    editor.calibration.measure()
    while editor.calibration.busy is not None:
        camera.frames(1)
    width, height = _FOR_PANELS
    hello_imgui.change_window_size((round(dpi_scale * width), round(dpi_scale * height)))
    for theme in ("dark", "light"):
        editor.preferences.value = msgspec.structs.replace(editor.preferences.value, theme=theme)
        pictures = dict[str, list[Image.Image]]()
        for panel in BUILT_IN_PANELS:
            camera.ctx.window_focus(f"//{panel.title}")
            camera.frames()
            while editor.rollouts.mosaic.is_behind:
                camera.frames(1)
            taken = camera.picture(panel.title, trimmed=True)
            pictures.setdefault(panel.side.split()[0], []).append(taken)
        for end, sides in _PARTS[dpi_scale].items():
            shown = [picture for side in sides for picture in pictures[side]]
            _save_small(_sheet(shown, dpi_scale), f"panels_{theme}_dpi{dpi_scale:g}{end}")


def _sheet(pictures: Sequence[Image.Image], dpi_scale: float) -> Image.Image:
    """Put pictures of panels, in pixels of the screen, below each other and side by side where they fit."""
    sheet_width, gap = round(_SHEET_WIDTH * dpi_scale), round(_GAP * dpi_scale)
    free, places = [(gap, gap, sheet_width - gap)], list[tuple[Image.Image, int, int]]()
    for picture in sorted(pictures, key=lambda each: (-each.width, -each.height)):
        fitting = [each for each in free if each[2] - each[0] >= picture.width]
        left, top, right = place = min(fitting, key=lambda each: (each[1], each[0]))
        places.append((picture, left, top))
        free.remove(place)
        below, beside = top + picture.height + gap, left + picture.width + gap
        free.append((left, below, right if right - beside <= 0 else left + picture.width))
        if right - beside > 0:
            free.append((beside, top, right))
    height = max(top + picture.height for picture, _, top in places) + gap
    width = max(left + picture.width for picture, left, _ in places) + gap
    sheet = Image.new("RGB", (width, height), (128, 128, 128))
    for picture, left, top in places:
        sheet.paste(picture, (left, top))
    return sheet


def _save(picture: Image.Image, name: str, quality: int) -> None:
    IMAGES.mkdir(exist_ok=True)
    picture.save(IMAGES / f"{name}.jpg", quality=quality, optimize=True)
    print(f"docs/images/{name}.jpg")


def _save_small(picture: Image.Image, name: str) -> None:
    """Save a picture in the best quality in which its file is small enough."""
    for quality in range(_QUALITY, 0, -6):
        _save(picture, name, quality)
        if (IMAGES / f"{name}.jpg").stat().st_size < 1000 * _SHEET_KB:
            return


def _filled_px(picture: Image.Image) -> int:
    """Height of a panel's picture down to its last row that differs from the empty one at its lower edge."""
    pixels = np.asarray(picture)[:-_MARGIN].astype(int)
    rows = np.flatnonzero(np.abs(pixels - pixels[-1]).max(axis=(1, 2)) > _NOTICED)
    return min(int(rows.max(initial=0)) + 1 + _MARGIN, picture.height)


def panel_picture(title: str) -> str:
    """The name of a panel's picture."""
    return f"panel_{_file_name(title)}"


def _file_name(title: str) -> str:
    return title.lower().replace(" ", "_").replace("-", "_")


def main() -> None:
    """Take all pictures, or those of the groups that are named: panels, tools, pages, wet, capture, drive, themes."""
    groups = {
        "panels": picture_panels,
        "tools": picture_tools,
        "pages": picture_pages,
        "wet": picture_wet,
        "capture": picture_capture,
        "drive": picture_drive,
    }
    wanted = sys.argv[1:] or [*groups, "themes"]
    use_kernel_cache()
    with tempfile.TemporaryDirectory() as folder:
        # The default preferences, such as which panels are in front, and no autosave that somebody is asked about later
        os.environ["XDG_CONFIG_HOME"] = os.environ["XDG_STATE_HOME"] = folder
        if in_one_window := [name for name in wanted if name != "themes"]:
            camera = Photographer(Path(folder))
            camera.run(lambda: [groups[name](camera) for name in in_one_window] and None)
        if "themes" in wanted:
            picture_themes(Path(folder))


if __name__ == "__main__":
    main()
