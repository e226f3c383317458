"""Jobs "Make it rainy" (transfer views, then solve for wet colors) and "Preview" (transfer the current view)."""

import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float32, UInt8

from ...appearance.base import ClearView, RainyView, Transfer, TransferSettings
from ...appearance.registry import find_method, open_transfer
from ...appearance.scene_views import PlacedCamera, chosen_cameras, evenly_spaced_indices, scene_views
from ...appearance.view_choice import ViewChoice
from ...appearance.wet_look.settings import WetSettings
from ...datasets.open_capture import open_capture
from ...evaluation.image_metrics import compare_images
from ...optional_packages import require_package
from ...recolor.cached_colors import cached_scene, wet_color_file
from ...recolor.problem import RecolorSettings
from ...recolor.recolor import rainy_scene, wet_scene
from ...recolor.result import read_recolored, with_colors
from ...recolor.views import thumbnail
from ...render.cpu.renderer import CpuRenderer
from ...report.charts import ImageComparison
from ...report.page import RunReport, write_report
from ...safe_io.numpy_files import read_archive
from ...scene.camera import Camera
from ...scene.formats.scene_files import read_scene
from ...scene.formats.scene_folder import FileCache
from ...scene.progress import Progress, subprogress
from ...scene.scene import Scene
from .folder import new_report, write_copy
from .job import Job
from .training import COLORS_FILE, SOLVER_PLOTS, write_colors

MAKE_RAINY_TITLE = "Apply wet look"

# Transfer job


@dataclass(frozen=True, slots=True)
class TransferRequest:
    """Method, settings and views of a transfer."""

    method: str
    settings: TransferSettings
    choice: ViewChoice
    capture: Path | None = None
    """The scene's capture, for views from it."""
    allow_outside: bool = False
    """True if files outside of the capture's folder that its files refer to may be read."""


def make_rainy_job(scene: Scene, known: FileCache, order: TransferRequest) -> Job[Scene]:
    """Create the job for a scene; `known` are its files.

    The computed wet look is read from the cache of `gsrain render --wet`, or computed and written there.
    """
    report = new_report(f"{scene.name} made rainy")

    def inputs(folder: Path) -> tuple[Path, TransferRequest, Path, Path, Path | None]:
        cache = None
        if order.method == "wet":
            cache = wet_color_file(scene, wet_settings(order))
        return write_copy(scene, folder, known), order, folder / COLORS_FILE, report, cache

    def read(folder: Path) -> Scene:
        return with_colors(scene, read_recolored(folder / COLORS_FILE))

    return Job("make rainy", MAKE_RAINY_TITLE, make_rainy, read, inputs, report=report, plots=SOLVER_PLOTS)


# Preview job

PreviewPicture = Literal["clear", "framed", "guide", "rainy"]
PREVIEW_PICTURES: tuple[PreviewPicture, ...] = get_args(PreviewPicture)

_IMAGES_FILE = "images.npz"


class PreviewSettings(NamedTuple):
    """A method and its settings."""

    method: str
    settings: TransferSettings


@dataclass(frozen=True, slots=True, eq=False)
class PreviewImages:
    """Images of a transferred view: before and after, and the input of a network."""

    pictures: Mapping[PreviewPicture, UInt8[np.ndarray, "h w 3"]]
    """Display color, in the order of the transfer; only clear and rainy for methods without a network."""
    note: str = ""
    """Sentence about the network's input; empty for methods without a network."""

    @classmethod
    def of(cls, rainy: RainyView) -> "PreviewImages":
        """Collect the images of a transfer's result."""
        pictures: dict[PreviewPicture, UInt8[np.ndarray, "h w 3"]] = {"clear": to_display_bytes(rainy.clear.image)}
        if rainy.framed is not None:
            pictures["framed"] = rainy.framed.image
            if rainy.framed.guide is not None:
                pictures["guide"] = np.repeat(rainy.framed.guide[..., None], 3, axis=2)
        pictures["rainy"] = to_display_bytes(rainy.image)
        return cls(pictures, network_note(rainy))

    def write(self, path: Path) -> None:
        """Write an .npz file."""
        with path.open("wb") as stream:
            np.savez(stream, note=np.array(self.note), **self.pictures)

    @classmethod
    def read(cls, path: Path) -> "PreviewImages":
        """Read the file of `write`."""
        arrays = read_archive(path)
        pictures: dict[PreviewPicture, UInt8[np.ndarray, "h w 3"]] = {
            name: arrays[name] for name in PREVIEW_PICTURES if name in arrays
        }
        return cls(pictures, str(arrays["note"]))


@dataclass(frozen=True, slots=True, eq=False)
class PreviewedView:
    """A transferred view with its images and settings."""

    images: PreviewImages
    camera: Camera
    """In the world, of the viewport's size at the time of the request."""
    time_s: float
    scene: Scene
    recipe: PreviewSettings

    def is_of(self, camera: Camera, time_s: float, scene: Scene) -> bool:
        """Return whether a view is the same, of a scene that looks the same when dry."""
        own = self.camera
        return (
            np.allclose(own.world_to_camera, camera.world_to_camera, atol=_SAME)
            and abs(own.height / own.fy - camera.height / camera.fy) < _SAME
            and abs(own.width / own.height - camera.width / camera.height) < _SAME_SHAPE
            and (not scene.actors or abs(self.time_s - time_s) < _SAME)
            and (self.scene is scene or _dry(self.scene).geometry_key == _dry(scene).geometry_key)
        )


_SAME = 1e-4  # tolerance of pose entries and of the field of view
_SAME_SHAPE = 0.01  # tolerance of the aspect ratio: a viewport has whole pixels


def _dry(scene: Scene) -> Scene:
    for member in scene.members:
        if member.wet_sh is not None:
            scene = scene.with_member(member.key, wet_sh=None)
    return scene


def preview_job(
    scene: Scene, camera: Camera, time_s: float, recipe: PreviewSettings, width_px: int, known: FileCache
) -> Job[PreviewImages]:
    """Create a job that transfers a view in the world, at most `width_px` wide; `known` are the scene's files."""
    placed = PlacedCamera("Preview", camera, time_s).at_width(min(width_px, camera.width))

    def inputs(folder: Path) -> tuple[object, ...]:
        return write_copy(scene, folder, known), *recipe, placed, folder / _IMAGES_FILE

    def read(folder: Path) -> PreviewImages:
        return PreviewImages.read(folder / _IMAGES_FILE)

    return Job("preview", "Preview", preview_view, read, inputs)


# Workers

_READ, _RENDERED = 0.2, 0.6  # progress after reading and after rendering
_PREVIEWED = 0.3  # progress of the computed wet look after its previews


def make_rainy(
    copy: Path, order: TransferRequest, output: Path, report: Path, cache: Path | None = None
) -> Iterator[Progress]:
    """Worker of "Make it rainy": transfer views of a saved scene, solve for its wet colors and write them.

    Colors are read from `cache`, if that file is there, or written to it.
    """
    yield Progress(0.0, "Reading the scene")
    scene = read_scene(copy)
    compared = ComparisonReport(_opened(order.method, order.settings, scene))
    steps = rainy_by(scene, order, compared)
    if cache is not None:
        steps = cached_scene(scene, cache, lambda: rainy_by(scene, order, compared))
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            rainy = end.value
            break
        yield step._replace(note=compared.note)
    write_report(report, compared.report(rainy, order.method))
    write_colors(output, rainy)


def rainy_by(
    scene: Scene, order: TransferRequest, transfer: Transfer | None = None
) -> Generator[Progress, None, Scene]:
    """Give a scene the wet colors of a request, in this process; yields and raises as `rainy_scene` does.

    The computed wet look needs no views; some are shown as the transfer makes them, if that is given.
    """
    is_computed = order.method == "wet"
    if is_computed and transfer is None:
        return (yield from wet_scene(scene, wet_settings(order)))
    transfer = transfer or _opened(order.method, order.settings, scene)
    capture = None if order.capture is None else open_capture(order.capture, allow_outside=order.allow_outside)
    placed = chosen_cameras(scene, order.choice, capture)
    if not is_computed:
        # Images that are not consistent with each other need the robust steps and an exposure each.
        return (yield from rainy_scene(scene, scene_views(scene, placed), transfer, RecolorSettings()))
    shown = scene_views(scene, [placed[i] for i in evenly_spaced_indices(len(placed), _COMPARED)])
    for number, rainy in enumerate(transfer.transferred(shown), 1):
        message = f"Previewing view {number} of {len(shown)}"
        yield Progress(_PREVIEWED * number / len(shown), message, thumbnail(rainy.image))
    return (yield from subprogress(wet_scene(scene, wet_settings(order)), _PREVIEWED, 1.0))


def wet_settings(order: TransferRequest) -> WetSettings:
    """Settings of the computed wet look in a request."""
    return WetSettings(wetness=order.settings.wetness, seed=order.settings.seed)


def preview_view(
    copy: Path, method: str, settings: TransferSettings, placed: PlacedCamera, output: Path
) -> Iterator[Progress]:
    """Worker of a preview: transfer one view of a saved scene and write its images.

    Raises ValueError if the method makes no image of it.
    """
    yield Progress(0.0, "Reading the scene")
    scene = read_scene(copy)
    transfer = _opened(method, settings, scene)
    yield Progress(_READ, "Rendering the view")
    views = scene_views(scene, [placed])
    clear = to_display_bytes(views[0].image)
    yield Progress(_RENDERED, "Making it rainy", clear)
    rainy = next(iter(transfer.transferred(views)), None)
    if rainy is None:
        raise ValueError("the transfer has made no picture")
    images = PreviewImages.of(rainy)
    images.write(output)
    yield Progress(1.0, "Done", images.pictures["rainy"], note=images.note)


def to_display_bytes(image: Float32[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Convert an image in display colors 0..1 to 8 bits."""
    return np.rint(np.clip(image, 0, 1) * np.float32(255)).astype(np.uint8)


def _opened(method: str, settings: TransferSettings, scene: Scene) -> Transfer:
    from ...appearance.wet_look.environment import SceneEnvironment

    row = find_method(method)
    if row.needs_torch:
        require_package("torch", row.title, "diffusion")
    return open_transfer(method, settings, SceneEnvironment(scene))


# Report: transferred views compared with renders of the result

_COMPARED = 6  # maximum number of views in the report
_SOLID = 0.3  # minimum alpha of compared pixels


class ComparisonReport:
    """Transfer that forwards another one and keeps some of its views, evenly spaced.

    `note` describes the network's input, from the first view on; empty for methods without a network.
    """

    def __init__(self, transfer: Transfer) -> None:
        self._transfer, self.name = transfer, transfer.name
        self._views: list[RainyView] = []
        self._count, self._seconds = 0, 0.0
        self.note = ""

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        every = max(1, -(-len(views) // _COMPARED))
        started = time.perf_counter()
        for number, rainy in enumerate(self._transfer.transferred(views)):
            self._seconds += time.perf_counter() - started
            if number % every == 0:
                self._views.append(rainy)
            self._count += 1
            self.note = self.note or network_note(rainy)
            yield rainy
            started = time.perf_counter()

    def report(self, scene: Scene, method: str) -> RunReport:
        return RunReport(
            f"{scene.name} made rainy",
            {"method": method if self._count else f"{method}, colors from the cache"}
            | ({"network": self.note} if self.note else {}),
            comparisons=tuple(_compared(scene, each) for each in self._views),
            timings={"Views and their transfer": self._seconds},
            headlines={"Gaussians": f"{scene.gaussian_count:,}", "Views": f"{self._count:,}"},
        )


def network_note(rainy: RainyView) -> str:
    """Sentence about the input of the network that made a view rainy; empty for methods without a network."""
    words = "" if rainy.framed is None else rainy.framed.input.words
    return f"{words[:1].upper()}{words[1:]}{'.' if words else ''}"


def _compared(scene: Scene, rainy: RainyView) -> ImageComparison:
    parts = [part._replace(colors=None) for part in scene.parts(rainy.clear.time_s, wetness=1.0)]
    renderer = CpuRenderer()
    renderer.draw(parts, rainy.clear.camera)
    rgba = renderer.read().rgba
    alpha = rgba[..., 3]
    drawn = np.clip(rgba[..., :3] + (1 - alpha[..., None]) * rainy.image, 0, 1)
    return compare_images(rainy.clear.name, drawn, rainy.image, alpha > _SOLID)
