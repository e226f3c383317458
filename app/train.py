"""`gsrain reconstruct` and `gsrain recolor`: scenes from captures, and new colors from images."""

from pathlib import Path
from typing import Annotated, Any

import msgspec

from gsrain_engine.appearance.scene_views import OWN_WIDTH_PX
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.image_override import with_images
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.editor.jobs.training import require_torch
from gsrain_engine.evaluation.report import write_report
from gsrain_engine.recolor.problem import RecolorSettings
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.open import load_scene
from gsrain_engine.training.settings import TrainingSettings, load_settings, settings_names

from .console import Console, Table, print, run_with_progress
from .options import (
    AllowOutside,
    JsonFile,
    converted_options,
    let_names_lead_outside,
    option,
    option_error,
    options_of,
    split_words,
)
from .outputs import check_scene_folder, check_writable, lock_outputs, report_path, write_numbers

_COLUMNS = 110

SceneFolder = Annotated[Path, option("Scene folder to write.", "--output", "-o")]
Report = Annotated[Path | None, option("HTML report of the run; default: SCENE.report.html in the folder of SCENE.")]
TrainingOptions = options_of(
    TrainingSettings,
    "steps width_px gaussians density sh_degree seed own_body device",
    {"width_px": "width"},
    default="Default: {}.",
)


def reconstruct(
    capture: Annotated[Path, option("COLMAP, nerfstudio, DGP, nuScenes, KITTI, Waymo, or a capture folder.")],
    /,
    *,
    output: SceneFolder,
    images: Annotated[Path | None, option("Folder of images that replace the capture's own.")] = None,
    masks: Annotated[Path | None, option("Folder with a mask for each camera: white is trained on.")] = None,
    config: Annotated[str | None, option(f"Settings: {', '.join(settings_names())}, or a YAML file.")] = None,
    options: TrainingOptions | None = None,
    held_out: Annotated[str | None, option("Hold out every Nth view (0: none), or these names, with commas.")] = None,
    resume: Annotated[bool, option("Continue from the checkpoint of a stopped run.")] = False,
    report: Report = None,
    lpips: Annotated[Path | None, option("Weights of LPIPS; default: those of this machine, if any.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Fit Gaussians to a capture, and measure them on held-out views. Ctrl-C leaves a checkpoint."""
    let_names_lead_outside(allow_outside)
    changes = (options or TrainingOptions()).changes() | _parse_held_out(held_out)
    try:
        settings = load_settings(config, **changes)
    except msgspec.ValidationError as error:
        raise ValueError(option_error(str(error), changes, TrainingOptions.names)) from None
    check_scene_folder(output)
    lock_outputs(output)
    page = report_path(output, report)
    check_writable(page, json)
    require_torch("gsrain reconstruct")
    # Loading torch takes two seconds, so import it only after the checks.
    from gsrain_engine.training.data import ReconstructionTask
    from gsrain_engine.training.train import reconstruct as work

    task = ReconstructionTask(
        capture=capture, output=output, settings=settings, images=images, masks=masks, resume=resume, lpips=lpips,
        report=page,
    )  # fmt: skip
    try:
        result = run_with_progress(work(task))
    except KeyboardInterrupt:
        if task.checkpoint.is_file():
            print(f"stopped; go on with: gsrain reconstruct {capture} -o {output} --resume (and the same options)")
        raise
    _print(result)
    print(f"{output}: {result.gaussians:,} Gaussians in {result.seconds:.0f} s")
    print(page)
    write_numbers(json, result.numbers)


def _parse_held_out(text: str | None) -> dict[str, Any]:
    if text is None:
        return {}
    if text.isdecimal():
        return {"held_out": int(text), "held_out_views": ()}
    return {"held_out_views": tuple(split_words(text))}


def _print(result: Any) -> None:
    console = _console(result.capture)
    table = Table("view", "PSNR dB", "exposed", "SSIM", "LPIPS", box=None)
    for kind, scores in (("held out", result.held_out), ("learned from", result.learned)):
        for each in scores:
            lpips = "-" if each.lpips is None else f"{each.lpips:.3f}"
            values = f"{each.psnr_db:.2f}", f"{each.psnr_exposed_db:.2f}", f"{each.ssim:.3f}", lpips
            table.add_row(f"{each.name}, {kind}", *values)
    console.print(table)
    console.print(f"Own body: {result.own_body.line}")
    _print_held_out(console, result.numbers, (
        "({psnr_before_db:.2f} dB before training); {psnr_held_out_exposed_db:.2f} dB on their right halves, "
        "exposure fitted on the left"
    ))  # fmt: skip


def _console(capture: Capture) -> Console:
    """Return a console for the results, after the problems of the capture."""
    console = Console(width=_COLUMNS)
    for problem in capture.problems:
        console.print(f"  {problem}")
    return console


def _print_held_out(console: Console, numbers: dict[str, Any], comparison: str) -> None:
    if numbers["psnr_held_out_db"] is None:
        console.print("No view was held out: how well it shows new views is not known.")
    else:
        console.print(f"Held-out views: {numbers['psnr_held_out_db']:.2f} dB {comparison.format(**numbers)}")


# gsrain recolor

_REFINE_STEPS = 300

SolverOptions = options_of(
    RecolorSettings,
    "iterations sh_degree exposure robust memory_mb",
    {"memory_mb": "memory"},
    {
        "iterations": "Steps of conjugate gradients.",
        "sh_degree": "Highest degree of harmonics to solve for, 0..3.",
        "exposure": "Fit an exposure for each image.",
        "robust": "Reduce the weight of images that disagree with the others.",
        "memory_mb": "Memory for stored weights in MB; views beyond it take longer, with 0 all of them.",
    },
    default="Default: {}.",
)


def recolor(
    scene: Annotated[str, option("Scene file or folder; street is the built-in street.")],
    /,
    *,
    images: Annotated[Path, option("Capture with cameras; or, with --capture, a folder of changed images.")],
    output: SceneFolder,
    capture: Annotated[Path | None, option("Capture with the cameras; images are matched by name.")] = None,
    replace: Annotated[bool, option("Replace the clear colors instead of adding wet ones.")] = False,
    solver: SolverOptions | None = None,
    held_out: Annotated[int, option("Hold out every Nth view for measuring; 0: none.")] = 8,
    width: Annotated[int, option("Wider images are downscaled to this width in pixels.")] = OWN_WIDTH_PX,
    photometric_steps: Annotated[int, option("Final steps on absolute differences and structure; needs torch.")] = 0,
    refine: Annotated[bool, option(f"Train all parameters in {_REFINE_STEPS} final steps; needs torch")] = False,
    report: Report = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Solve a scene's colors for images; its geometry stays. The clear colors stay too, unless replaced."""
    let_names_lead_outside(allow_outside)
    from gsrain_engine.recolor.recolor import RecolorOptions, recolor_to_capture  # kernels take a second to load

    options = converted_options(
        {
            "width_px": width, "held_out": held_out, "polish": photometric_steps, "refine": _REFINE_STEPS * refine,
            "replace_clear": replace, "colors": (solver or SolverOptions()).changes(),
        },
        RecolorOptions,
        {"width_px": "width", "polish": "photometric-steps", **SolverOptions.names},
    )  # fmt: skip
    check_scene_folder(output)
    lock_outputs(output)
    page = report_path(output, report)
    check_writable(page, json)
    if photometric_steps or refine:
        require_torch("--photometric-steps" if photometric_steps else "--refine")
    pictures = open_capture(capture or images)
    if capture is not None:
        pictures = with_images(pictures, images)
    run = run_with_progress(recolor_to_capture(load_scene(scene), pictures, options))
    write_scene(run.scene, output)
    _print_recolor(run, pictures)
    print(f"{output}: {run.scene.gaussian_count:,} Gaussians, {'new' if replace else 'clear and wet'} colors")
    write_report(page, run.report)
    print(page)
    write_numbers(json, run.numbers)


def _print_recolor(run: Any, images: Capture) -> None:
    console = _console(images)
    table = Table("view", "clear dB", "mapped dB", "recoloured dB", "trust", box=None)
    for view in run.recolored.views:
        figures = [f"{each:.2f}" for each in (view.psnr_clear_db, view.psnr_mapped_db, view.psnr_db)]
        table.add_row(view.name, *figures, "held out" if view.is_held_out else f"{view.trust:.2f}")
    console.print(table)
    comparison = "({psnr_before_db:.2f} dB clear, {psnr_mapped_db:.2f} dB after the color map), in {seconds:.1f} s"
    _print_held_out(console, run.numbers, comparison)
