"""Scenes and captures: load, save, and give them wet colors. Cameras and their paths.

Cameras are in a scene's world: meters, z up. A camera looks along its own z axis, y down (OpenCV).
"""

from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float, Float32, Float64

from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.registry import find_method
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.choices import Axis
from gsrain_engine.datasets.capture import Capture as Capture
from gsrain_engine.datasets.capture import CaptureError as CaptureError
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.editor.edits.level import oriented
from gsrain_engine.editor.steps import EditStep, apply_steps
from gsrain_engine.editor.viewport import camera as views
from gsrain_engine.rain.keyframes import rain_of
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX, LARGEST_PX
from gsrain_engine.safe_io.errors import SceneFormatError as SceneFormatError
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.safe_io.foreign_values import as_plain_values
from gsrain_engine.scene import camera, camera_path, gaussians
from gsrain_engine.scene.camera import Camera as Camera
from gsrain_engine.scene.camera_path_io import read_camera_path, write_camera_path
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.gaussians import Gaussians as Gaussians
from gsrain_engine.scene.lamps import Lamp as Lamp
from gsrain_engine.scene.named_view import NamedView as NamedView
from gsrain_engine.scene.named_view import view_named
from gsrain_engine.scene.open import load_scene, load_sorted_scene
from gsrain_engine.scene.progress import Progress as Progress
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Actor as Actor
from gsrain_engine.scene.scene import Layer as Layer
from gsrain_engine.scene.scene import Scene as Scene

from .arguments import checked

_PATHS = ("weights", "base", "images", "normals_weights", "normals_checkout")


@checked
def load(
    path: Path | str = "street", *, up: Axis | None = None, scale: float | None = None, sort: bool = True
) -> Scene:
    """Load a scene.

    Args:
        path: A 3DGS file (.ply, .spz, .sog, and others that `gsrain convert --help` lists), a scene folder, or
            "street": the built-in street.
        up: Axis of the file that points up, such as "-y". None is what the file says; files of Gaussians say nothing,
            and are taken as "-y".
        scale: Length of one unit of the file in meters; None is what the file says, else 1.
        sort: Whether to bring the Gaussians into the order that draws fastest; False keeps the order of the file.

    Raises:
        SceneFormatError: When it can't be read; names the file and the field.
        ValueError: For an axis or a scale that is not allowed.
    """
    return oriented(load_sorted_scene(path) if sort else load_scene(path), up, scale)


@checked
def save(scene: Scene, path: Path | str) -> None:
    """Save a scene as a scene folder, which keeps everything, or as one file by its ending, such as .ply, .spz, .glb.

    A .usdz keeps layers, actors, tracks and rigs; other files get what is visible at time 0.

    Raises `SceneFormatError` for an ending that can't be written, `OSError` where the disk refuses.
    """
    write_scene(scene, Path(path))


@checked
def edit(scene: Scene, name: str, /, **arguments: Any) -> Scene:
    """Edit a scene as the window does: `gr.edit(scene, "rename", key="layers/road", name="asphalt")`.

    Args:
        scene: The scene to edit; it stays as it is.
        name: An edit; `gsrain edit --list` lists them with their parameters. History in the window copies such calls.
        arguments: Its parameters: as in the list, or objects of the engine, such as arrays.

    Raises:
        ValueError: For an unknown edit or parameter, and when the edit refuses, such as for a locked layer.
    """
    return apply_steps(scene, [EditStep.with_values(name, arguments)])


@checked
def capture(path: Path | str, *, allow_outside: bool | None = None) -> Capture:
    """Open a recording: images with cameras, and lidar, boxes and masks where it has them. Images are read when used.

    Args:
        path: A folder of COLMAP, nerfstudio, nuScenes (`"nuscenes/scene-0103"`), Waymo, KITTI, DGP, BDD-100K or
            RainSense, or one with images alone.
        allow_outside: Whether files may be read that lie outside of the folder; None follows the program's setting.

    Raises:
        CaptureError: When it can't be read; names the file and what is wrong.
    """
    return open_capture(path, allow_outside=allow_outside)


@checked
def wet(
    scene: Scene,
    *,
    method: str = "wet",
    weights: Path | str | None = None,
    views: int | None = None,
    progress: Callable[[Progress], object] | None = None,
    **settings: Any,
) -> Scene:
    """Give a scene wet colors: computed from its own by the built-in look, else solved for views made rainy.

    The geometry and the clear colors stay; `Rain.wetness`, by default what follows from the intensity, blends between
    the two. The built-in look takes seconds and needs no weights.

    Args:
        scene: The dry scene.
        method: "wet", the built-in look; "cyclegan-turbo", the paper's diffusion model, which needs torch and its
            weights; "images", pictures of the same views from another program; or a method of an installed package.
        weights: File with the weights of a learned method.
        views: Number of views; None takes 24. The built-in look needs none.
        progress: Called with each step: `fraction` (0..1), `message`, and at times a `preview` image.
        settings: Further fields of the transfer's settings, such as `seed`, `base` or `images`.

    Raises:
        ValueError: For an unknown method or setting, and where what the method needs is missing.
    """
    from gsrain_engine.editor.jobs.make_rainy import TransferRequest, rainy_by  # kernels take a second to load

    row = find_method(method)
    values: dict[str, Any] = as_plain_values(settings if weights is None else settings | {"weights": weights})
    paths = {name: Path(values[name]) for name in _PATHS if isinstance(values.get(name), str)}
    chosen: TransferSettings = convert_checked(values | paths, TransferSettings)
    for name in _PATHS:
        path: Path | None = getattr(chosen, name)
        if path is not None and not path.exists():
            raise ValueError(f"{name} {path}: no such file or folder")
    if row.needs is not None and getattr(chosen, row.needs) is None:
        raise ValueError(f"method {method!r} needs the argument {row.needs}=")
    choice: ViewChoice = msgspec.convert({"count": views}, ViewChoice)
    return run_to_end(rainy_by(scene, TransferRequest(method, chosen, choice)), progress)


@checked
def sh_from_color(colors: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 1 3"]:
    """Return spherical harmonics of degree 0 with the same display color (0..1) from every direction."""
    return gaussians.sh_from_color(colors.astype(np.float32))


# Cameras


@checked
def look_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    """Return the world-to-camera matrix of a camera at `eye` that looks at `target`, with `up` upwards in the image.

    Raises `ValueError` where the eye is at the target, or `up` is 0.
    """
    if np.array_equal(eye, target) or not up.any():
        raise ValueError(f"look_at: the eye {eye} must be away from the target, and up {up} must not be 0")
    return camera.look_at(eye, target, up)


@checked
def home_camera(scene: Scene, size: tuple[int, int] = DEFAULT_SIZE_PX) -> Camera:
    """Return the camera that a scene is first shown from; `size` is width and height in pixels.

    It looks through the windscreen where the scene has an ego vehicle with cameras, else at the scene's middle.
    """
    _check_size(size)
    return views.home_camera(scene, *size)


class View(NamedTuple):
    """A named view of a scene: `camera, time, rain = gr.view(scene, name)`."""

    camera: Camera
    """In the world: meters, z up."""
    time: float
    """Moment of scene and rain in seconds."""
    rain: RainSettings | None
    """None is no rain."""


@checked
def view(scene: Scene, name: str, size: tuple[int, int] = DEFAULT_SIZE_PX) -> View:
    """Return camera, time and rain of a named view of a scene; `scene.views` lists them.

    Args:
        scene: The scene.
        name: Name of the view.
        size: Width and height of its pictures in pixels.

    Returns:
        The view; one without time is at 0 s, and one without rain in the rain that the scene is saved with.

    Raises:
        ValueError: When the scene has no such view, or its rain is damaged.
    """
    from gsrain_engine.editor.views import camera_of_view, scene_at_view  # they load OpenCV

    _check_size(size)
    found = view_named(scene.views, name, scene.name)
    rain = rain_of(scene_at_view(scene, found))
    camera = camera_of_view(scene, found, *size)
    return View(camera, found.time_s or 0.0, rain)


@checked
def save_view(
    scene: Scene, name: str, camera: Camera, *, time: float | None = None, rain: RainSettings | None = None
) -> Scene:
    """Return the scene with a named view, in place of one of that name, else as the last one.

    Args:
        scene: The scene; it stays as it is.
        name: Name of the view.
        camera: A camera in the world, of which the view has the pose and the vertical field of view.
        time: Moment of scene and rain in seconds; None leaves the time as it is.
        rain: The rain; None leaves the rain as it is.

    Raises:
        ValueError: For a name that can't be displayed, and a time below 0.
    """
    from gsrain_engine.editor.edits.views import save_view
    from gsrain_engine.editor.views import plain_rain

    own = camera.moved(np.linalg.inv(scene.scene_to_world))
    return save_view(scene, NamedView.of(name, own, time_s=time, rain=None if rain is None else plain_rain(rain)))


def _check_size(size: tuple[int, int]) -> None:
    if not all(1 <= each <= LARGEST_PX for each in size):
        raise ValueError(f"size {size[0]} x {size[1]}: must be within 1..{LARGEST_PX} px")


class CameraPath(camera_path.CameraPath):
    """Keyframes of a camera in time, with smooth curves between them: positions in meters, times in seconds."""

    @classmethod
    @checked
    def through(cls, times_s: Sequence[float], cameras: Sequence[Camera]) -> "CameraPath":
        """Fly through cameras at rising times in seconds; the exposure is the first one's.

        Raises `ValueError` without a camera, and where the times are not as many or don't rise.
        """
        return cls._of(super().through(times_s, cameras))

    @classmethod
    @checked
    def orbit(cls, scene: Scene, seconds: float = views.ORBIT_S, degrees: float = views.ORBIT_DEG) -> "CameraPath":
        """Swing around a scene's middle in front of its home camera; 360 degrees go all the way round.

        Raises `ValueError` where the time is not above 0.
        """
        return cls._of(views.orbit_around(scene, *DEFAULT_SIZE_PX, seconds, degrees))

    @classmethod
    @checked
    def default(cls, scene: Scene) -> "CameraPath":
        """Return the path that a scene is shown along: its own, else the drive of its ego vehicle, else an orbit."""
        own = None if scene.path is None else scene.path.moved(scene.scene_to_world)
        return cls._of(own or views.default_path(scene, *DEFAULT_SIZE_PX))

    @classmethod
    @checked
    def read(cls, path: Path | str, scene: Scene) -> "CameraPath":
        """Read a file in a scene's own units and axes: ours, nerfstudio's camera_path.json, or 3DGS's cameras.json.

        A camera of a `.glb` is read, too, placed as in the `.glb` that the scene is written to.

        Raises `SceneFormatError` when it can't be read.
        """
        return cls._of(read_camera_path(Path(path), scene).moved(scene.scene_to_world))

    @checked
    def save(self, path: Path | str, scene: Scene) -> None:
        """Write the path as JSON, in a scene's own units and axes, as `gsrain render --camera-path` reads it."""
        write_camera_path(Path(path), self.moved(np.linalg.inv(scene.scene_to_world)))

    @classmethod
    def _of(cls, path: camera_path.CameraPath) -> "CameraPath":
        return cls(**{field.name: getattr(path, field.name) for field in fields(path)})
