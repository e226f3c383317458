"""`gsrain reconstruct CAPTURE -o SCENE`: images, with lidar or COLMAP points, become Gaussians."""

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from cyclopts import Parameter

from gsrain_engine.reconstruct.training.settings import TrainingSettings, help_of, load_settings, settings_names
from gsrain_engine.session.jobs.torch_extra import require_torch

from ..console import Console, Table, print
from .arguments import AllowOutside, JsonFile, let_names_lead_outside, write_numbers
from .outputs import check_scene_folder, check_writable, hold, report_beside
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
    """Fit Gaussians to a capture, and measure them on views that were kept apart. Ctrl-C leaves a checkpoint."""
    let_names_lead_outside(allow_outside)
    settings = _settings(
        config, steps=steps, width_px=width, gaussians=gaussians, density=density, sh_degree=sh_degree, seed=seed,
        own_body=own_body, device=device, **_kept_apart(held_out),
    )  # fmt: skip
    check_scene_folder(output)
    hold(output)
    page = report_beside(output, report)
    check_writable(page, json)
    require_torch("gsrain reconstruct")
    # torch takes two seconds to load: only now, that there is something to do.
    from gsrain_engine.reconstruct.training.task import ReconstructionTask
    from gsrain_engine.reconstruct.training.training import reconstruct as work

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


def _kept_apart(text: str | None) -> dict[str, Any]:
    """Turn "8" or "a,b" into settings."""
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
