"""The rainy look as work for another process: scene in by folder, colours out by file."""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from gsrain_engine.reconstruct.recoloring.preview_cameras import preview_cameras
from gsrain_engine.reconstruct.recoloring.rainy_preview import rainy_preview
from gsrain_engine.reconstruct.recoloring.recolored_file import read_recolored
from gsrain_engine.scene.formats import read_scene
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

VIEWS = 8


def make_rainy(scene_folder: Path, output: Path) -> Iterator[Progress]:
    """Work of the job "Make it rainy (preview)": solve for the colours in which a saved scene's views look wet."""
    yield Progress(0.0, "Reading the scene")
    scene = read_scene(scene_folder)
    yield from rainy_preview(scene, preview_cameras(scene, VIEWS), output)


def rainy_scene(scene: Scene) -> Iterator[tuple[Progress, Scene]]:
    """Give a scene wet colours in this process; the last pair holds the result."""
    with tempfile.TemporaryDirectory(prefix="gsrain-") as folder:
        output = Path(folder) / "colors.npz"
        for progress in rainy_preview(scene, preview_cameras(scene, VIEWS), output):
            yield progress, scene
        yield Progress(1.0, "Done"), with_colors(scene, read_recolored(output))


def with_colors(scene: Scene, colors: Mapping[str, Float32[np.ndarray, "n k 3"]]) -> Scene:
    """Return the scene with wet colours, by `layers/NAME` and `actors/ID`; what is not named keeps what it has.

    Colours are of all of a member's Gaussians, or of those that are not deleted: files know no others.
    """
    for key, sh in colors.items():
        member = scene.member(key)
        deleted = member.marks.deleted
        if deleted is not None and len(sh) < len(member.gaussians):
            whole = member.gaussians.sh.copy()
            whole[(~deleted).indices] = sh
            sh = whole
        scene = scene.with_member(key, wet_sh=sh)
    return scene
