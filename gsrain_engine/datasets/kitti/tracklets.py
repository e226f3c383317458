"""KITTI's annotations of a raw drive: tracklet_labels.xml, boxes in the lidar's frame for each picture's number."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ..capture import CaptureError
from ..geometry.rigid_poses import rigid
from .calibration import read_text


@dataclass(frozen=True, slots=True, eq=False)
class Tracklet:
    """One thing over consecutive pictures."""

    class_name: str
    size_lwh: tuple[float, float, float]
    first_frame: int
    centers_to_lidar: tuple[Float64[np.ndarray, "4 4"], ...]
    """Box (x forward, y left, z up, origin at its centre) to lidar, for each picture from the first."""


def read_tracklets(file: Path) -> list[Tracklet]:
    """Read all; `CaptureError` where the file is damaged, or defines entities (which can grow without an end)."""
    text = read_text(file)
    if "<!ENTITY" in text:
        raise CaptureError(f"{file}: refused, for it defines entities, which no file of KITTI does")
    try:
        items = list(ElementTree.fromstring(text).iterfind("tracklets/item"))
        return list(_tracklets(items))
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: not a readable list of tracklets ({error})") from None


def _tracklets(items: list[ElementTree.Element]) -> Iterator[Tracklet]:
    for item in items:
        height, width, length = (_number(item, name) for name in ("h", "w", "l"))
        poses = tuple(_pose(pose, height) for pose in item.iterfind("poses/item"))
        if poses:
            name, first = item.findtext("objectType", "unknown").strip(), int(_number(item, "first_frame"))
            yield Tracklet(name, (length, width, height), first, poses)


def _pose(item: ElementTree.Element, height: float) -> Float64[np.ndarray, "4 4"]:
    """The file has the place of the bottom centre and, of angles, only rz in use."""
    x, y, z, turn = (_number(item, name) for name in ("tx", "ty", "tz", "rz"))
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return rigid(rotation, np.array([x, y, z + height / 2]))


def _number(item: ElementTree.Element, name: str) -> float:
    text = item.findtext(name)
    if text is None:
        raise ValueError(f"an item without {name}")
    return float(text)
