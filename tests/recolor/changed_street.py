"""Pictures of the small street in other colors that are known."""

from dataclasses import replace

import numpy as np

from gsrain_engine.appearance.scene_views import chosen_cameras
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.recolor.views import TargetView
from gsrain_engine.scene.scene import Scene
from rasterized import rasterize
from training.small_street import small_street

SIZE = (96, 64)


def changed(scene: Scene) -> Scene:
    """Darken everything, tint it, and make single Gaussians and directions differ."""
    r = np.random.default_rng(0)
    for each in scene.members:
        sh = each.gaussians.sh * np.float32([0.8, 0.7, 0.9])
        sh[:, 0] += r.normal(-0.3, 0.15, (len(sh), 3)).astype(np.float32)
        sh[:, 1:] += r.normal(0, 0.05, sh[:, 1:].shape).astype(np.float32)
        scene = scene.with_member(each.key, gaussians=each.gaussians.with_sh(sh))
    return scene


def pictures(scene: Scene) -> list[TargetView]:
    views = []
    for i, placed in enumerate(chosen_cameras(scene, ViewChoice(count=6))):
        small = placed.camera.resized(*SIZE)
        image = np.clip(rasterize(scene.parts(placed.time_s), small).over(), 0, 1).astype(np.float32)
        views.append(TargetView(f"view {i}", small, placed.time_s, image))
    return views


def street_and_pictures() -> tuple[Scene, Scene, list[TargetView]]:
    """The clear street, the changed one, and pictures of that."""
    clear = small_street()
    other = changed(clear)
    return clear, other, pictures(other)


def with_image(view: TargetView, image: np.ndarray) -> TargetView:
    return replace(view, image=np.clip(image, 0, 1).astype(np.float32))
