"""Export settings: output, frame rate, size, passes and codec, and the names of the written files."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from msgspec import Meta

from ..choices import Mark
from ..safe_io.file_names import shortened
from ..settings import Settings

Pass = Literal["color", "depth", "alpha", "labels"]
Codec = Literal["auto", "h264", "vp9", "av1", "png", "jpeg", "exr"]
Lod = Literal["off", "pixel"]
Projection = Literal["perspective", "360", "stereo"]
LARGEST_PX = 16384
Pixels = Annotated[int, Meta(ge=1, le=LARGEST_PX)]
DEFAULT_SIZE_PX = (960, 640)
DEFAULT_QUALITY = {"h264": 18, "vp9": 24, "av1": 28}
"""Default constant rate factor of each video codec: visually nearly lossless."""

DEFAULT_JPEG_QUALITY = 93
"""With full-resolution chroma: errors of about one level, so that one-pixel rain streaks survive."""

_CONTAINERS: dict[str, tuple[str, ...]] = {
    "h264": (".mp4",), "vp9": (".webm",), "av1": (".webm", ".mp4"), "png": (".png", ""), "jpeg": (".jpg", ".jpeg", ""),
    "exr": (".exr", ""), "npy": (".npy",),
}  # fmt: skip
"""File suffixes of each codec, the default one first; "" is a folder."""

_BY_SUFFIX = {suffix: codec for codec, suffixes in _CONTAINERS.items() for suffix in suffixes if codec != "av1"}
_BY_SUFFIX[""] = "png"


class ExportSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of one export; scene, rain and path belong to the document."""

    # fmt: off
    output: Annotated[str, Meta(
        title="Output", extra={"option": "output o", "path": True, "commands": "render"},
        description="PNG, JPEG, EXR or NPY for a still, MP4 or WebM for a video, a folder for numbered frames.")]
    size_px: Annotated[tuple[Pixels, Pixels] | None, Meta(
        title="Size", extra={"unit": "px", "topic": "Camera and time", "commands": "render"},
        description="Width and height; without them, each rig camera's own.")] = None
    fps: Annotated[float, Meta(
        ge=0.1, le=1000, title="Frame rate", extra={"unit": "fps", "commands": "render"},
        description="Frames per second.")] = 30.0
    first_s: Annotated[float, Meta(
        ge=-36000, le=36000, title="From", extra={
            "unit": "s", "option": "time from", "topic": "Camera and time", "commands": "render"},
        description="Moment of the first frame.")] = 0.0
    last_s: Annotated[float | None, Meta(
        title="To", extra={"unit": "s", "option": "to", "topic": "Camera and time", "commands": "render*"},
        description="Moment at which the clip ends; without one, where the path ends.")] = None
    supersampling: Annotated[int, Meta(
        ge=1, le=4, title="Supersampling", extra={"topic": "Camera and time", "commands": "render*"},
        description="Draw so many times wider and higher, and take the mean. Which drops exist stays the same.")] = 1
    motion_blur: Annotated[int, Meta(
        ge=1, le=64, title="Motion blur", extra={"topic": "Camera and time", "commands": "render*"},
        description="So many sub-frames over the exposure, averaged in linear light. 1 is none.")] = 1
    cameras: Annotated[tuple[str, ...], Meta(
        title="Cameras", extra={"topic": "Camera and time", "commands": "render"},
        description="Rig cameras (RIG, RIG/NAME, NAME, or all); each gets a file of its own. Without one, the camera "
        "path.")] = ()
    passes: Annotated[tuple[Pass, ...], Meta(
        min_length=1, title="Passes", extra={"commands": "render"},
        description="color; depth (16 bit, cm); alpha (8 bit); labels: which layer or actor a pixel shows.",
    )] = ("color",)
    twin: Annotated[Literal["sunny", "overcast"] | None, Meta(
        title="Also render without rain", extra={"option": "clear-pair", "commands": "render"},
        description="The same without drops and haze, as NAME.clear, for paired tests. sunny: at 0 mm/h, as the scene "
        "is lit. overcast: in the light and the wet colors of the rain.")] = None
    lod: Annotated[Lod | None, Meta(
        title="Level of detail", extra={"topic": "More", "commands": "render*, drive"},
        description="pixel merges details smaller than a pixel, which makes large scenes faster; off draws every "
        "Gaussian. None takes pixel from 1 million Gaussians on, except for NPY. Depth and labels are always exact.",
    )] = None
    projection: Annotated[Projection, Meta(
        title="Projection", extra={"topic": "Camera and time", "commands": "render*"},
        description="360: equirectangular, twice as wide as high, level, with the camera's heading in the middle. "
        "stereo: left and right eye side by side, 65 mm apart. Both without the sensor's picture and water on glass.",
    )] = "perspective"
    marks: Annotated[tuple[Mark, ...], Meta(
        title="Marks", extra={"topic": "Camera and time", "commands": "render*"},
        description="Drawn over orthographic pictures (--camera top or ortho): grid, lines at round meters; scale, a "
        "bar; boxes and paths of road users.")] = ()
    transparent: Annotated[bool, Meta(
        title="Transparent background", extra={"commands": "render*"},
        description="Leave out the sky layers, and write what covers a pixel as its alpha: PNG, EXR, NPY, or WebM "
        "(VP9).")] = False
    codec: Annotated[Codec, Meta(
        title="Codec", extra={"commands": "render*"},
        description="auto goes by the output's ending: H.264 in MP4, VP9 in WebM, PNG frames.")] = "auto"
    quality: Annotated[int | None, Meta(
        title="Quality", extra={"commands": "render*"},
        description="Constant rate factor of a video, lower is better: 0..51 (H.264; none: 18), 0..63 (VP9, none: 24; "
        "AV1, none: 28). Of JPEG 1..100, higher is better; none: 93.")] = None
    # fmt: on

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.last_s is not None and not self.first_s < self.last_s <= self.first_s + 36000:
            raise ValueError(
                f"last_s must be above first_s ({self.first_s:g} s) by at most 36000 s, got {self.last_s:g}"
            )
        if self.quality is not None and self.format == "jpeg":
            if not 1 <= self.quality <= 100:
                raise ValueError(f"quality must be within 1..100 (JPEG), got {self.quality}")
        elif self.quality is not None and not 0 <= self.quality <= (51 if self.format == "h264" else 63):
            raise ValueError(f"quality must be within 0..51 (H.264) or 0..63 (VP9, AV1), got {self.quality}")

    @property
    def path(self) -> Path:
        return Path(self.output)

    @property
    def suffix(self) -> str:
        """Suffix of the output in lower case; "" is a folder."""
        return self.path.suffix.lower()

    @property
    def format(self) -> str:
        """Output format: h264, vp9, av1, png, jpeg, exr or npy; "" for an unknown suffix."""
        return _BY_SUFFIX.get(self.suffix, "") if self.codec == "auto" else self.codec

    @property
    def default_suffix(self) -> str:
        """Default suffix of a video in this format; "" for frames, which are written to a folder."""
        return _CONTAINERS[self.format][0] if self.is_video else ""

    @property
    def is_video(self) -> bool:
        """True if color is written as a video."""
        return self.format in ("h264", "vp9", "av1")

    @property
    def is_still(self) -> bool:
        return self.suffix in (".png", ".jpg", ".jpeg", ".exr", ".npy")

    def check(self) -> None:
        """Raise `ValueError` for contradictory output, codec, size and passes."""
        if not self.output.strip():
            raise ValueError("output is empty: expected the name of a file or folder, such as clip.mp4")
        if self.suffix not in _BY_SUFFIX:
            raise ValueError(
                f"{self.output}: an output ends in .png, .jpg, .npy, .exr, .mp4 or .webm, or is a folder without suffix"
            )
        allowed = _CONTAINERS[self.format]
        if self.suffix not in allowed and not (self.suffix == "" and len(self.cameras) > 0):
            suffixes = " or ".join(each or "nothing (a folder)" for each in allowed)
            raise ValueError(f"{self.output}: {self.format} needs an output that ends in {suffixes}")
        if self.format == "jpeg" and (others := [each for each in self.passes if each != "color"]):
            raise ValueError(f"{self.output}: JPEG holds colors alone; for the pass {others[0]} take PNG, EXR or NPY")
        if self.transparent and self.format not in ("png", "exr", "npy", "vp9"):
            raise ValueError(
                f"{self.output}: {self.format} holds no transparency; take .png, .exr, .npy or .webm (VP9)"
            )
        if self.projection != "perspective" and "labels" in self.passes:
            raise ValueError(f"the pass labels needs the projection perspective, not {self.projection}")
        width, height = self.size_px or DEFAULT_SIZE_PX
        if self.projection == "360" and (width != 2 * height or self.cameras):
            raise ValueError(f"a 360 image is twice as wide as high and of the camera path, got {width}x{height}")
        if self.projection == "stereo" and width % 2:
            raise ValueError(f"a stereo image has an even width, got {width}")
        if self.is_video and self.size_px is not None and any(side % 2 for side in self.size_px):
            width, height = self.size_px
            raise ValueError(f"{self.output}: a video needs an even width and height, got {width}x{height}")


class ExportPreset(NamedTuple):
    """Settings for one purpose."""

    title: str
    help: str
    fields: Mapping[str, Any]


EXPORT_PRESETS = (
    ExportPreset("Draft video", "960 x 640 at 30 frames a second, H.264: the settings at the start.",
                 {"codec": "h264", "size_px": (960, 640), "fps": 30.0}),
    ExportPreset("YouTube 1080p", "1920 x 1080 at 30 frames a second, H.264, two samples for the exposure.",
                 {"codec": "h264", "size_px": (1920, 1080), "fps": 30.0, "quality": 16, "motion_blur": 2}),
    ExportPreset("YouTube 4K", "3840 x 2160 at 30 frames a second, H.264.",
                 {"codec": "h264", "size_px": (3840, 2160), "fps": 30.0, "quality": 18}),
    ExportPreset("Paper figure", "PNG of 1920 x 1280, four samples per pixel.",
                 {"codec": "png", "size_px": (1920, 1280), "supersampling": 2}),
    ExportPreset("Dataset", "PNG frames with depth and labels, and the same frames without rain in the same light.",
                 {"codec": "png", "size_px": (960, 640), "fps": 10.0, "passes": ("color", "depth", "labels"),
                  "twin": "overcast"}),
    ExportPreset("360 video", "Equirectangular, 3840 x 1920, H.264.",
                 {"codec": "h264", "size_px": (3840, 1920), "fps": 30.0, "projection": "360"}),
    ExportPreset("Cut-out", "WebM with a transparent background, for compositing.",
                 {"codec": "vp9", "size_px": (1920, 1080), "fps": 30.0, "transparent": True}),
)  # fmt: skip
"""Presets of the Record panel; fields that they don't name get their defaults."""


# Output files


@dataclass(frozen=True, slots=True)
class ExportFiles:
    """Files of one camera.

    Passes are written next to `still.png` as `still.depth.png`, next to the frames of a folder as
    `frames/000007.depth.png`, and for a video into a folder each: `clip.depth/000007.png`. EXR files contain color,
    alpha and depth.
    """

    path: Path
    format: str
    is_video: bool
    passes: frozenset[Pass]
    is_folder: bool
    """True if `path` is a folder of frames; its name may contain dots."""

    def color(self, number: int) -> Path:
        ending = "jpg" if self.format == "jpeg" else self.format
        return self.path / f"{number:06d}.{ending}" if self.is_folder else self.path

    def pass_file(self, number: int, name: Pass) -> Path:
        kind = "npy" if self.format == "npy" and name == "depth" else "png"
        if self.is_video:
            return self._folder(name) / f"{number:06d}.{kind}"
        if self.is_folder:
            return self.path / f"{number:06d}.{name}.{kind}"
        return self.path.with_name(f"{self.path.stem}.{name}.{kind}")

    @property
    def legend(self) -> Path:
        if self.is_video:
            return self._folder("labels") / "labels.json"
        return self.path / "labels.json" if self.is_folder else self.path.with_name(f"{self.path.stem}.labels.json")

    def roots(self) -> Iterator[Path]:
        """All written files and folders, without the contents of folders."""
        if self.is_folder:
            yield self.path
            return
        inside = {"color", "alpha", "depth"} if self.format == "exr" else {"color"}
        if self.passes & inside:
            yield self.path
        for name in sorted(self.passes - inside):
            yield self._folder(name) if self.is_video else self.pass_file(0, name)

    def _folder(self, name: str) -> Path:
        return self.path.with_name(f"{self.path.stem}.{name}")


def export_files(recording: ExportSettings, camera: str | None, *, is_clear: bool = False) -> ExportFiles:
    """Files of a camera or its clear twin, named `NAME.clear`; `camera` is None for a single camera.

    Several cameras share a folder: `drive.mp4` becomes `drive/FRONT.mp4`. Depth and labels don't depend on rain: the
    twin does not repeat them.
    """
    path, passes = recording.path, frozenset(recording.passes)
    if camera is not None:
        suffix = path.suffix or recording.default_suffix
        path = path.with_suffix("") / (shortened(re.sub(r"[^\w-]+", "_", camera)) + suffix)
    is_folder = path.suffix == ""
    if is_clear:
        path, passes = path.with_name(f"{path.stem}.clear{path.suffix}"), passes - {"depth", "labels"}
    return ExportFiles(path, recording.format, recording.is_video, passes, is_folder)


def export_outputs(recording: ExportSettings, cameras: Sequence[str]) -> list[Path]:
    names = cameras if len(cameras) > 1 else [None]
    twins = (False, True) if recording.twin else (False,)
    return [path for name in names for twin in twins for path in export_files(recording, name, is_clear=twin).roots()]
