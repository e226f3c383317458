"""Export of the timeline or a still: settings, estimate, and start of the job."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from jaxtyping import UInt8

from ..render.export import FRAME_TIME, export_command, export_sequences, frame_numbers
from ..render.export_settings import EXPORT_PRESETS, ExportPreset, ExportSettings, export_outputs
from ..render.sequence import FrameSequence
from ..scene.camera_path import CameraPath
from ..scene.formats.scene_folder import FileCache
from ..scene.geometry import quaternions_from_matrices
from ..scene.scene import Scene
from .autosave import saved_scene
from .files import Files
from .jobs.job import Job, JobRunner
from .jobs.record import SHEET_MM_H, export_job, frame_job, page_job, sheet_job, timing_job
from .live_rain import LiveRain
from .preferences import PreferencesStore
from .status import StatusBus
from .steps import python_program, shell_command, steps_since
from .viewport.options import Texture
from .viewport_state import ViewportState

logger = logging.getLogger("gsrain")
_PLAIN = ExportSettings(output="", size_px=(960, 640), codec="h264")
_OF_SCENE = "output", "cameras"  # settings that the preferences don't hold


class OutputEstimate(NamedTuple):
    """Size and rough duration of an export."""

    frames: int
    """Per camera."""
    cameras: int
    length_s: float
    """Playing time."""
    seconds: float | None
    """Rendering time: of timed frames, else rough, from the viewport's last image; None without one."""
    is_timed: bool
    """True if frames of a recording were timed, with reading the scene, encoding and writing."""


class _TimedJob(NamedTuple):
    """A job that times the frames of an opened document."""

    job: Job[Any]
    megapixels: float
    """Of one frame."""
    opened: tuple[str | None, str]
    """Opened file or name, and origin of the document: another one has other Gaussians."""


class RenderQueue:
    """Settings of the next recording, which the preferences hold, and its start. Main thread only."""

    def __init__(
        self,
        viewport: ViewportState,
        live_rain: LiveRain,
        jobs: JobRunner,
        files: Files,
        preferences: PreferencesStore,
        status: StatusBus,
    ) -> None:
        self._viewport, self._document, self._playback = viewport, viewport.document, viewport.playback
        self._live_rain, self._jobs, self._files, self._status = live_rain, jobs, files, status
        self._preferences = preferences
        self._settings = _stored_settings(preferences.value.recording)
        self._playback.timeline.fps = self._settings.fps
        self.follows_range = preferences.value.records_range
        """True if the first and the last moment are those of the timeline's range."""
        self._timed: list[_TimedJob] = []
        self.preview: UInt8[np.ndarray, "h w c"] | None = None
        """Last previewed frame, as it would be written."""
        self.preview_texture: Texture | None = None

    @property
    def settings(self) -> ExportSettings:
        """Settings except for the output path. The frame rate is the timeline's, and so are times not set here."""
        own, fps, (first_s, last_s) = self._settings, self._playback.timeline.fps, self._playback.span_s
        if not self.follows_range:
            first_s, last_s = own.first_s, max(last_s, own.first_s + 1 / fps) if own.last_s is None else own.last_s
        return msgspec.structs.replace(own, fps=fps, first_s=first_s, last_s=last_s)

    def poll(self) -> None:
        """Put settings that have changed into the preferences. Once a frame."""
        settings = msgspec.structs.replace(self._settings, fps=self._playback.timeline.fps)
        changed = {
            name: list(value) if isinstance(value, tuple) else value for name in settings.__struct_fields__
            if name not in _OF_SCENE and (value := getattr(settings, name)) != getattr(_PLAIN, name)
        }  # fmt: skip
        now, before = (changed, self.follows_range), self._preferences.value
        if now != (before.recording, before.records_range):
            self._preferences.set(recording=changed, records_range=self.follows_range)

    def proposed_name(self, suffix: str | None = None) -> str:
        """Name of a recording's file or folder: the scene's, with a suffix or that of the chosen format."""
        if suffix is None:
            suffix = self.settings.default_suffix if self.settings.is_video else "_frames"
        return self._files.proposed_name(suffix)

    def change(self, **fields: object) -> None:
        """Change settings; inconsistent ones are rejected and the error reported."""
        try:
            settings, own = self.settings, self._settings
            if fields.keys() & {"first_s", "last_s"}:
                self.follows_range = False
            else:  # the ends of the timeline's range are not the panel's own
                settings = msgspec.structs.replace(settings, first_s=own.first_s, last_s=own.last_s)
            values = {name: getattr(settings, name) for name in settings.__struct_fields__} | fields
            values |= _fitting(fields, values)
            self._settings = msgspec.convert(values, ExportSettings)
            self._playback.timeline.fps = self._settings.fps
        except ValueError as error:
            self._status.report(error)

    def use_preset(self, preset: ExportPreset) -> None:
        """Take the settings of a preset; the cameras and the times stay."""
        self.change(**_fields_of(preset))

    @property
    def preset(self) -> ExportPreset | None:
        """Preset with the present settings; None for others."""
        settings = self.settings
        for preset in EXPORT_PRESETS:
            if all(getattr(settings, name) == value for name, value in _fields_of(preset).items()):
                return preset
        return None

    def preview_frame(self) -> None:
        """Render the frame at the playhead in the background, as the recording would write it."""
        first_s = self._playback.clock.time_s
        still = msgspec.structs.replace(
            self._named, output="frame.png", codec="auto", quality=None, passes=("color",), twin=None,
            first_s=first_s, last_s=None, cameras=self.settings.cameras[:1],
        )  # fmt: skip
        try:
            if len(self._sequences(still)) > 1:
                raise ValueError("choose one camera for the preview")
        except ValueError as error:
            self._status.report(error, "It can't be previewed")
            return
        job = frame_job(saved_scene(self._viewport), still, self._files.known)
        self._jobs.start(job, lambda pixels, _: setattr(self, "preview", pixels))

    @property
    def is_previewing(self) -> bool:
        return self._jobs.is_running("frame")

    def extent(self) -> OutputEstimate | str:
        """Estimate of the export, or the reason why it is impossible."""
        try:
            sequences = self._sequences(self.settings)
        except ValueError as error:
            return str(error)
        settings, pixel_ms = self.settings, self._viewport.full_ms_per_megapixel
        frames, megapixels = len(frame_numbers(settings, sequences)), self._megapixels(settings, sequences)
        timed_s = self._timed_s_per_megapixel
        seconds = timed_s if timed_s is not None else None if pixel_ms is None else 1e-3 * pixel_ms
        whole_s = None if seconds is None else frames * seconds * megapixels
        return OutputEstimate(frames, len(sequences), frames / settings.fps, whole_s, timed_s is not None)

    def time_frames(self) -> None:
        """Draw and write a few frames in the background, for the estimate."""
        try:
            recording = self._named
            megapixels = self._megapixels(recording, self._sequences(recording))
        except ValueError as error:
            self._status.report(error, "It can't be recorded")
            return
        job = timing_job(saved_scene(self._viewport), recording, self._files.known)
        self._timed.append(_TimedJob(job, megapixels, self._opened))

        def ignore(_result: None, _is_last: bool) -> None:
            """The job's metric is all that is used."""

        self._jobs.start(job, ignore)

    @property
    def is_timing(self) -> bool:
        return self._jobs.is_running("timing")

    @property
    def _opened(self) -> tuple[str | None, str]:
        return self._files.source, self._document.state.origin

    @property
    def _timed_s_per_megapixel(self) -> float | None:
        """Time of a drawn megapixel in the newest job that has timed frames of this document; None without one."""
        for each in reversed(self._timed):
            times_s = each.job.curves.curve(FRAME_TIME)[1]
            if len(times_s) and each.opened == self._opened:
                return float(times_s[-1]) / each.megapixels
        return None

    def _megapixels(self, settings: ExportSettings, sequences: dict[str, FrameSequence]) -> float:
        """Pixels that one frame draws, of all cameras, samples, passes and twins, in millions."""
        images = (2 if settings.twin else 1) * settings.motion_blur * settings.supersampling**2
        if "labels" in settings.passes:  # the three color channels of one image hold three layers or actors
            images += len(self._document.scene.members) / 3
        return images * sum(each.width * each.height for each in sequences.values()) * 1e-6

    def record_to(self, path: Path) -> None:
        """Record the timeline; replacing existing files needs confirmation."""
        if self.settings.is_video and not path.suffix:
            path = path.with_name(path.name + self.settings.default_suffix)
        self._begin(msgspec.structs.replace(self.settings, output=str(path)), saved_scene(self._viewport))

    def record_still_to(self, path: Path) -> None:
        """Record the viewport's present time and view, in the size and with the samples of the settings."""
        self._begin(self._still(path), self.still_scene())

    def draw_sheet_to(self, path: Path) -> None:
        """Draw the viewport's present time and view in several intensities below each other."""
        still = msgspec.structs.replace(self._still(path), passes=("color",), transparent=False)
        self._begin(still, self.still_scene(), sheet_job, f" --sheet {','.join(f'{each:g}' for each in SHEET_MM_H)}")

    def publish_to(self, path: Path) -> None:
        """Write a web page of the scene with its rain and path; replacing existing files needs confirmation."""
        page = path if path.suffix.lower() in (".html", ".htm") else path.with_name(f"{path.name}.html")
        if self._jobs.writes(page) is not None:
            self._status.report(f"{page} is being written already: choose another name")
            return
        scene, known = saved_scene(self._viewport), self._files.known

        def log_published(output: Path, _: bool) -> None:
            logger.info("Published %s", output)

        def start() -> None:
            self._jobs.start(page_job(scene, page, known), log_published)

        self._status.ask_before_replacing([page], start)

    def _still(self, path: Path) -> ExportSettings:
        return msgspec.structs.replace(
            self.settings,
            output=str(path if path.suffix else path.with_name(f"{path.name}.png")),
            codec="auto",
            quality=None,
            fps=_PLAIN.fps,
            cameras=(),
            twin=None,
            first_s=self._playback.clock.time_s,
            last_s=None,
            marks=self._viewport.marks,
        )

    def still_scene(self) -> Scene:
        """The scene to save, with the viewport's camera as its path, unless that follows the scene's own path."""
        viewport, scene = self._viewport, saved_scene(self._viewport)
        if viewport.options.follow_path:
            return scene
        camera = viewport.shot(*(self.settings.size_px or (960, 640))).camera
        pose = camera.camera_to_world
        path = CameraPath(
            np.array([self._playback.clock.time_s]),
            pose[None, :3, 3],
            quaternions_from_matrices(pose[None, :3, :3]),
            np.array([camera.vertical_fov_deg]),
            camera.exposure_s,
            plane_m=camera.plane_m,
        )
        return replace(scene, path=path.moved(np.linalg.inv(scene.scene_to_world)))

    # The same without the window

    @property
    def command(self) -> str:
        """Shell line that makes the recording from the scene's file; raises `EditError` as `steps_since` does."""
        source, steps = self._files.source or "", steps_since(self._document.history, self._files.saved)
        if not steps:
            return export_command(self._named, source)
        return shell_command(source, steps, then=export_command(self._named, "edited"))

    @property
    def program(self) -> str:
        """Python program that makes the recording from the scene's file; raises `EditError` as `steps_since` does."""
        named, plain = self._named, ExportSettings(output="")
        changed = {name: getattr(named, name) for name in named.__struct_fields__ if name != "output"}
        words = "".join(f", {name}={value!r}" for name, value in changed.items() if value != getattr(plain, name))
        steps = steps_since(self._document.history, self._files.saved)
        return python_program(self._files.source or "", steps, f"gr.export(scene, {named.output!r}{words})")

    @property
    def _named(self) -> ExportSettings:
        """Settings with an output, also before one was chosen."""
        return msgspec.structs.replace(
            self.settings, output=self.settings.output or f"clip{self.settings.default_suffix}"
        )

    def _begin(
        self,
        recording: ExportSettings,
        scene: Scene,
        job: Callable[[Scene, ExportSettings, FileCache], Job[str]] = export_job,
        more_options: str = "",
    ) -> None:
        try:
            recording.check()
            sequences = self._sequences(recording)
            names, megapixels = list(sequences), self._megapixels(recording, sequences)
        except ValueError as error:
            self._status.report(error, "It can't be recorded")
            return

        if self._jobs.writes(recording.path) is not None:
            self._status.report(f"{recording.path} is being recorded already: choose another name")
            return

        def start() -> None:
            files, note = self._files, ""
            if scene.path is self._document.scene.path:
                saved = " once the scene is saved" if files.home is None or files.has_changes else ""
                command = export_command(recording, str(files.home or "PROJECT")) + more_options
                note = f"The same from the command line{saved}: {command}"

            def log_recorded(output: str, _: bool) -> None:
                logger.info("Recorded %s", output)
                if note:
                    logger.info("%s", note)

            started = job(scene, recording, files.known)
            if job is export_job:
                self._timed.append(_TimedJob(started, megapixels, self._opened))
            self._jobs.start(started, log_recorded)

        self._status.ask_before_replacing(export_outputs(recording, names), start)

    def _sequences(self, recording: ExportSettings) -> dict[str, FrameSequence]:
        recording = recording if recording.output else self._named
        is_own = self._document.scene.path is not None
        return export_sequences(
            recording, self._document.scene, self._live_rain.simulation, self._viewport.path, in_scene_time=is_own
        )


def _stored_settings(fields: Mapping[str, Any]) -> ExportSettings:
    """Settings with fields of the preferences; the default if those of another version don't fit."""
    known = {name: fields[name] for name in _PLAIN.__struct_fields__ if name in fields and name not in _OF_SCENE}
    try:
        return msgspec.convert(msgspec.to_builtins(_PLAIN) | known, ExportSettings)
    except ValueError as error:
        logger.warning("The settings of the last recording can't be used: %s", error)
        return _PLAIN


def _fitting(changed: Mapping[str, object], values: Mapping[str, Any]) -> dict[str, object]:
    """Settings that have to change with others: a panorama's shape, and a format with transparency."""
    fitting: dict[str, object] = {}
    if values["projection"] == "360" and (size_px := values["size_px"]) is not None and size_px[0] != 2 * size_px[1]:
        by_height = "size_px" in changed and "projection" not in changed
        fitting["size_px"] = (2 * size_px[1], size_px[1]) if by_height else (size_px[0] // 2 * 2, size_px[0] // 2)
    if values["transparent"] and values["codec"] not in ("vp9", "png", "exr"):
        if "transparent" in changed:
            fitting |= {"codec": "png" if values["codec"] == "jpeg" else "vp9", "quality": None}
        else:
            fitting["transparent"] = False
    return fitting


def _fields_of(preset: ExportPreset) -> dict[str, Any]:
    """All settings of a preset, except for cameras and times."""
    others = (*_OF_SCENE, "first_s", "last_s")
    plain = {name: getattr(_PLAIN, name) for name in _PLAIN.__struct_fields__ if name not in others}
    return plain | dict(preset.fields)
