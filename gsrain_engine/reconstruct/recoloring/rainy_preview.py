"""The job "Make it rainy (preview)": render views, give them a plain wet look, solve the scene's colours for them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsrain_engine.appearance.wet_preview import wet_preview
from gsrain_engine.raster.rasterizer import expected
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from .ground_height import ground_height_m
from .preview_cameras import PreviewCamera
from .recolored_file import write_recolored
from .scene_members import Member, scene_members
from .settings import RecolorSettings
from .setup import set_up_seen
from .views import SeenView, TargetView, seen_view, upness

SETTINGS = RecolorSettings(iterations=10, rounds=1, sh_degree=1, tikhonov=0.3, exposure=False, robust=False)
"""Made views agree with each other, and degree 1 is all that a wet road needs."""

_VIEWS_DONE, _SETUP_DONE, _SOLVED_DONE = 0.4, 0.7, 0.98
"""Shares of the whole job's time, measured on the built-in street."""


def rainy_preview(
    scene: Scene, cameras: Sequence[PreviewCamera], output: Path, strength: float = 1.0
) -> Iterator[Progress]:
    """Write the scene's colours in rain to `output` (read them with `read_recolored`); geometry stays as it is.

    It can be stopped at every step, and then leaves no file. `strength` is that of `wet_preview`.

    Raises:
        ValueError: When there is no camera, or none of them sees anything.
    """
    if not cameras:
        raise ValueError("a preview needs at least one camera")
    members, views = scene_members(scene), list[SeenView]()
    for i, each in enumerate(cameras):
        yield Progress(_VIEWS_DONE * i / len(cameras), f"Rendering view {i + 1} of {len(cameras)}")
        views.append(_wet_view(scene, members, each, strength))
    yield Progress(_VIEWS_DONE, "Estimating how colours change")
    setup = set_up_seen(scene, members, views, len(views), SETTINGS)
    yield Progress(_SETUP_DONE, "Solving colours, step 1")
    change = np.zeros_like(setup.problem.prior)
    for i, step in enumerate(setup.problem.solve(SETTINGS), 1):
        change = step.change
        share = i / SETTINGS.iterations
        yield Progress(_SETUP_DONE + (_SOLVED_DONE - _SETUP_DONE) * share, f"Solving colours, step {i + 1}")
    yield Progress(_SOLVED_DONE, "Writing colours")
    write_recolored(output, setup.colors(setup.problem.prior + change))
    yield Progress(1.0, "Done")


def _wet_view(scene: Scene, members: list[Member], preview: PreviewCamera, strength: float) -> SeenView:
    camera, ground_m = preview.camera, ground_height_m(scene)
    target = TargetView("preview", camera, preview.time_s, np.zeros((camera.height, camera.width, 3), np.float32))
    seen = seen_view(scene, members, target, ground_m)
    sky = expected(np.ascontiguousarray(seen.surfaces[..., 0]), seen.alpha)
    up = upness(seen.depth, camera)
    wet = wet_preview(seen.clear, seen.depth, up, sky, camera, ground_m=ground_m, strength=strength)
    return replace(seen, target=replace(target, image=wet))
