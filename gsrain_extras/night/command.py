"""`gsrain night SCENE -o NIGHT_SCENE`: a scene that was recorded by day, relit by lamps as by night."""

from pathlib import Path
from typing import Annotated

from app.console import counted, print, run_with_progress
from app.options import JsonFile, Orientation, option
from app.outputs import check_scene_folder, check_writable, lock_outputs, write_numbers


def night(
    scene: Annotated[str, option("Scene file or folder, recorded by day.")],
    /,
    *,
    output: Annotated[Path, option("Scene folder to write.", "--output", "-o")],
    lamps: Annotated[
        Path | None,
        option(
            "File of lamps (JSON or YAML), or none. Default: the scene's own, else lanterns along a drive, else two "
            "lamps around an object."
        ),
    ] = None,
    orientation: Orientation | None = None,
    json: JsonFile = None,
) -> None:
    """Relight a scene that was recorded by day as by night: dark sky, lamps, dry and wet colors.

    The reflectance of each Gaussian is estimated from its color, without sun and shadow, and lit by the lamps that are
    mounted on the scene; those of vehicles light rain and water only. The geometry stays.
    """
    from gsrain_engine.scene.formats.scene_files import write_scene
    from gsrain_engine.scene.open import load_sorted_scene

    from .edit import relight

    check_scene_folder(output)
    check_writable(json)
    opened = (orientation or Orientation()).of(load_sorted_scene(scene))
    lock_outputs(output)
    dark = run_with_progress(relight(opened, None if lamps is None else str(lamps)))
    write_scene(dark, output, in_drawing_order=True)
    added = dark.gaussian_count - opened.gaussian_count
    print(f"{output}: {counted(dark.gaussian_count, 'Gaussian')} by night, lit by {counted(len(dark.lamps), 'lamp')}")
    write_numbers(json, {"gaussians": dark.gaussian_count, "gaussians_added": added, "lamps": len(dark.lamps)})
