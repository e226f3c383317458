"""`gsrain convert IN OUT`: from one scene format to another."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.formats.scene_files import names_scene_folder
from gsrain_engine.scene.open_scene import open_scene
from gsrain_engine.scene.paths.files import read_camera_path
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.wet_colors import with_wetness_baked
from gsrain_engine.session.edits.ego_drive import drive_along, drive_along_own_path
from gsrain_engine.session.edits.level import level_from_ground
from gsrain_engine.session.edits.scale import set_camera_height

from ..console import print
from .arguments import JsonFile, write_numbers
from .marked import marked, marked_text
from .orientation import Orientation
from .outputs import check_scene_target, check_writable, hold
from .path_speed import timed_path

_OWN = "own"
"""A scene's own camera path, where a file could be named."""


def convert(
    source: Annotated[str, Parameter(help="Scene file or folder: .ply .compressed.ply .splat .spz .ksplat .sog.")],
    target: Annotated[Path, Parameter(help="File to write (.ply .splat .spz), or a folder for a scene folder.")],
    /,
    *,
    wetness: Annotated[
        float | None,
        Parameter(help="Write the colours of a wetness, 0 clear to 1 soaked; a single file is clear without it."),
    ] = None,
    orientation: Orientation | None = None,
    level: Annotated[
        bool, Parameter(help="Turn the scene until its ground, which is looked for, lies level.", negative="")
    ] = False,
    camera_height: Annotated[
        float | None,
        Parameter(help="Scale the scene until its recorded cameras were so many metres above its ground; levels it."),
    ] = None,
    drive: Annotated[
        str | None,
        Parameter(
            help="Let an ego vehicle drive along a camera path, with a front camera: own for the scene's, or a file "
            "(ours, nerfstudio's, cameras.json of 3DGS). gsrain drive needs one."
        ),
    ] = None,
    speed: Annotated[
        float | None,
        Parameter(help="Speed in m/s along the path of --drive; default: its own times, or walking pace without any."),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Convert a scene. A scene folder remembers which way is up and how long a unit is.

    A single file gets all visible layers, and actors where they stand at time 0, in metres with -y up.
    """
    if wetness is not None and not 0 <= wetness <= 1:
        raise ValueError(f"--wetness {wetness:g}: must be within 0..1")
    check_scene_target(target)
    check_writable(json)
    scene = (orientation or Orientation()).of(open_scene(source))
    hold(target)
    if level or camera_height is not None:
        scene = level_from_ground(scene)
        up = ", ".join(f"{v:.4g}" for v in scene.up)
        print(f"up = ({up}) in the scene's axes, the ground {scene.ground_m:.3g} m high")
    if camera_height is not None:
        scene = set_camera_height(scene, camera_height)
        print(f"1 unit = {scene.metres_per_unit:.4g} m")
    if speed is not None and drive is None:
        raise ValueError(f"--speed {speed:g}: is that of --drive, which is not asked for")
    if drive is not None:
        scene = _driven(scene, drive, speed)
    if wetness is not None:
        if all(each.wet_sh is None for each in scene.members):
            raise ValueError(f"--wetness {wetness:g}: {source} has no wet colours; gsrain recolor makes them")
        scene = with_wetness_baked(scene, wetness)
    write_scene(scene, target)
    if names_scene_folder(target):
        print(f"{target}: {scene.gaussian_count:,} Gaussians{marked_text(marked(scene.members))}")
        write_numbers(json, {"gaussians": scene.gaussian_count, "left_out": 0})
        return
    left_out = [part.left_out.size if part.left_out is not None else 0 for part in scene.parts()]
    kept = sum(len(part.gaussians) for part in scene.parts()) - sum(left_out)
    print(f"{target}: {kept:,} Gaussians{f'; {sum(left_out):,} deleted or hidden ones are left out' * any(left_out)}")
    write_numbers(json, {"gaussians": kept, "left_out": sum(left_out)})


def _driven(scene: Scene, drive: str, speed: float | None) -> Scene:
    """Let an ego vehicle drive along a path, at its own times, or as fast as is asked for or assumed."""
    path = scene.path if drive == _OWN else read_camera_path(drive)
    if path is None:
        return drive_along_own_path(scene)  # says what is missing
    timing = timed_path(path, speed, scene.metres_per_unit)
    if timing.line is not None:
        print(f"{drive}: {timing.line}")
    return drive_along(scene, timing.path)
