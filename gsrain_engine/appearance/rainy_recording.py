"""Rain in front of photographs, and rainy copies of recorded drives in their own format."""

import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ..datasets.capture import Capture, CaptureFrame
from ..datasets.kitti import calibration_of_day
from ..rain.frame import SkyLight
from ..rain.settings import RainSettings
from ..rain.simulation import OVERCAST, RainSimulation
from ..render.draw import RenderView, ego_view, rain_camera
from ..render.images import write_image
from ..render.renderer import Renderer
from ..scene.files import whole_folder
from ..scene.geometry import linear_to_srgb, srgb_to_linear
from ..scene.progress import Progress
from ..scene.scene import Scene

_JPEG_QUALITY = 95
_LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
"""World-to-camera transform that looks ahead over a road, for images without poses."""


def rain_on_photo(
    renderer: Renderer,
    world: Scene,
    rainfall: RainSimulation,
    shot: RenderView,
    photo: UInt8[np.ndarray, "h w 3"],
    sky: SkyLight = OVERCAST,
) -> UInt8[np.ndarray, "h w 3"]:
    """Composite rain over the photograph B, W its share of a pixel and S its light: enc((1-W) dec(B) + W S).

    Rain falls as if everything in the photograph were far behind it; haze is the paper's Gaussians, since a medium has
    no distances here. `world` tells the vehicle's motion.
    """
    if rainfall.state_at(shot.time_s).intensity_mm_h == 0:
        return photo
    falling = rainfall.frame(shot.time_s, rain_camera(world, rainfall, shot), sky)
    renderer.draw([], shot.camera, falling)
    share = renderer.read().rgba[..., 3:]
    encode, decode = (linear_to_srgb, srgb_to_linear) if falling.is_linear else (np.asarray, np.asarray)
    mixed = encode((1 - share) * decode(photo.astype(np.float64) / 255) + share * decode(falling.color))
    return np.rint(np.clip(mixed, 0, 1) * 255).astype(np.uint8)


def photo_view(world: Scene, capture: Capture, view: CaptureFrame) -> RenderView:
    """View of the world of the rain (meters, z up) from a captured camera; a level one over a road without poses."""
    camera = view.camera
    camera = camera.moved(world.scene_to_world) if capture.has_poses else replace(camera, world_to_camera=_LEVEL)
    return ego_view(world, camera, view.time_s)


# Copies of recordings


def write_rainy_recording(
    renderer: Renderer, capture: Capture, source: Path, rain: RainSettings, target: Path
) -> Iterator[Progress]:
    """Copy the folder of a recording, with rain in front of the capture's images; yields progress after each.

    Images keep their names, sizes and formats. All other files, and images of other recordings in the folder, are the
    same files (hard links where the disk allows it, else copies). A raw drive of KITTI is copied into a folder of its
    day, with the calibration. The copy appears when it is complete.

    Raises:
        ValueError: If images are no files of their own inside the folder, or the unit of the capture is unknown.
        OSError: If the copy can't be written.
    """
    photos = _photos(capture, source)
    world, rainfall = Scene(capture.name, up=capture.up, ego=capture.ego), RainSimulation.start(rain.without_medium)
    calibration = calibration_of_day(source.resolve())
    with whole_folder(target) as whole:
        folder = whole / source.resolve().name if calibration else whole
        for number, (file, view) in enumerate(photos.items()):
            yield Progress(number / len(photos), view.name)
            rainy = rain_on_photo(renderer, world, rainfall, photo_view(world, capture, view), view.image)
            write_image(folder / file.relative_to(source), Image.fromarray(rainy), _JPEG_QUALITY)
        yield Progress(1.0, "Linking all other files")
        for parent, _, names in os.walk(source):
            for file in (Path(parent) / name for name in names):
                if file not in photos:
                    _link(file, folder / file.relative_to(source))
        for file in calibration:
            _link(file, whole / file.name)


def _photos(capture: Capture, source: Path) -> Mapping[Path, CaptureFrame]:
    if capture.has_poses and not capture.is_metric:
        raise ValueError(f"{capture.name}: its unit of length is unknown, and rain falls in meters")
    photos: dict[Path, CaptureFrame] = {}
    for view in capture:
        file = view.image_file
        if file is None or not file.is_relative_to(source):
            raise ValueError(f"{capture.name}: the image of {view.name} is no file of its own in {source}")
        photos[file] = view
    return photos


def _link(file: Path, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(file, path)
    except OSError:  # another disk, or one without hard links
        shutil.copy2(file, path)
