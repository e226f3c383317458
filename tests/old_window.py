"""A window whose OpenGL is too old to draw scenes: `python old_window.py FOLDER`, where the driver is made so.

A hand plays, orbits and opens a capture. The last line of the output is what was found, as JSON.
"""

import json
import sys
from pathlib import Path

import numpy as np

import ui.workspace
from editor.small_capture import small_capture, written_capture
from gsrain_engine.compile_cache import use_kernel_cache
from gsrain_engine.editor.capture_view import PointSample
from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.opengl.warp import PictureWarp
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene
from window_driver import Driver, imgui

INTENSITY_MM_H = 8.5
warped: list[float] = []
"""Mean value of each warped picture."""


class WatchedWarp(PictureWarp):
    """Warp of pictures that notes what it has drawn."""

    def show(self, *arguments):
        texture = super().show(*arguments)
        warped.append(float(np.frombuffer(texture.read(), np.uint8).reshape(-1, 4)[:, :3].mean()))
        return texture


def main(folder: Path) -> None:
    ui.workspace.PictureWarp = WatchedWarp
    (folder / "shots").mkdir()
    driver, found = Driver(folder / "shots"), {}
    editor = driver.editor = Editor(small_scene(), RainSettings(intensity_mm_h=INTENSITY_MM_H))
    editor.playback.clock.playing = False

    def act():
        context = driver.window.workspace.context
        write_scene(editor.document.scene, folder / "scene")
        driver.click("//View/###Play")
        driver.until(lambda: editor.playback.clock.time_s > 0.2)
        driver.click("//View/###Play")
        driver.stroke(driver.at(0.5, 0.5), driver.at(0.55, 0.5), driver.at(0.6, 0.5), driver.at(0.62, 0.52))
        driver.press(imgui.Key.r)  # back to where the color of the sky was found
        shot = driver.picture()
        view = editor.viewport.shot(shot.shape[1], shot.shape[0])
        (folder / "camera.json").write_text(json.dumps(view.camera.to_json()))
        editor.document.change_rain("Rain", intensity_mm_h=0.0)
        colors = len(np.unique(driver.screen().reshape(-1, 3), axis=0))
        captures, measured = editor.captures, small_capture()
        captures.open(written_capture(folder / "drive"))
        driver.until(lambda: captures.capture is not None and not captures.is_working)
        captures.points = PointSample(measured.points_m, measured.point_colors, len(measured.points_m))
        found.update(
            version=context.version_code,
            intensity_mm_h=INTENSITY_MM_H,
            back_end=editor.viewport.backend,
            reason=editor.viewport.backend_reason,
            time_s=view.time_s,
            mean=float(shot.mean()),
            colors_on_screen=colors,
            pixels_of_points=int((np.abs(driver.screen() - measured.point_colors[0]).max(axis=2) <= 10).sum()),
            problem=editor.status.problem,
            error=context.error,
        )

    driver.run(act)
    print("\n" + json.dumps(found | {"warped": warped}))


if __name__ == "__main__":
    use_kernel_cache()
    main(Path(sys.argv[1]))
