"""Rainy views on disk: images of other programs as a transfer, transfer folders, and contact sheets."""

import json
import logging
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, overload

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from PIL import Image, ImageDraw

from ..datasets.capture import Capture, CaptureError, CaptureFrame
from ..datasets.capture_folder import read_capture_folder, write_cameras, write_view, write_world
from ..datasets.image_override import find_images, flat_name, sized_image
from ..datasets.io.images import read_color, read_labels
from ..safe_io.file_names import shortened
from ..safe_io.files import whole_folder
from ..safe_io.text_files import json_values, printable_line, read_whole
from .base import ClearView, Plane, RainyView, SkippedCounts

logger = logging.getLogger("gsrain")
Bytes = UInt8[np.ndarray, "h w ..."]


class PrecomputedTransfer:
    """`Transfer` that reads images from a folder, matched by the views' names."""

    name = "images"

    def __init__(self, folder: Path) -> None:
        """List the images; raises `CaptureError` if the folder doesn't exist."""
        self._pictures = find_images(folder)

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Read the image of each view, resized to the view's size.

        Views without an image are skipped; one of them, and one of the images without a view, is logged. Raises
        `CaptureError` if no view has an image, and for a broken image or one of another aspect ratio.
        """
        missing, named = list[str](), list[tuple[str, str]]()
        for view in views:
            named.append((view.name, view.sensor))
            file = self._pictures.file_of(view.name, view.sensor)
            if file is None:
                missing.append(view.name)
                continue
            size = (view.camera.width, view.camera.height)
            yield RainyView(view, sized_image(file, size).astype(np.float32) / np.float32(255))
        folder = self._pictures.folder
        if len(missing) == len(named):
            raise CaptureError(f"--images {folder}: has no picture of a view; expected {named[0][0]}.png, for one")
        if missing:
            logger.warning("%d views have no picture in %s, %r for one", len(missing), folder, missing[0])
        left_over = self._pictures.left_over(named)
        if left_over:
            logger.warning("%d pictures in %s belong to no view, %r for one", len(left_over), folder, left_over[0])


# Transfer folder: a capture folder of rainy images
#
# Besides the files that `datasets.capture_folder` reads (NAME.png is the rainy image) it holds clear/NAME.png, the
# clear image; NAME.film.png, the share of water reflection; NAME.sky_share.png and NAME.vehicles.png, shares of 255;
# and transfer.json, the `TransferRecord`. Cameras, depth and normals have the units and axes of their source.

TRANSFER = "transfer.json"
_CLEAR = "clear"
_OLD_NAME_BYTES = 200
_VERSION = 1
_LARGEST = 1e9  # bound of a transform: meters per unit, and meters to the origin


def check_transferred_folder(folder: Path) -> None:
    """Raise ValueError if rainy views can't be written: `folder` is a file or holds something else."""
    if folder.is_file():
        raise ValueError(f"{folder}: is a file; expected a new folder, or one of a transfer to replace")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / TRANSFER).is_file():
        raise ValueError(f"{folder}: holds other things; expected a new folder, or one of a transfer to replace")


@dataclass(frozen=True, slots=True, eq=False)
class TransferRecord:
    """Method, source and settings of a transfer, in its transfer.json."""

    method: str
    made_of: str
    """Name of the scene or capture."""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Plain values."""
    to_world: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Similarity from the units and axes of the scene or capture to the world (meters, z up)."""
    notes: tuple[str, ...] = ()
    """Skipped steps, one sentence each."""

    @property
    def metres_per_unit(self) -> float:
        """Meters per unit of the scene or capture."""
        return float(np.cbrt(np.linalg.det(self.to_world[:3, :3])))


def write_transferred(
    folder: Path,
    views: Iterable[RainyView],
    record: TransferRecord,
    mask: Callable[[str], Bool[np.ndarray, "_ _"] | None] = lambda name: None,
) -> Iterator[RainyView]:
    """Write rainy views one by one, and yield each once it is on disk.

    The folder appears once all views are written, and then replaces an older transfer; an interrupted run leaves the
    old state. Names of views become file names, with _ for each /. Skipped steps are added to the record's notes.
    `mask` returns the pixels of a view that are valid for training, by its name; None means all.

    Raises ValueError if the folder holds something else, or two views have the same file name.
    """
    check_transferred_folder(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    rows: dict[str, dict[str, Any]] = {}
    skipped, has_poses = SkippedCounts(), False
    old = folder.with_name(f".{shortened(folder.name, _OLD_NAME_BYTES)}.old")
    with whole_folder(folder) as new_folder:
        (new_folder / _CLEAR).mkdir()
        for rainy in views:
            view = _capture_frame(rainy, record, mask(rainy.clear.name))
            if view.name in rows:
                raise ValueError(f"{folder}: two views would have the file name {view.name}.png")
            rows[view.name] = write_view(new_folder, view)
            _write_shares(new_folder, view.name, rainy)
            skipped.add(rainy)
            has_poses |= rainy.clear.has_pose
            yield rainy
        if not rows:
            raise ValueError(f"{folder}: there is no view to write")
        write_cameras(new_folder, list(rows.values()))
        write_record(new_folder, replace(record, notes=skipped.sentences), has_poses=has_poses)
        shutil.rmtree(old, ignore_errors=True)
        if folder.is_dir():
            folder.rename(old)  # removed once the new folder is complete
    shutil.rmtree(old, ignore_errors=True)


def is_transferred_folder(folder: Path) -> bool:
    return (folder / TRANSFER).is_file()


def read_transferred(folder: Path) -> "TransferredViews":
    """Read rainy views back lazily; raises `CaptureError` for a folder of another kind."""
    return TransferredViews(folder, read_record(folder), read_capture_folder(folder))


class TransferredViews(Sequence[RainyView]):
    """Views of a transfer folder, in the world; colors and shares at 8 bits, normals as half floats."""

    def __init__(self, folder: Path, record: TransferRecord, capture: Capture) -> None:
        self.record = record
        self._folder, self._capture = folder, capture

    def __len__(self) -> int:
        return len(self._capture)

    @overload
    def __getitem__(self, index: int) -> RainyView: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[RainyView]: ...
    def __getitem__(self, index: int | slice) -> RainyView | Sequence[RainyView]:
        if isinstance(index, slice):
            return TransferredViews(self._folder, self.record, replace(self._capture, views=self._capture.views[index]))
        view, to_world, scale = self._capture[index], self.record.to_world, self.record.metres_per_unit
        turn = (to_world[:3, :3] / scale).T
        nothing = np.zeros((view.camera.height, view.camera.width), np.float32)
        depth, normals = view.depth, view.normals
        shares = (self._share(view.name, kind) for kind in ("sky_share", "vehicles"))
        sky, vehicles = (nothing if each is None else each for each in shares)
        clear = ClearView(
            view.name, view.camera.moved(to_world), view.time_s,
            _to_unit(read_color(self._folder / _CLEAR / f"{view.name}.png")),
            nothing if depth is None else depth * np.float32(scale),
            np.dstack([nothing] * 3) if normals is None else (normals @ turn).astype(np.float32),
            sky, vehicles, view.sensor, has_pose=self._capture.has_poses,
        )  # fmt: skip
        return RainyView(clear, _to_unit(view.image), self._share(view.name, "film"))

    def _share(self, name: str, kind: str) -> Plane | None:
        file = self._folder / f"{name}.{kind}.png"
        return _to_unit(read_labels(file)) if file.is_file() else None


def _capture_frame(rainy: RainyView, record: TransferRecord, mask: Bool[np.ndarray, "h w"] | None) -> CaptureFrame:
    """Rainy image as a view in the units and axes of the scene or capture."""
    clear, scale = rainy.clear, record.metres_per_unit
    from_world = np.linalg.inv(record.to_world)
    normals = (clear.normals @ (from_world[:3, :3] * scale).T).astype(np.float32) if clear.normals.any() else None
    return CaptureFrame(
        flat_name(clear.name), clear.camera.moved(from_world), _bytes(rainy.image), clear.time_s, clear.sensor,
        depth_source=clear.depth / np.float32(scale) if clear.depth.any() else None,
        normals_source=normals, mask_source=mask, sky_source=clear.sky >= 0.5,
    )  # fmt: skip


def _write_shares(folder: Path, name: str, rainy: RainyView) -> None:
    Image.fromarray(_bytes(rainy.clear.image)).save(folder / _CLEAR / f"{name}.png")
    shares = {"sky_share": rainy.clear.sky, "vehicles": rainy.clear.vehicles, "film": rainy.film}
    for kind, share in shares.items():
        if share is not None and (kind == "film" or share.any()):
            Image.fromarray(_bytes(share)).save(folder / f"{name}.{kind}.png")


def _bytes(values: Float32[np.ndarray, "h w ..."]) -> Bytes:
    return np.rint(np.clip(values, 0, 1) * np.float32(255)).astype(np.uint8)


def _to_unit(values: Bytes) -> Float32[np.ndarray, "h w ..."]:
    """Shares or display color, 0..1, of 8-bit values."""
    return values.astype(np.float32) / np.float32(255)


def write_record(folder: Path, record: TransferRecord, *, has_poses: bool = True) -> None:
    """Write the record, and a world file if z is not up, the unit is not the meter, or poses are unknown."""
    values = {
        "version": _VERSION, "method": record.method, "made_of": record.made_of, "settings": dict(record.settings),
        "to_world": record.to_world.tolist(), "notes": list(record.notes),
    }  # fmt: skip
    (folder / TRANSFER).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    x, y, z = (record.to_world[2, :3] / record.metres_per_unit).tolist()
    is_metric = bool(np.isclose(record.metres_per_unit, 1, atol=1e-9))
    if not is_metric or not has_poses or not np.allclose((x, y, z), (0, 0, 1), atol=1e-12):
        write_world(folder, (x, y, z), is_metric=is_metric, has_poses=has_poses)


def read_record(folder: Path) -> TransferRecord:
    """Read the record of a transfer; raises `CaptureError` if the file is missing or of another kind."""
    file = folder / TRANSFER
    try:
        values = json_values(read_whole(file))
        if values["version"] > _VERSION:
            raise CaptureError(
                f"{file}: version {values['version']} is newer than {_VERSION}, which this program knows"
            )
        to_world = np.array(values["to_world"], np.float64)
        is_bounded = to_world.shape == (4, 4) and bool((np.abs(to_world) <= _LARGEST).all())  # so nothing overflows
        if not is_bounded or np.linalg.det(to_world[:3, :3]) <= 0:
            raise CaptureError(f"{file}: to_world must be a similarity, 4x4 numbers within {_LARGEST:g}")
        notes = tuple(printable_line(str(each)) for each in list(values.get("notes", ())))
        return TransferRecord(str(values["method"]), str(values["made_of"]), dict(values["settings"]), to_world, notes)
    except (OSError, KeyError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, CaptureError):
            raise
        raise CaptureError(f"{file}: not the record of a transfer ({printable_line(error)})") from None


# Contact sheet

_MARGIN_PX, _LINE_PX = 8, 16
_BACKGROUND, _TEXT = (24, 26, 28), (220, 222, 224)


class ContactSheet:
    """Image that shows evenly chosen views before and after a transfer: one row each, clear on the left."""

    def __init__(self, count: int, at_most: int = 6, width_px: int = 640) -> None:
        """Take the number of views to come, the largest number to show, and the width of each image."""
        self._chosen = set(np.linspace(0, count - 1, min(at_most, count)).round().astype(int).tolist())
        self._width = width_px
        self._added = 0
        self._rows: list[tuple[str, list[Image.Image]]] = []

    def add(self, view: RainyView) -> None:
        if self._added in self._chosen:
            self._rows.append((view.clear.name, [self._sized(view.clear.image), self._sized(view.image)]))
        self._added += 1

    def picture(self) -> Image.Image:
        heights = [_LINE_PX + max(each.height for each in images) + _MARGIN_PX for _, images in self._rows]
        sheet = Image.new("RGB", (2 * self._width + 3 * _MARGIN_PX, sum(heights) + _MARGIN_PX), _BACKGROUND)
        pen, top = ImageDraw.Draw(sheet), _MARGIN_PX
        for (name, images), height in zip(self._rows, heights, strict=True):
            pen.text((_MARGIN_PX, top), name, fill=_TEXT)
            for i, image in enumerate(images):
                sheet.paste(image, (_MARGIN_PX + i * (self._width + _MARGIN_PX), top + _LINE_PX))
            top += height
        return sheet

    def _sized(self, image: Float32[np.ndarray, "h w 3"]) -> Image.Image:
        scale = self._width / image.shape[1]
        size = (self._width, max(round(image.shape[0] * scale), 1))
        resized = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
        return Image.fromarray(_bytes(resized))
