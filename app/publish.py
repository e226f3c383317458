"""`gsrain publish`: a scene and its rain as one web page."""

from pathlib import Path
from typing import Annotated

from gsrain_engine.render.export_settings import ExportSettings

from .console import print, run_with_progress
from .options import JsonFile, Orientation, Wet, check_within, option, setting, takes_set
from .outputs import PAGES, check_writable, lock_outputs, write_numbers
from .render import CameraOption, RainOptions, ViewOption


@takes_set
def publish(
    scene: Annotated[str | None, option("Scene file or folder; default: the built-in street.")] = None,
    /,
    *,
    output: Annotated[Path, setting(ExportSettings, "output", topic="Output", text="Web page to write (.html).")],
    rain: RainOptions | None = None,
    camera: CameraOption = None,
    camera_path: Annotated[
        Path | None,
        option("Camera path: ours, nerfstudio's, 3DGS's cameras.json, a .glb or .gltf.", topic="Camera and time"),
    ] = None,
    view: ViewOption = None,
    speed: Annotated[
        float | None,
        option("Speed on the camera path in m/s; default: its own, or walking pace.", topic="Camera and time"),
    ] = None,
    duration: Annotated[
        float | None, option("Seconds of the path; default: all of it.", topic="Camera and time")
    ] = None,
    time: Annotated[float, setting(ExportSettings, "first_s")] = 0.0,
    wet: Wet = None,
    orientation: Orientation | None = None,
    json: JsonFile = None,
) -> None:
    """Write one web page with a scene, a path, and its rain under a slider of intensities, beside the dry scene.

    The page loads nothing and opens from a disk, in browsers with WebGL 2. Its drops and splashes are those of the
    desktop, and wet ground mirrors the scene. It has no rings, spray, water on glass and light of lamps.
    """
    from gsrain_engine.backends import open_renderer
    from gsrain_engine.publish.page import LONGEST_S, opening_view, publish_page
    from gsrain_engine.rain.simulation import RainSimulation
    from gsrain_engine.render.export import export_sequences
    from gsrain_engine.scene.camera_path import CameraPath
    from gsrain_engine.scene.open import load_sorted_scene

    from .render import at_view, check_one_camera, rainy_light, viewpoint_of
    from .scene import timed_path

    if output.suffix.lower() not in PAGES:
        raise ValueError(f"--output {output}: expected the name of a web page (.html)")
    check_within("--duration", duration, 0, LONGEST_S, "s", is_open=True)
    check_writable(output, json)
    check_one_camera(view, camera, camera_path)
    opened = (orientation or Orientation()).of(load_sorted_scene(scene))
    first = opening_view(opened, None, has_path=camera is not None or camera_path is not None)
    opened, opening = at_view(opened, first.name if view is None and first is not None else view)
    settings = (rain or RainOptions()).for_scene(opened, "page")
    opened, settings = rainy_light(opened, settings, wet, settings.intensity_mm_h)
    film = ExportSettings(output="page.mp4", first_s=time)
    viewpoint = viewpoint_of(opened, camera, camera_path, film)
    is_path = camera_path is not None or (camera is None and opened.path is not None)
    if isinstance(viewpoint, CameraPath) and is_path:
        viewpoint = timed_path(viewpoint, speed).path
    elif speed is not None:
        raise ValueError(f"--speed {speed:g}: only a camera path has one (--camera-path, or a scene with its own)")
    is_own = camera is None and camera_path is None and opened.path is not None
    sequence = export_sequences(film, opened, RainSimulation.start(settings), viewpoint, in_scene_time=is_own)[""]
    lock_outputs(output)
    path_name = "Path" if camera_path is None else camera_path.stem
    with open_renderer("cpu") as renderer:
        page = run_with_progress(
            publish_page(renderer, opened, settings, sequence, path_name, output, duration, opening)
        )
    for line in page.lines:
        print(line)
    write_numbers(json, page.numbers)
