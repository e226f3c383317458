"""Rainy views as a folder, which is a capture by itself: any command that takes pictures with cameras takes it.

Beside what `datasets.capture_folder` reads (NAME.png is the rainy picture) it holds clear/NAME.png, the picture before,
NAME.film.png, the share of what water mirrors, NAME.sky_share.png and NAME.vehicles.png, shares of 255, and
transfer.json, which says how it was made. Cameras, depth and normals are in the units and axes of what it was made of.
"""

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from PIL import Image

from gsrain_engine.datasets.capture import Capture, View
from gsrain_engine.datasets.capture_folder import read_capture_folder, write_cameras, write_view
from gsrain_engine.datasets.files.picture_file import read_color, read_labels
from gsrain_engine.datasets.other_pictures import flat_name
from gsrain_engine.scene.atomic_files import whole_folder
from gsrain_engine.scene.file_names import shortened

from .clear_view import ClearView
from .transfer import LeftOut, RainyView
from .transfer_record import TRANSFER, TransferRecord, read_record, write_record

_CLEAR = "clear"
_OLD_NAME_BYTES = 200


def check_transferred_folder(folder: Path) -> None:
    """Raise ValueError where rainy views may not be written: a file, or a folder with other things in it."""
    if folder.is_file():
        raise ValueError(f"{folder}: is a file; expected a new folder, or one of a transfer to replace")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / TRANSFER).is_file():
        raise ValueError(f"{folder}: holds other things; expected a new folder, or one of a transfer to replace")


def write_transferred(
    folder: Path,
    views: Iterable[RainyView],
    record: TransferRecord,
    mask: Callable[[str], Bool[np.ndarray, "_ _"] | None] = lambda name: None,
) -> Iterator[RainyView]:
    """Write rainy views as they come, and pass each on when it is on the disk.

    The folder stands once all are written; stopped before, nothing is there but what was there before: an older
    transfer is replaced in the end. Names of views become file names, with _ for each /.

    Args:
        folder: Where to; see `check_transferred_folder`.
        views: Rainy views in the world.
        record: How they are made; what could not be done for some of the views is added to its notes.
        mask: By name of a view, which of its pixels may be learned from; None means all.

    Raises:
        ValueError: Where the folder holds something else, or two views have the same file name.
    """
    check_transferred_folder(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    names: set[str] = set()
    rows: list[dict[str, Any]] = []
    left_out, has_poses = LeftOut(), False
    with whole_folder(folder) as beside:
        (beside / _CLEAR).mkdir()
        for rainy in views:
            view = _view(rainy, record, mask(rainy.clear.name))
            if view.name in names:
                raise ValueError(f"{folder}: two views would have the file name {view.name}.png")
            names.add(view.name)
            rows.append(write_view(beside, view))
            _write_shares(beside, view.name, rainy)
            left_out.add(rainy)
            has_poses |= rainy.clear.has_pose
            yield rainy
        if not rows:
            raise ValueError(f"{folder}: there is no view to write")
        write_cameras(beside, rows)
        write_record(beside, replace(record, notes=left_out.sentences), has_poses=has_poses)
        replaced = _set_aside(folder)
    shutil.rmtree(replaced, ignore_errors=True)


def is_transferred_folder(folder: Path) -> bool:
    return (folder / TRANSFER).is_file()


def read_transferred(folder: Path) -> "TransferredViews":
    """Read rainy views back, each when it is asked for; raises `CaptureError` for a folder of something else."""
    return TransferredViews(folder, read_record(folder), read_capture_folder(folder))


class TransferredViews(Sequence[RainyView]):
    """The views of a folder, in the world; colours and shares as exact as bytes are, normals as half floats."""

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
        view, turn = self._capture[index], self.record.to_world[:3, :3] / self.record.metres_per_unit
        nothing = np.zeros((view.camera.height, view.camera.width), np.float32)
        depth, normals = view.depth, view.normals
        clear = ClearView(
            view.name,
            view.camera.moved(self.record.to_world),
            view.time_s,
            _color(self._folder / _CLEAR / f"{view.name}.png"),
            nothing if depth is None else depth * np.float32(self.record.metres_per_unit),
            np.dstack([nothing] * 3) if normals is None else (normals @ turn.T).astype(np.float32),
            _share(self._folder / f"{view.name}.sky_share.png", nothing),
            _share(self._folder / f"{view.name}.vehicles.png", nothing),
            view.sensor,
            has_pose=self._capture.has_poses,
        )
        film = self._folder / f"{view.name}.film.png"
        image = view.image.astype(np.float32) / np.float32(255)
        return RainyView(clear, image, _share(film, nothing) if film.is_file() else None)


def _view(rainy: RainyView, record: TransferRecord, mask: Bool[np.ndarray, "h w"] | None) -> View:
    """The rainy picture as a view in the scene's or capture's own units and axes."""
    clear, scale = rainy.clear, record.metres_per_unit
    from_world = np.linalg.inv(record.to_world)
    return View(
        flat_name(clear.name),
        clear.camera.moved(from_world),
        _bytes(rainy.image),
        clear.time_s,
        clear.sensor,
        depth_source=(clear.depth / np.float32(scale)) if clear.depth.any() else None,
        normals_source=(clear.normals @ (from_world[:3, :3] * scale).T).astype(np.float32)
        if clear.normals.any()
        else None,
        mask_source=mask,
        sky_source=clear.sky >= 0.5,
    )


def _write_shares(folder: Path, name: str, rainy: RainyView) -> None:
    Image.fromarray(_bytes(rainy.clear.image)).save(folder / _CLEAR / f"{name}.png")
    shares = {"sky_share": rainy.clear.sky, "vehicles": rainy.clear.vehicles, "film": rainy.film}
    for kind, share in shares.items():
        if share is not None and (kind == "film" or share.any()):
            Image.fromarray(_bytes(share)).save(folder / f"{name}.{kind}.png")


def _set_aside(folder: Path) -> Path:
    """Move an older transfer out of the way, to be removed when the new one stands."""
    aside = folder.with_name(f".{shortened(folder.name, _OLD_NAME_BYTES)}.old")
    shutil.rmtree(aside, ignore_errors=True)
    if folder.is_dir():
        folder.rename(aside)
    return aside


def _bytes(values: Float32[np.ndarray, "h w ..."]) -> UInt8[np.ndarray, "h w ..."]:
    return np.rint(np.clip(values, 0, 1) * np.float32(255)).astype(np.uint8)


def _color(file: Path) -> Float32[np.ndarray, "h w 3"]:
    return read_color(file).astype(np.float32) / np.float32(255)


def _share(file: Path, otherwise: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    return read_labels(file).astype(np.float32) / np.float32(255) if file.is_file() else otherwise
