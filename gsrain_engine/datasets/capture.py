"""`Capture`, the result of every dataset reader: images, cameras, lidar and boxes; view names; checks of file names."""

import os
from collections import Counter
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Shaped, UInt8

from ..safe_io.text_files import printable_line
from ..scene.camera import Camera
from ..scene.lens import Lens
from ..scene.scene import PoseTrack

EGO_HEIGHT_M = 1.5
"""Height of the ego frame's origin above the road in captures and scenes: a sensor on a car, as in the paper."""

_LONGEST = 1200  # maximum number of characters of a message about a capture, which may name several files


class CaptureError(ValueError):
    """A capture or one of its files can't be read; the message names the file and the fault."""

    def __init__(self, message: str) -> None:
        super().__init__(printable_line(message, _LONGEST))


Source = Shaped[np.ndarray, "..."] | Callable[[], Shaped[np.ndarray, "..."]]
"""Array of pixels, or a function that reads it, so that a long drive fits into memory."""


@dataclass(frozen=True, slots=True, eq=False)
class CaptureFrame:
    """One image of a capture, with its camera in the capture's world."""

    name: str
    camera: Camera
    """Camera of the image's size, with focal length and center of the undistorted lens."""
    image_source: Source
    time_s: float = 0.0
    """Seconds from the first view of the capture."""
    sensor: str = ""
    """Camera of a rig, such as CAM_FRONT; empty if there is only one."""
    lens: Lens | None = None
    """Distortion of the image, depth, labels and mask; None for a pinhole camera."""
    depth_source: Source | None = None
    normals_source: Source | None = None
    labels_source: Source | None = None
    mask_source: Source | None = None
    sky_source: Source | None = None
    attributes: Mapping[str, str] = field(default_factory=dict[str, str])
    """Other properties in the dataset's own words, such as weather and time of day."""

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        """Display color (sRGB). Raises `CaptureError` if the file is broken or of another size."""
        return self._read("image", self.image_source)

    @property
    def depth(self) -> Float32[np.ndarray, "h w"] | None:
        """Meters along the view axis at pixel centers; 0 without a measurement (the sky)."""
        return self._read("depth", self.depth_source)

    @property
    def normals(self) -> Float32[np.ndarray, "h w 3"] | None:
        """Unit surface normals in the world, toward the camera; 0 if unknown."""
        return self._read("normals", self.normals_source)

    @property
    def labels(self) -> UInt8[np.ndarray, "h w"] | None:
        """Semantic classes; 0 if unknown."""
        return self._read("labels", self.labels_source)

    @property
    def mask(self) -> Bool[np.ndarray, "h w"] | None:
        """Pixels of the static scene, usable for training; None means all."""
        return self._read("mask", self.mask_source)

    @property
    def sky(self) -> Bool[np.ndarray, "h w"] | None:
        """Pixels of the sky."""
        return self._read("sky", self.sky_source)

    @property
    def image_file(self) -> Path | None:
        """File of the image; None if it is no file of its own."""
        source = self.image_source
        arguments = source.args if isinstance(source, partial) else ()
        return arguments[0] if arguments and isinstance(arguments[0], Path) else None

    def held(self) -> "CaptureFrame":
        """Return the view with its arrays in memory; raises `CaptureError` if reading fails."""
        names = ("image", "depth", "normals", "labels", "mask", "sky")
        return replace(self, **{f"{name}_source": getattr(self, name) for name in names})

    def _read(self, name: str, source: Source | None) -> Any:
        array = source() if callable(source) else source
        if array is None:
            return None
        size = (self.camera.height, self.camera.width)
        if array.shape[:2] != size:
            raise CaptureError(f"view {self.name!r}: {name} is {array.shape[:2]}, its camera says {size}")
        channels = (3,) if name in ("image", "normals") else ()
        if array.shape[2:] != channels:
            raise CaptureError(f"view {self.name!r}: {name} has the shape {array.shape}, expected {(*size, *channels)}")
        return array


class LidarSource(NamedTuple):
    """Stored form of a sweep, for copies of its recording."""

    key: Hashable
    """File of the sweep, or its position in the recording."""
    sensor_to_world: Float64[np.ndarray, "4 4"]
    """Stored points to the capture's world, a rigid transform."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarSweep:
    """Lidar points in the capture's world."""

    time_s: float
    points_m: Float32[np.ndarray, "p 3"]
    origin_m: Float64[np.ndarray, "3"]
    """Position of the sensor."""
    intensities: Float32[np.ndarray, " p"] | None = None
    """Intensities in the dataset's own unit."""
    source: LidarSource | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TrackedBox:
    """An annotated object over time. Its frame: x forward, y left, z up, origin at the bottom center."""

    id: str
    class_name: str
    size_lwh: tuple[float, float, float]
    """Length, width and height in meters."""
    track: PoseTrack
    """Object to the capture's world."""


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """Views of one place. The arrays must not be modified.

    The world of a driving capture has meters, the dataset's own axes with z up, and its origin at the ego's first
    position, so that float32 suffices. A COLMAP world keeps COLMAP's axes and unit.
    """

    name: str
    """Of its folder, or of its drive in a data set."""
    views: tuple[CaptureFrame, ...]
    """Images with their cameras and times; a capture is a sequence of these."""
    points_m: Float64[np.ndarray, "p 3"] | None = None
    """Surface points (COLMAP) in the world; None if the dataset has none."""
    point_colors: UInt8[np.ndarray, "p 3"] | None = None
    """Display color of each point."""
    sweeps: tuple[LidarSweep, ...] = ()
    """Lidar turns in the world."""
    boxes: tuple[TrackedBox, ...] = ()
    """Labeled objects with their 3D boxes over time."""
    ego: PoseTrack | None = None
    """Track of the vehicle: x forward, y left, z up, origin `EGO_HEIGHT_M` above the road."""
    is_metric: bool = True
    """True if lengths are in meters; otherwise their unit is unknown."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Upward direction in the world's axes."""
    has_poses: bool = True
    """True if camera poses are known; otherwise each view has its own origin."""
    problems: tuple[str, ...] = ()
    """One sentence for each omission with its reason; everything else is used."""

    def __post_init__(self) -> None:
        counted = Counter(view.name for view in self.views)
        doubled = sorted(name for name, count in counted.items() if count > 1)
        if doubled:
            raise CaptureError(f"capture {self.name!r} has several views named {doubled[0]!r}")
        for name in counted:
            parts = PurePath(name.replace("\\", "/")).parts
            if not parts or ".." in parts or parts[0].startswith("/") or "\0" in name:
                raise CaptureError(
                    f"capture {self.name!r}: {name!r} can't be the name of a view, which files are called by"
                )
        object.__setattr__(self, "problems", tuple(printable_line(each, _LONGEST) for each in self.problems))

    def __len__(self) -> int:
        return len(self.views)

    def __iter__(self) -> Iterator[CaptureFrame]:
        return iter(self.views)

    def __getitem__(self, index: int) -> CaptureFrame:
        return self.views[index]

    @property
    def has(self) -> frozenset[str]:
        """Optional arrays that every view has: depth, normals, labels, mask, sky."""
        optional = ("depth", "normals", "labels", "mask", "sky")
        return frozenset(name for name in optional if all(getattr(view, f"{name}_source") is not None for view in self))

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of their first views."""
        return tuple(dict.fromkeys(view.sensor for view in self.views))


# View and camera names


def view_names(pictures: Sequence[str]) -> list[str]:
    """Name views after their image paths, uniquely, without common folders and, if possible, suffixes.

    Other folders are joined by "_".
    """
    flat = ["_".join(parts) for parts in _parts(pictures)]
    short = [name.rpartition(".")[0] or name for name in flat]
    counted = Counter(short)
    names: dict[str, None] = {}
    for each, whole in zip(short, flat, strict=True):
        name = free = each if counted[each] == 1 else whole
        number = 1
        while free in names:
            number += 1
            free = f"{name}_{number}"
        names[free] = None
    return list(names)


def sensor_names(pictures: Sequence[str]) -> list[str]:
    """Name the camera of each image after its folder, without common folders; empty if nothing is left."""
    return ["_".join(parts[:-1]) for parts in _parts(pictures)]


def _parts(pictures: Sequence[str]) -> list[tuple[str, ...]]:
    """Folders and name of each image, without the common folders."""
    parts = [
        tuple(part for part in PurePosixPath(picture.replace("\\", "/")).parts if part not in ("/", ".", ".."))
        or ("unnamed",)
        for picture in pictures
    ]
    shared = 0
    while parts and all(len(each) > shared + 1 and each[shared] == parts[0][shared] for each in parts):
        shared += 1
    return [each[shared:] for each in parts]


# Readable images


def readable_images(capture: Capture, on_progress: Callable[[float], None] | None = None) -> Capture:
    """Read each image once and omit unreadable views, listing them in the capture's problems.

    Raises `CaptureError` if none is left.
    """
    views: list[CaptureFrame] = []
    broken: list[str] = []
    for k, view in enumerate(capture, 1):
        try:
            _ = view.image
            views.append(view)
        except CaptureError as error:
            broken.append(f"View {view.name} is left out: {error}.")
        if on_progress is not None:
            on_progress(k / len(capture))
    if not views:
        raise CaptureError(f"{capture.name}: not one picture can be read ({broken[0]})" if broken else capture.name)
    return replace(capture, views=tuple(views), problems=(*capture.problems, *broken)) if broken else capture


# Lists in messages

_MAX_NAMES = 3


def abbreviated_names(names: Sequence[str]) -> str:
    """Return the first few names and the number of others: "a, b, c and 4 more"."""
    more = len(names) - _MAX_NAMES
    return ", ".join(names[:_MAX_NAMES]) + (f" and {more} more" if more > 0 else "")


def omissions(reasons: Sequence[str], what: str) -> list[str]:
    """Return one problem for all omitted items, such as `what` "4 of 9 images"; none if nothing was omitted."""
    return [f"{what} are left out: {abbreviated_names(reasons)}."] if reasons else []


# File names inside a capture

_LONGEST_NAME = 200  # maximum number of characters of a name in a message
_allowed: ContextVar[bool] = ContextVar("outside_allowed", default=False)


class OutsideError(CaptureError):
    """A capture names a file outside its folder."""


def allow_outside(allowed: bool) -> None:
    """Allow or forbid names outside the capture's folder for the rest of this context."""
    _allowed.set(allowed)


@contextmanager
def outside_allowed(allowed: bool | None) -> Generator[None]:
    """Allow (True) or forbid (False) outside names in this block; None keeps the current state."""
    token = _allowed.set(_allowed.get() if allowed is None else allowed)
    try:
        yield
    finally:
        _allowed.reset(token)


def check_inside(folder: Path, names: Iterable[str], source: Path) -> None:
    """Check that names found in the file `source` stay inside `folder`, to which they are relative.

    Raises `OutsideError` for the first one that leads out of it (absolute, by "..", or through a link), unless that is
    allowed. Names that can't be file names are left to their readers.
    """
    if _allowed.get():
        return
    home = Path(os.path.realpath(folder))
    parents: dict[Path, Path] = {}
    for name in dict.fromkeys(names):
        if "\0" in name:
            continue
        path = folder / name
        if path.parent not in parents:
            parents[path.parent] = Path(os.path.realpath(path.parent))
        real = parents[path.parent] / path.name
        try:
            if path.name in ("", "..") or real.is_symlink():
                real = Path(os.path.realpath(real))
        except OSError:  # name too long
            continue
        if not real.is_relative_to(home):
            shown = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..."
            raise OutsideError(
                f"{source}: names {shown!r}, which leads out of {folder}; --allow-outside reads such files all the same"
            )
