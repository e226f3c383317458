"""`gsrain reconstruct` and `gsrain recolor`: scenes from captures, and new colors from images."""

from pathlib import Path
from typing import Annotated

import msgspec

from gsrain_engine.optional_packages import require_package
from gsrain_engine.recolor.settings import RecolorOptions, RecolorSettings
from gsrain_engine.training.settings import TrainingSettings, load_settings, settings_names

from .console import print, print_lines, run_with_progress
from .options import (
    AllowOutside,
    JsonFile,
    let_names_lead_outside,
    option,
    option_error,
    options_of,
    takes_set,
)
from .outputs import check_scene_folder, check_writable, lock_outputs, report_path, write_numbers

SceneFolder = Annotated[Path, option("Scene folder to write.", "--output", "-o", topic="Output")]
Report = Annotated[
    Path | None, option("HTML report of the run; default: SCENE.report.html in the folder of SCENE.", topic="Output")
]
TrainingOptions = options_of(TrainingSettings, "reconstruct", topic="Training")


@takes_set
def reconstruct(
    capture: Annotated[
        Path, option("COLMAP, nerfstudio, DGP, nuScenes, KITTI, Argoverse 2, Waymo, or a capture folder.")
    ],
    /,
    *,
    output: SceneFolder,
    images: Annotated[Path | None, option("Folder of images that replace the capture's own.")] = None,
    masks: Annotated[Path | None, option("Folder with a mask for each camera: white is trained on.")] = None,
    config: Annotated[str | None, option(f"Settings: {', '.join(settings_names())}, or a YAML file.")] = None,
    options: TrainingOptions | None = None,
    resume: Annotated[bool, option("Continue from the checkpoint of a stopped run.")] = False,
    report: Report = None,
    lpips: Annotated[Path | None, option("Weights of LPIPS; default: those of this machine, if any.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Fit Gaussians to a capture, and measure them on held-out views. Ctrl-C leaves a checkpoint."""
    let_names_lead_outside(allow_outside)
    try:
        settings = load_settings(config, **(options or TrainingOptions()).changes())
    except msgspec.ValidationError as error:
        raise ValueError(option_error(str(error), TrainingSettings)) from None
    check_scene_folder(output)
    lock_outputs(output)
    page = report_path(output, report)
    check_writable(page, json)
    require_package("torch", "gsrain reconstruct")
    # Loading torch takes two seconds, so import it only after the checks.
    from gsrain_engine.training.data import ReconstructionTask
    from gsrain_engine.training.train import reconstruct as work
    from gsrain_engine.training.train import reconstruction_result

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
    done = reconstruction_result(result, output)
    print_lines(done.table.text)
    for line in done.lines:
        print(line)
    print(page)
    write_numbers(json, done.numbers)


# gsrain recolor

SolverOptions = options_of(RecolorSettings, "recolor", topic="Method")
RunOptions = options_of(
    RecolorOptions, "recolor", topic="Method", fixed={"colors": "each of its fields, such as --set iterations=20,"}
)


@takes_set
def recolor(
    scene: Annotated[str, option("Scene file or folder; street is the built-in street.")],
    /,
    *,
    images: Annotated[Path, option("Capture with cameras; or, with --capture, a folder of changed images.")],
    output: SceneFolder,
    capture: Annotated[Path | None, option("Capture with the cameras; images are matched by name.")] = None,
    run: RunOptions | None = None,
    solver: SolverOptions | None = None,
    report: Report = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Solve a scene's colors for images; its geometry stays. The clear colors stay too, unless replaced."""
    from gsrain_engine.datasets.image_override import with_images
    from gsrain_engine.datasets.open_capture import open_capture
    from gsrain_engine.recolor.recolor import recolor_to_capture
    from gsrain_engine.report.page import write_report
    from gsrain_engine.scene.formats.scene_files import write_scene
    from gsrain_engine.scene.open import load_scene

    let_names_lead_outside(allow_outside)
    options = (run or RunOptions()).settings(colors=(solver or SolverOptions()).changes())
    check_scene_folder(output)
    lock_outputs(output)
    page = report_path(output, report)
    check_writable(page, json)
    if options.polish or options.refine:
        require_package("torch", "--photometric-steps" if options.polish else "--refine")
    pictures = open_capture(capture or images)
    if capture is not None:
        pictures = with_images(pictures, images)
    recolored = run_with_progress(recolor_to_capture(load_scene(scene), pictures, options))
    write_scene(recolored.scene, output)
    done = recolored.result
    print_lines(done.table.text)
    for line in done.lines:
        print(line)
    colors = "new" if options.replace_clear else "clear and wet"
    print(f"{output}: {recolored.scene.gaussian_count:,} Gaussians, {colors} colors")
    write_report(page, recolored.report)
    print(page)
    write_numbers(json, done.numbers)
