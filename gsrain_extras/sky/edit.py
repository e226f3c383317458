"""The edit `sky` of a scene: for the window, `gsrain edit` and `gr.edit`."""

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.datasets.io.images import read_color
from gsrain_engine.editor.scene_edits import SceneEdit
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene, is_sky
from gsrain_engine.scene.skies import LIGHTINGS, LightingName
from gsrain_engine.scene.sky_dome import dome_layer, sample_panorama
from gsrain_engine.scene.transforms import transform_gaussians

_SUN = np.array([0.45, -0.55, 0.70]) / np.linalg.norm([0.45, -0.55, 0.70])
_SEED = 1
_WIDE, _TOLERANCE = 2.0, 0.02  # width over height of a panorama, and how far another may be from it


def put_up_sky(
    scene: Scene, picture: str | None = None, look: LightingName = "sunny", turn_deg: float = 0.0
) -> Generator[Progress, None, Scene]:
    """Put a dome around a scene, in place of its sky layers.

    `picture` is the file of an equirectangular panorama, whose middle is seen along +x of the world; None takes the
    computed sky of `look`. Either is turned to the left by `turn_deg`. Colors are display colors.

    Raises ValueError for a picture that can't be read, or is not twice as wide as high.
    """
    yield Progress(0.1, "Reading the picture" if picture else "Computing the sky")
    panorama = None if picture is None else _panorama(Path(picture))
    angle = np.radians(turn_deg)
    back = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])

    def colors(directions: Float64[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        turned = directions @ back.T
        if panorama is None:
            return LIGHTINGS[look].sky_display(turned, _SUN, _SEED).astype(np.float32)
        return sample_panorama(panorama, turned)

    to_world = scene.scene_to_world
    others = tuple(layer for layer in scene.layers if not is_sky(layer))
    placed = [
        replace(
            layer, gaussians=transform_gaussians(layer.gaussians, to_world @ layer.to_scene), wet_sh=None, tree=None
        )
        for layer in others
    ]
    sky = replace(dome_layer(colors, placed), to_scene=np.linalg.inv(to_world))
    return replace(scene, layers=(*others, sky))


def _panorama(file: Path) -> Float32[np.ndarray, "h w 3"]:
    picture = read_color(file)
    height, width = picture.shape[:2]
    if abs(width / height - _WIDE) > _TOLERANCE:
        raise ValueError(f"{file}: a panorama is twice as wide as high, not {width} x {height} pixels")
    return picture.astype(np.float32) / np.float32(255)


EDIT = SceneEdit(
    "Put up a sky",
    "Surround a scene by a clear sky, in place of its own; gsrain edit also takes a panorama, or another weather.",
    put_up_sky,
)
