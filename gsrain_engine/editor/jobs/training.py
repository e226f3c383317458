"""Jobs of the `jobs` extra: recolor, reconstruct; and the check for torch."""

from collections.abc import Generator, Iterator
from pathlib import Path

from ...datasets.image_override import with_images
from ...datasets.open_capture import open_capture
from ...optional_packages import require_package
from ...recolor.recolor import RecolorOptions, RecolorRun, recolor_to_capture
from ...recolor.result import read_recolored, with_colors, write_recolored
from ...report.page import write_report
from ...safe_io.errors import SceneFormatError
from ...scene.formats.scene_files import read_scene
from ...scene.formats.scene_folder import FileCache
from ...scene.progress import Progress
from ...scene.scene import Scene
from ...training.data import ReconstructionTask
from ...training.settings import TrainingSettings
from .folder import new_report, write_copy
from .job import Job

_STARTING = Progress(0.0, "Starting")

# Job "Recolor": solve for wet colors so that the scene matches given images

COLORS_FILE = "colors.npz"
SOLVER_PLOTS = {"Residual": ("residual",)}


def recolor_job(
    scene: Scene, known: FileCache, capture: Path, images: Path | None, *, allow_outside: bool = False
) -> Job[Scene]:
    """Create a job that recolors a scene; `known` are its files.

    `capture` provides the cameras, and the images unless the folder `images` has others under the same names.
    """
    name = (images or capture).name
    report = new_report(f"{scene.name} to {name}")

    def inputs(folder: Path) -> tuple[object, ...]:
        return write_copy(scene, folder, known), capture, images, folder / COLORS_FILE, report, allow_outside

    def read(folder: Path) -> Scene:
        return with_colors(scene, read_recolored(folder / COLORS_FILE))

    return Job("recolor", f"Recolor to {name}", recolor_scene_copy, read, inputs, report=report, plots=SOLVER_PLOTS)


def recolor_scene_copy(
    copy: Path, capture: Path, images: Path | None, output: Path, report: Path, allow_outside: bool
) -> Iterator[Progress]:
    """Worker: solve for a saved scene's wet colors and write them."""
    yield Progress(0.0, "Reading the scene")
    run = yield from recolored_to(read_scene(copy), capture, images, allow_outside)
    write_report(report, run.report)
    write_colors(output, run.scene)


def recolored_to(
    scene: Scene, capture: Path, images: Path | None, allow_outside: bool
) -> Generator[Progress, None, RecolorRun]:
    """Solve for a scene's wet colors, in this process; yields and raises as `recolor_to_capture` does."""
    pictures = open_capture(capture, allow_outside=allow_outside)
    return (
        yield from recolor_to_capture(
            scene, pictures if images is None else with_images(pictures, images), RecolorOptions()
        )
    )


def write_colors(file: Path, scene: Scene) -> None:
    """Write a scene's wet colors, for `read_recolored`."""
    write_recolored(file, {each.key: each.wet_sh for each in scene.members if each.wet_sh is not None})


# Job "Reconstruct": Gaussians from a capture, with snapshots in the viewport


def reconstruction_job(capture: Path, settings: TrainingSettings, *, allow_outside: bool = False) -> Job[Scene]:
    """Create a job whose snapshots and result are whole scenes."""
    report, read_ns = new_report(capture.name), 0

    def inputs(folder: Path) -> tuple[ReconstructionTask]:
        task = ReconstructionTask(
            capture=capture, output=folder / "scene", settings=settings, report=report,
            snapshot=folder / "snapshot", allow_outside=allow_outside,
        )  # fmt: skip
        return (task,)

    def snapshot(folder: Path) -> Scene | None:
        nonlocal read_ns
        try:
            written_ns = (folder / "snapshot" / "scene.json").stat().st_mtime_ns
            scene = read_scene(folder / "snapshot") if written_ns != read_ns else None
        except (OSError, SceneFormatError):
            return None  # not there yet, or being replaced: a later one follows
        read_ns = written_ns
        return scene

    return Job(
        "reconstruct", f"Reconstruct {capture.name}", reconstruct_capture, lambda folder: read_scene(folder / "scene"),
        inputs, snapshot, report=report, progress=_STARTING,
        plots={"Loss": ("loss",), "PSNR of held-out views (dB)": ("psnr_held_out_db",)},
    )  # fmt: skip


def reconstruct_capture(task: ReconstructionTask) -> Iterator[Progress]:
    """Worker: reconstruct a capture, with torch."""
    require_package("torch", "reconstructing")
    from ...training.train import reconstruct

    yield from reconstruct(task)
