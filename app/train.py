"""`gsrain reconstruct` and `gsrain recolor`: scenes from captures, and new colors from images."""

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from cyclopts import Parameter

from gsrain_engine.appearance.scene_views import OWN_WIDTH_PX
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.editor.jobs.training import require_torch
from gsrain_engine.evaluation.report import write_report
from gsrain_engine.recolor.problem import RecolorSettings
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.open import load_scene
from gsrain_engine.training.settings import TrainingSettings, help_of, load_settings, settings_names

from .console import Console, Table, print
from .options import (
    AllowOutside,
    JsonFile,
    check_scene_folder,
    check_writable,
    converted_options,
    let_names_lead_outside,
    lock_outputs,
    report_path,
    write_numbers,
)
from .progress import followed

_COLUMNS = 110


def reconstruct(
    capture: Annotated[Path, Parameter(help="COLMAP, nerfstudio, DGP, nuScenes, KITTI, Waymo, or a capture folder.")],
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Scene folder to write.")],
    images: Annotated[Path | None, Parameter(help="Folder with pictures to take instead of the capture's own.")] = None,
    masks: Annotated[
        Path | None,
        Parameter(help="Folder with a picture for each camera, named like it: white is learned from, black isn't."),
    ] = None,
    config: Annotated[
        str | None, Parameter(help=f"Settings: {', '.join(settings_names())}, or a YAML file; options go on top.")
    ] = None,
    steps: Annotated[int | None, Parameter(help=help_of("steps"))] = None,
    width: Annotated[int | None, Parameter(help=help_of("width_px"))] = None,
    gaussians: Annotated[int | None, Parameter(help=help_of("gaussians"))] = None,
    density: Annotated[Literal["adaptive", "mcmc"] | None, Parameter(help=help_of("density"))] = None,
    sh_degree: Annotated[int | None, Parameter(help=help_of("sh_degree"))] = None,
    held_out: Annotated[
        str | None, Parameter(help="Keep every Nth view for measuring (0: none), or these names, with commas between.")
    ] = None,
    seed: Annotated[int | None, Parameter(help=help_of("seed"))] = None,
    own_body: Annotated[
        bool | None,
        Parameter(
            help="Look for the vehicle's own body in the pictures, and leave it out; default: only where the capture "
            "is a drive (a rig on a vehicle, or odometry)."
        ),
    ] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Parameter(help=help_of("device"))] = None,
    resume: Annotated[bool, Parameter(help="Go on from the checkpoint that a stopped run left beside SCENE.")] = False,
    report: Annotated[
        Path | None, Parameter(help="HTML report of the run; default: beside SCENE, as SCENE.report.html.")
    ] = None,
    lpips: Annotated[Path | None, Parameter(help="Weights of LPIPS; default: those of this machine, if any.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Fit Gaussians to a capture, and measure them on held-out views. Ctrl-C leaves a checkpoint."""
    let_names_lead_outside(allow_outside)
    settings = _settings(
        config, steps=steps, width_px=width, gaussians=gaussians, density=density, sh_degree=sh_degree, seed=seed,
        own_body=own_body, device=device, **_parse_held_out(held_out),
    )  # fmt: skip
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
        result = followed(work(task))
    except KeyboardInterrupt:
        if task.checkpoint.is_file():
            print(f"stopped; go on with: gsrain reconstruct {capture} -o {output} --resume (and the same options)")
        raise
    _print(result, output)
    print(f"{output}: {result.gaussians:,} Gaussians in {result.seconds:.0f} s")
    print(page)
    write_numbers(json, result.numbers)


def _settings(config: str | None, **options: Any) -> TrainingSettings:
    try:
        return load_settings(config, **options)
    except msgspec.ValidationError as error:
        field = str(error).rpartition("$.")[2].strip("`")
        option = {"width_px": "width"}.get(field, field).replace("_", "-")
        raise ValueError(f"--{option}: {error}") from None


def _parse_held_out(text: str | None) -> dict[str, Any]:
    if text is None:
        return {}
    if text.isdecimal():
        return {"held_out": int(text), "held_out_views": ()}
    return {"held_out_views": tuple(name.strip() for name in text.split(",") if name.strip())}


def _print(result: Any, output: Path) -> None:
    console = Console(width=_COLUMNS, highlight=False)
    for problem in result.capture.problems:
        console.print(f"  {problem}", markup=False)
    table = Table("view", "PSNR dB", "exposed", "SSIM", "LPIPS", box=None)
    for kind, scores in (("held out", result.held_out), ("learned from", result.learned)):
        for each in scores:
            lpips = "-" if each.lpips is None else f"{each.lpips:.3f}"
            table.add_row(
                f"{each.name}, {kind}", f"{each.psnr_db:.2f}", f"{each.psnr_exposed_db:.2f}", f"{each.ssim:.3f}", lpips
            )
    console.print(table)
    console.print(f"Own body: {result.own_body.line}", markup=False)
    numbers = result.numbers
    if numbers["psnr_held_out_db"] is None:
        console.print("No view was held out: how well it shows new views is not known.")
        return
    console.print(
        f"Held-out views: {numbers['psnr_held_out_db']:.2f} dB ({numbers['psnr_before_db']:.2f} dB before training); "
        f"{numbers['psnr_held_out_exposed_db']:.2f} dB on their right halves, exposure fitted on the left"
    )


# gsrain recolor

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
    """Solve a scene's colors for images; its geometry stays. The clear colors stay too, unless replaced."""
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
    lock_outputs(output)
    page = report_path(output, report)
    check_writable(page, json)
    if polish or refine:
        require_torch("--polish" if polish else "--refine")
    pictures = _images(images, capture)
    # Loading kernels takes a second, so import them only after the checks.
    from gsrain_engine.recolor.recolor import recolor_to_capture

    run = followed(recolor_to_capture(load_scene(scene), pictures, options))
    write_scene(run.scene, output)
    _print_recolor(run, pictures)
    print(f"{output}: {run.scene.gaussian_count:,} Gaussians, {'new' if replace else 'clear and wet'} colours")
    write_report(page, run.report)
    print(page)
    write_numbers(json, run.numbers)


def _options(options: dict[str, Any], colors: dict[str, Any], *, replace_clear: bool) -> Any:
    from gsrain_engine.recolor.recolor import RecolorOptions

    values = options | {"replace_clear": replace_clear, "colors": colors}
    return converted_options(values, RecolorOptions, {"width_px": "width", "memory_mb": "memory"})


def _images(images: Path, capture: Path | None) -> Capture:
    if capture is None:
        return open_capture(images)
    from gsrain_engine.datasets.image_override import with_images

    return with_images(open_capture(capture), images)


def _print_recolor(run: Any, pictures: Capture) -> None:
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
