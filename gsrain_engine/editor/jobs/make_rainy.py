"""Jobs "Make it rainy" (transfer views, then solve for wet colors) and "Preview" (transfer the current view)."""

import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from ...appearance.base import ClearView, RainyView, Transfer, TransferSettings
from ...appearance.registry import find_method, open_transfer
from ...appearance.scene_views import PlacedCamera, ViewChoice, chosen_cameras, scene_views
from ...datasets.open_capture import open_capture
from ...evaluation.report import RunReport, write_report
from ...evaluation.report_charts import ImageComparison
from ...recolor.problem import RecolorSettings
from ...recolor.recolor import QUICK, rainy_scene
from ...recolor.result import read_recolored, with_colors, write_recolored
from ...render.cpu.renderer import CpuRenderer
from ...scene.camera import Camera
from ...scene.formats.scene_files import read_scene
from ...scene.formats.scene_folder import FileCache
from ...scene.progress import Progress
from ...scene.scene import Scene
from ..viewport_state import PendingScene
from .job import CopiedSceneJob, WorkerCall, new_report, write_copy
from .process import WorkerProcess
from .training import HOW_TO_GET_DIFFUSION, require_torch

MAKE_RAINY_TITLE = "Apply wet look"
_COLORS = "colors.npz"

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


class MakeRainyJobKind:
    """One run on a scene, a `JobKind`."""

    title = MAKE_RAINY_TITLE
    preparing = "Saving the scene for the worker"

    def __init__(self, scene: Scene, known: FileCache, order: TransferRequest) -> None:
        self.report: Path | None = new_report(f"{scene.name} made rainy")
        self._scene, self._known, self._order = scene, known, order

    def prepare(self, folder: Path) -> WorkerCall:
        copy = write_copy(self._scene, folder, self._known)
        return WorkerCall(make_rainy, (copy, self._order, folder / _COLORS, self.report))

    def snapshot(self, folder: Path) -> Scene | None:
        """Return None: the panel shows each image instead."""
        return None

    def load(self, folder: Path) -> Scene:
        return with_colors(self._scene, read_recolored(folder / _COLORS))

    def staged(self, scene: Scene) -> PendingScene:
        """Stage only the wet colors."""
        return PendingScene(MAKE_RAINY_TITLE, scene, only_wet_colors=True)


# Preview job

PREVIEW_TITLE = "Preview"


@dataclass(frozen=True, slots=True, eq=False)
class PreviewSettings:
    """A method and its settings."""

    method: str
    settings: TransferSettings


@dataclass(frozen=True, slots=True, eq=False)
class PreviewedView:
    """A transferred image, its view, and its settings."""

    pixels: UInt8[np.ndarray, "h w 3"]
    """Display color."""
    camera: Camera
    """In the world, of the viewport's size at the time of the request."""
    time_s: float
    scene: Scene
    recipe: PreviewSettings

    def is_of(self, camera: Camera, time_s: float, scene: Scene) -> bool:
        own = self.camera
        return (
            np.allclose(own.world_to_camera, camera.world_to_camera, atol=_SAME)
            and abs(own.height / own.fy - camera.height / camera.fy) < _SAME
            and abs(own.width / own.height - camera.width / camera.height) < _SAME_SHAPE
            and (not scene.actors or abs(self.time_s - time_s) < _SAME)
            and _looks_alike(self.scene, scene)
        )

    def is_made_by(self, recipe: PreviewSettings) -> bool:
        """Return whether the method and settings equal those of this image."""
        return (self.recipe.method, self.recipe.settings) == (recipe.method, recipe.settings)


class TransferPreviewJob(CopiedSceneJob):
    """Transfers one view. The caller takes `result` after it has finished."""

    def __init__(self, wanted: PreviewedView, width_px: int, known: FileCache, files: ThreadPoolExecutor) -> None:
        """Start. `wanted` defines the view; its pixels are placeholders."""
        placed = PlacedCamera(PREVIEW_TITLE, wanted.camera, wanted.time_s).at_width(min(width_px, wanted.camera.width))
        recipe = wanted.recipe
        super().__init__(
            PREVIEW_TITLE, wanted.scene, known, files,
            lambda copy: WorkerProcess(PREVIEW_TITLE, preview_view, copy, recipe.method, recipe.settings, placed),
        )  # fmt: skip
        self.result: PreviewedView | None = None
        self._wanted = wanted

    def _take(self, last: Progress) -> None:
        if last.preview is None:
            raise ValueError("the transfer has made no picture")
        self.result = replace(self._wanted, pixels=last.preview)


_READ, _RENDERED = 0.2, 0.6  # progress after reading and after rendering


def make_rainy(copy: Path, order: TransferRequest, output: Path, report: Path | None) -> Iterator[Progress]:
    """Worker of "Make it rainy": transfer views of a saved scene, solve for its wet colors and write them."""
    yield Progress(0.0, "Reading the scene")
    scene = read_scene(copy)
    kept = ComparisonReport(_opened(order.method, order.settings, scene))
    rainy = yield from _with_colors_by(kept, scene, order)
    if report is not None:
        write_report(report, kept.report(rainy, order.method))
    write_recolored(output, {each.key: each.wet_sh for each in rainy.members if each.wet_sh is not None})


def rainy_by(scene: Scene, order: TransferRequest) -> Generator[Progress, None, Scene]:
    """Give a scene the wet colors of a request, in this process; yields and raises as `rainy_scene` does."""
    return (yield from _with_colors_by(_opened(order.method, order.settings, scene), scene, order))


def _with_colors_by(transfer: Transfer, scene: Scene, order: TransferRequest) -> Generator[Progress, None, Scene]:
    capture = None if order.capture is None else open_capture(order.capture, allow_outside=order.allow_outside)
    views = scene_views(scene, chosen_cameras(scene, order.choice, capture))
    # Images that are not consistent with each other need the robust steps and an exposure each.
    settings = QUICK if order.method == "wet" else RecolorSettings()
    return (yield from rainy_scene(scene, views, transfer, settings))


def preview_view(copy: Path, method: str, settings: TransferSettings, placed: PlacedCamera) -> Iterator[Progress]:
    """Worker of a preview: transfer one view of a saved scene; the image comes with the last step."""
    yield Progress(0.0, "Reading the scene")
    scene = read_scene(copy)
    transfer = _opened(method, settings, scene)
    yield Progress(_READ, "Rendering the view")
    views: Sequence[ClearView] = scene_views(scene, [placed])
    yield Progress(_RENDERED, "Making it rainy", to_display_bytes(views[0].image))
    for rainy in transfer.transferred(views):
        yield Progress(1.0, "Done", to_display_bytes(rainy.image))


def to_display_bytes(image: Float32[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Convert an image in display colors 0..1 to 8 bits."""
    return np.rint(np.clip(image, 0, 1) * np.float32(255)).astype(np.uint8)


def _opened(method: str, settings: TransferSettings, scene: Scene) -> Transfer:
    from ...appearance.wet_look.environment import SceneEnvironment

    row = find_method(method)
    if row.needs_torch:
        require_torch(row.title, HOW_TO_GET_DIFFUSION)
    return open_transfer(method, settings, SceneEnvironment(scene))


_SAME = 1e-4  # tolerance of pose entries and of the field of view
_SAME_SHAPE = 0.01  # tolerance of the aspect ratio: a viewport has whole pixels


def _looks_alike(one: Scene, other: Scene) -> bool:
    """Return whether two scenes look the same when dry."""
    return one is other or _dry(one).geometry_key == _dry(other).geometry_key


def _dry(scene: Scene) -> Scene:
    for member in scene.members:
        if member.wet_sh is not None:
            scene = scene.with_member(member.key, wet_sh=None)
    return scene


# Report: transferred views compared with renders of the result

_COMPARED = 6  # maximum number of views in the report
_SOLID = 0.3  # minimum alpha of compared pixels


class ComparisonReport:
    """Transfer that forwards another one and keeps some of its views, evenly spaced."""

    def __init__(self, transfer: Transfer) -> None:
        self._transfer = transfer
        self._kept: list[RainyView] = []
        self._count, self._seconds = 0, 0.0

    @property
    def name(self) -> str:
        return self._transfer.name

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        every = max(1, -(-len(views) // _COMPARED))
        started = time.perf_counter()
        for number, rainy in enumerate(self._transfer.transferred(views)):
            self._seconds += time.perf_counter() - started
            if number % every == 0:
                self._kept.append(rainy)
            self._count += 1
            yield rainy
            started = time.perf_counter()

    def report(self, scene: Scene, method: str) -> RunReport:
        return RunReport(
            f"{scene.name} made rainy",
            {"method": method},
            comparisons=tuple(_compared(scene, each) for each in self._kept),
            timings={"Views and their transfer": self._seconds},
            headlines={"Gaussians": f"{scene.gaussian_count:,}", "Views": f"{self._count:,}"},
        )


def _compared(scene: Scene, rainy: RainyView) -> ImageComparison:
    parts = [part._replace(colors=None) for part in scene.parts(rainy.clear.time_s, wetness=1.0)]
    renderer = CpuRenderer()
    renderer.draw(parts, rainy.clear.camera)
    rgba = renderer.read().rgba
    alpha = rgba[..., 3]
    drawn = np.clip(rgba[..., :3] + (1 - alpha[..., None]) * rainy.image, 0, 1)
    return ImageComparison.measured(rainy.clear.name, drawn, rainy.image, alpha > _SOLID)
