"""`gsrain convert IN OUT`: from one scene format to another."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.formats.scene_files import names_scene_folder
from gsrain_engine.scene.open_scene import open_scene
from gsrain_engine.scene.wet_colors import with_wetness_baked

from .marked import marked, marked_text


def convert(
    source: Annotated[str, Parameter(help="Scene file or folder: .ply .compressed.ply .splat .spz .ksplat .sog.")],
    target: Annotated[Path, Parameter(help="File to write (.ply .splat .spz), or a folder for a scene folder.")],
    /,
    *,
    wetness: Annotated[
        float | None,
        Parameter(help="Write the colours of a wetness, 0 clear to 1 soaked; a single file is clear without it."),
    ] = None,
) -> None:
    """Convert a scene. A single file gets all visible layers, and actors where they stand at time 0."""
    if wetness is not None and not 0 <= wetness <= 1:
        raise ValueError(f"--wetness {wetness:g}: must be within 0..1")
    scene = open_scene(source)
    if wetness is not None:
        if all(each.wet_sh is None for each in scene.members):
            raise ValueError(f"--wetness {wetness:g}: {source} has no wet colours; gsrain recolor makes them")
        scene = with_wetness_baked(scene, wetness)
    write_scene(scene, target)
    if names_scene_folder(target):
        print(f"{target}: {scene.gaussian_count:,} Gaussians{marked_text(marked(scene.members))}")
        return
    left_out = [part.left_out.size if part.left_out is not None else 0 for part in scene.parts()]
    kept = sum(len(part.gaussians) for part in scene.parts()) - sum(left_out)
    print(f"{target}: {kept:,} Gaussians{f'; {sum(left_out):,} deleted or hidden ones are left out' * any(left_out)}")
