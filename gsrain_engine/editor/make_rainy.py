"""Setup of "Make it rainy": method, views, preview and job. Not part of the document."""

from pathlib import Path
from typing import get_args

import msgspec

from ..appearance.base import TransferSettings
from ..appearance.cyclegan_turbo.weight_paths import find_base_model, find_transfer_weights, read_record
from ..appearance.registry import METHODS, TransferMethod, find_method
from ..appearance.view_choice import Source, ViewChoice
from ..optional_packages import has_package, missing_package
from ..safe_io.text_files import printable_line
from .background_edits import apply_wet_look
from .capture_view import CaptureController
from .document import Recipe
from .files import Files
from .job_results import scene_results
from .jobs.job import JobRunner
from .jobs.make_rainy import (
    MAKE_RAINY_TITLE,
    PreviewedView,
    PreviewImages,
    PreviewPicture,
    PreviewSettings,
    TransferRequest,
    make_rainy_job,
    preview_job,
)
from .live_rain import LiveRain
from .status import StatusBus
from .viewport.options import Texture
from .viewport_state import ViewportState


class WetLookController:
    """The user's choices and the results so far. Main thread only."""

    def __init__(
        self,
        viewport: ViewportState,
        live_rain: LiveRain,
        captures: CaptureController,
        jobs: JobRunner,
        files: Files,
        status: StatusBus,
    ) -> None:
        """Start with the method that has no requirements, and few views, for a first result within seconds."""
        self.method = METHODS[0].name
        self.settings = TransferSettings()
        self.choice = ViewChoice(count=8)
        self.preview_width_px = 640
        self.previewed: PreviewedView | None = None
        self.textures: dict[PreviewPicture, Texture] = {}
        """Images of the preview, in the order of the transfer."""
        self.viewport_px: tuple[int, int] = (960, 640)
        """Size of the viewport at the last frame."""
        self._viewport, self._document, self._live_rain = viewport, viewport.document, live_rain
        self._captures, self._jobs, self._files, self._status = captures, jobs, files, status
        self._starts_soon = False
        self._training: tuple[tuple[Path, int] | None, str | None] = None, None

    @property
    def row(self) -> TransferMethod:
        return find_method(self.method)

    @property
    def recipe(self) -> PreviewSettings:
        return PreviewSettings(self.method, self.settings)

    def change(self, **fields: object) -> None:
        self.settings = msgspec.structs.replace(self.settings, **fields)

    # Preconditions

    @property
    def why_not(self) -> str | None:
        """Reason why the scene can't be made rainy now, in one sentence, or None."""
        return self.why_no_transfer or self.why_no_views(self.choice.source)

    @property
    def why_no_preview(self) -> str | None:
        """Reason why there can't be a preview now, or None."""
        if self.method == "images":
            return "Pictures of another program are of the chosen views alone: there is none from here."
        if not self._document.scene.gaussian_count:
            return "There is no scene yet to be made rainy."
        return self.why_no_transfer

    @property
    def why_no_transfer(self) -> str | None:
        """Missing requirements of the method, or None."""
        return missing_requirements(self.row, self.settings)

    @property
    def training(self) -> str | None:
        """Line on the training of the weights in use, chosen or found; None without weights."""
        if self.method != "cyclegan-turbo":
            return None
        try:
            weights = self.settings.weights or find_transfer_weights()
        except FileNotFoundError:
            return None
        if not weights.is_file():
            return None
        key = weights, weights.stat().st_mtime_ns
        if key != self._training[0]:
            try:
                record = read_record(weights)
                words = "no record of the training in the file" if record is None else f"trained with {record.words}"
                self._training = key, f"{printable_line(weights.name)}: {words}."
            except (ValueError, ModuleNotFoundError) as error:
                self._training = key, str(error)
        return self._training[1]

    def why_no_views(self, source: Source) -> str | None:
        """Reason why views of a source are not available, in one sentence, or None."""
        scene, captures = self._document.scene, self._captures
        if not scene.gaussian_count:
            return "There is no scene yet to be made rainy."
        if source == "recorded":
            if captures.capture is None:
                return "No capture is open: open the scene's recording in Capture, or choose other views."
            if not captures.capture.has_poses:
                return "Nothing tells where the capture's cameras stood: choose other views."
            if not captures.lies_in(scene):
                return "The open capture has axes of its own: its cameras are not in the scene."
        if source == "rig" and not (scene.ego is not None and scene.ego.valid.any() and any(scene.rigs.values())):
            return "The scene has no drive with a camera rig: choose other views."
        if source == "path" and scene.path is None:
            return "There is no camera path yet: insert keyframes in Timeline, or choose other views."
        return None

    # Preview

    def preview(self) -> None:
        """Start to transfer the viewport's view; the result appears next to the live image."""
        if self.why_no_preview is not None:
            return
        shot, scene, recipe = self._viewport.shot(*self.viewport_px), self._document.scene, self.recipe

        def take(images: PreviewImages, _: bool) -> None:
            self.previewed = PreviewedView(images, shot.camera, shot.time_s, scene, recipe)
            self._viewport.options.split = "now | preview"
            self._jobs.forget(job)  # the image replaces the entry

        work = preview_job(scene, shot.camera, shot.time_s, recipe, self.preview_width_px, self._files.known)
        job = self._jobs.start(work, take)

    @property
    def fits(self) -> bool:
        """True if the preview matches the viewport's view."""
        shot = self._viewport.shot(*self.viewport_px)
        return self.previewed is not None and self.previewed.is_of(shot.camera, shot.time_s, self._document.scene)

    @property
    def what_is_stale(self) -> str | None:
        """Describe changes since the preview was made; None if there are none, or no preview."""
        if self.previewed is not None and self.previewed.recipe != self.recipe:
            return "The settings have changed since."
        return None if self.previewed is None or self.fits else "The view has changed since."

    def look_from_preview(self) -> None:
        """Return to the view of the preview."""
        if self.previewed is not None:
            self._viewport.look_from(self.previewed.camera)
            self._viewport.playback.clock.seek(self.previewed.time_s)

    def poll(self) -> None:
        """Start a job that waits for a scene, unless that has wet colors. Once a frame."""
        if self._starts_soon and self._document.scene.has_rainy_light:
            self._starts_soon = False
        if self._starts_soon and self._document.scene.gaussian_count:
            self._starts_soon = False
            if (why_not := self.why_not) is not None:
                self._status.report(why_not)
            self.make()

    # Job

    def make(self) -> None:
        """Start the job for the present scene, if all preconditions hold."""
        if self.why_not is not None:
            return
        source = self.choice.source  # "auto" uses the open capture only if the user confirmed that it fits
        is_sure = self._captures.in_scene_axes is True and self.why_no_views("recorded") is None
        uses_capture = source == "recorded" or (source == "auto" and is_sure)
        capture = self._captures.path if uses_capture else None
        order = TransferRequest(self.method, self.settings, self.choice, capture, self._captures.allows_outside)
        job = make_rainy_job(self._document.scene, self._files.known, order)
        values = {name: getattr(order, name) for name in TransferRequest.__dataclass_fields__}
        self._jobs.start(job, scene_results(self._viewport, MAKE_RAINY_TITLE, Recipe(apply_wet_look, values)))

    def make_soon(self) -> None:
        """Start the job as soon as a scene is open."""
        self._starts_soon = True

    @property
    def why_no_comparison(self) -> str | None:
        """Reason why the clear and the rainy scene can't be compared, in one sentence, or None."""
        if not self._document.scene.has_wet_colors:
            return "The scene has no wet colors yet."
        state = self._live_rain.displayed.state_at(self._viewport.playback.clock.time_s)
        if state.is_clear and self._live_rain.wetness_now == 0:
            return "There is no rain at this time: set the rain intensity above 0 first."
        return None

    def compare(self) -> None:
        """Show the clear scene next to the rainy one."""
        if self.why_no_comparison is None:
            self._viewport.options.split = "clear | rainy"


# View sources

SOURCES: tuple[Source, ...] = get_args(Source)

TITLES: dict[Source, str] = {
    "auto": "best available",
    "recorded": "of the open capture",
    "rig": "of the rig, along the drive",
    "path": "along the camera path",
    "around": "around the middle",
}
"""Display names."""


# Requirements of transfers, checked before a worker starts


def missing_requirements(method: TransferMethod, settings: TransferSettings) -> str | None:
    """Describe in one sentence a missing requirement and its remedy; None if all are met."""
    if method.needs_torch and not has_package("torch"):
        return missing_package("torch", method.title, "diffusion")
    if method.needs == "images" and settings.images is None:
        return f"{method.title}: choose a folder of pictures first."
    for path in (getattr(settings, name) for name in ("weights", "images", "base") if name in method.uses):
        if path is not None and not path.exists():
            return f"{path}: is not there; choose another place."
    try:
        if "weights" in method.uses and settings.weights is None:
            find_transfer_weights()
        if "base" in method.uses:
            find_base_model(settings.base)
    except FileNotFoundError as missing:
        return f"{method.title}: {missing}"
    return None
