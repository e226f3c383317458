"""A capture as a folder: pictures, what is known about each pixel, and one file with the cameras."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .capture import View

CAMERAS = "cameras.json"


def write_views(folder: Path, views: Iterable[View]) -> Iterator[View]:
    """Write views as they come, and yield each when it is on the disk; the cameras' file comes last.

    NAME.png is the picture, NAME.depth.npy depth in metres (float32), NAME.normals.npy world normals (float16),
    NAME.labels.png class numbers. cameras.json holds for each view its name, time and camera.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cameras: list[dict[str, Any]] = []
    for view in views:
        Image.fromarray(view.image).save(folder / f"{view.name}.png")
        if view.depth is not None:
            np.save(folder / f"{view.name}.depth.npy", view.depth, allow_pickle=False)
        if view.normals is not None:
            np.save(folder / f"{view.name}.normals.npy", view.normals.astype(np.float16), allow_pickle=False)
        if view.labels is not None:
            Image.fromarray(view.labels).save(folder / f"{view.name}.labels.png")
        cameras.append({"name": view.name, "time_s": view.time_s, **view.camera.to_json()})
        yield view
    (folder / CAMERAS).write_text(json.dumps(cameras, indent=1) + "\n", encoding="utf-8")
