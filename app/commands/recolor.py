"""`gsrain recolor SCENE --images DIR -o SCENE`: a scene takes on the look of pictures."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from gsrain_engine.appearance.views.choice import OWN_WIDTH_PX
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.reconstruct.recoloring.settings import RecolorSettings
from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.open_scene import open_scene
from gsrain_engine.session.jobs.torch_extra import require_torch

from ..console import Console, Table, print
from .arguments import AllowOutside, JsonFile, let_names_lead_outside, write_numbers
from .converted_options import converted_options
from .outputs import check_scene_folder, check_writable, hold, report_beside
from .progress import followed

_COLUMNS = 110
_REFINE_STEPS = 300


def recolor(
    scene: Annotated[str, Parameter(help="Scene file or folder; street is the built-in street.")],
    /,
    *,
    images: Annotated[Path, Parameter(help="Capture with cameras; or, with --capture, a folder of its pictures anew.")],
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Scene folder to write.")],
    capture: Annotated[
        Path | None, Parameter(help="Where the cameras come from; pictures are matched by name: SENSOR/NAME or NAME.")
    ] = None,
    replace: Annotated[
        bool, Parameter(help="Put the new colours in place of the clear ones, not beside them as wet ones.")
    ] = False,
    iterations: Annotated[int, Parameter(help="Steps of conjugate gradients.")] = RecolorSettings().iterations,
    sh_degree: Annotated[int, Parameter(help="Highest degree of harmonics to solve for, 0..3.")] = 3,
    held_out: Annotated[int, Parameter(help="Every so-many-th view only measures the result; 0: none.")] = 8,
    width: Annotated[
        int, Parameter(help="Wider pictures are made smaller, to so many pixels; others are taken as they are.")
    ] = OWN_WIDTH_PX,
    polish: Annotated[int, Parameter(help="Steps for absolute differences and structure afterwards; needs torch.")] = 0,
    refine: Annotated[
        bool, Parameter(help=f"Let all parameters move afterwards, in {_REFINE_STEPS} steps; needs torch.")
    ] = False,
    exposure: Annotated[bool, Parameter(help="Whether each picture has an exposure of its own.")] = True,
    robust: Annotated[bool, Parameter(help="Whether pictures that disagree with the others count less.")] = True,
    memory: Annotated[
        float,
        Parameter(help="Room for stored weights in MB; views beyond it take longer; at 0 all takes 1.2 times as long."),
    ] = 4096.0,
    report: Annotated[
        Path | None, Parameter(help="HTML report of the run; default: beside SCENE, as SCENE.report.html.")
    ] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Solve a scene's colours for pictures; its geometry stays. The clear colours stay too, unless replaced."""
    let_names_lead_outside(allow_outside)
    options = _options(
        {"width_px": width, "held_out": held_out, "polish": polish, "refine": _REFINE_STEPS * refine},
        {
            "iterations": iterations, "sh_degree": sh_degree, "exposure": exposure, "robust": robust,
            "memory_mb": memory,
        },
        replace_clear=replace,
    )  # fmt: skip
    check_scene_folder(output)
    hold(output)
    page = report_beside(output, report)
    check_writable(page, json)
    if polish or refine:
        require_torch("--polish" if polish else "--refine")
    pictures = _pictures(images, capture)
    # Kernels take a second to load: only now, that there is something to do.
    from gsrain_engine.reconstruct.recoloring.run import recolor_to_capture

    run = followed(recolor_to_capture(open_scene(scene), pictures, options))
    write_scene(run.scene, output)
    _print(run, pictures)
    print(f"{output}: {run.scene.gaussian_count:,} Gaussians, {'new' if replace else 'clear and wet'} colours")
    write_report(page, run.report)
    print(page)
    write_numbers(json, run.numbers)


def _options(options: dict[str, Any], colors: dict[str, Any], *, replace_clear: bool) -> Any:
    from gsrain_engine.reconstruct.recoloring.run import RecolorOptions

    values = options | {"replace_clear": replace_clear, "colors": colors}
    return converted_options(values, RecolorOptions, {"width_px": "width", "memory_mb": "memory"})


def _pictures(images: Path, capture: Path | None) -> Capture:
    if capture is None:
        return open_capture(images)
    from gsrain_engine.datasets.other_pictures import with_images

    return with_images(open_capture(capture), images)


def _print(run: Any, pictures: Capture) -> None:
    console = Console(width=_COLUMNS, highlight=False)
    for problem in pictures.problems:
        console.print(f"  {problem}", markup=False)
    table = Table("view", "clear dB", "mapped dB", "recoloured dB", "trust", box=None)
    for view in run.recolored.views:
        figures = [f"{each:.2f}" for each in (view.psnr_clear_db, view.psnr_mapped_db, view.psnr_db)]
        table.add_row(view.name, *figures, "held out" if view.is_held_out else f"{view.trust:.2f}")
    console.print(table)
    numbers = run.numbers
    if numbers["psnr_held_out_db"] is None:
        console.print("No view was held out: how well it shows new views is not known.")
        return
    console.print(
        f"Held-out views: {numbers['psnr_held_out_db']:.2f} dB ({numbers['psnr_before_db']:.2f} dB clear, "
        f"{numbers['psnr_mapped_db']:.2f} dB after the colour map), in {numbers['seconds']:.1f} s"
    )
