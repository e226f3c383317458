"""Takes the pictures of the guide from the running window: `make pictures`. Needs a display, or Xvfb's `xvfb-run`."""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import msgspec
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.immapp import testing
from PIL import Image

from app.window import Window
from gsrain_engine.kernel_cache import use_kernel_cache
from gsrain_engine.session.files.open_scene import open_scene
from gsrain_engine.session.session import Session
from ui.panels.table import PANELS
from ui.shortcuts import chord
from ui.tools import TOOLS

IMAGES = Path(__file__).parent / "images"
_SIZE = (1440, 900)
_QUALITY = 88
_MARGIN = 16
"""Pixels that the test engine takes around a window."""


class Photographer:
    """A window on the street, driven by the test engine, and a camera."""

    def __init__(self, folder: Path) -> None:
        self.session = Session(open_scene("street"))
        self.session.clock.playing = False
        self.window = Window(lambda: self.session)
        self._folder = folder

    def run(self, script: Callable[[], None]) -> None:
        """Open the window, do what the script says, close it."""
        parameters = self.window.parameters()
        parameters.ini_disable = True
        parameters.app_window_params.window_geometry.size = _SIZE

        def act(ctx: imgui.test_engine.TestContext) -> None:
            self.ctx = ctx
            engine = imgui.test_engine.get_io(hello_imgui.get_imgui_test_engine())
            engine.config_watchdog_kill_test = engine.config_watchdog_warning = 900.0
            while self.window.workspace is None or not self.window.workspace.view.is_settled:
                ctx.yield_()
            self.frames(5)
            script()

        testing.run(test_function=act, runner_params=parameters)

    def frames(self, count: int = 4) -> None:
        """Let frames go by."""
        for _ in range(count):
            self.ctx.yield_()

    def take(self, name: str, window: str | None = None) -> None:
        """Picture a window of the program, or all of it, for the guide."""
        self.frames()
        taken = self._folder / f"{name}.png"
        testing.capture(self.ctx, str(taken), window=window)
        IMAGES.mkdir(exist_ok=True)
        picture = Image.open(taken).convert("RGB")
        if window is not None:
            picture = picture.crop((_MARGIN, _MARGIN, picture.width - _MARGIN, picture.height - _MARGIN))
        picture.save(IMAGES / f"{name}.jpg", quality=_QUALITY, optimize=True)
        print(f"docs/images/{name}.jpg")


def picture_panels(camera: Photographer) -> None:
    """Each panel, in rain."""
    session = camera.session
    session.set_rain("8.5 mm/h", msgspec.structs.replace(session.rain, intensity_mm_h=8.5))
    for panel in PANELS:
        camera.ctx.window_focus(f"//{panel.title}")
        camera.take(f"panel_{_file_name(panel.title)}", panel.title)


def picture_tools(camera: Photographer) -> None:
    """Each tool as it stands over the picture when it is picked, its pointer in the middle."""
    camera.ctx.window_focus("//View")
    for tool in TOOLS:
        camera.session.view.tool = tool.name
        camera.ctx.mouse_move("//View/view")
        camera.take(f"tool_{_file_name(tool.name)}", "View")
    camera.session.view.tool = ""


def picture_pages(camera: Photographer) -> None:
    """The window as a whole, the command palette, the keyboard page."""
    camera.take("window")
    camera.ctx.key_press(chord(imgui.Key.mod_ctrl, imgui.Key.p))
    camera.take("commands")
    camera.ctx.key_press(imgui.Key.escape)
    camera.frames()
    camera.ctx.key_press(imgui.Key.f1)
    camera.take("keys")
    camera.ctx.key_press(imgui.Key.escape)


def _file_name(title: str) -> str:
    return title.lower().replace(" ", "_").replace("-", "_")


def main() -> None:
    """Take all pictures, or those of the groups that are named: panels, tools, pages."""
    groups = {"panels": picture_panels, "tools": picture_tools, "pages": picture_pages}
    wanted = sys.argv[1:] or list(groups)
    use_kernel_cache()
    with tempfile.TemporaryDirectory() as folder:
        camera = Photographer(Path(folder))
        camera.run(lambda: [groups[name](camera) for name in wanted] and None)


if __name__ == "__main__":
    main()
