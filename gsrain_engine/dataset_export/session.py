"""Writes a data set: labels once, pictures and lidar for each rain. Run again, it resumes."""

import json
import os
import shutil
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ..appearance.capture_photos import COPY_JPEG_QUALITY
from ..datasets.geometry import Pose
from ..datasets.io.images import read_color
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.images import write_image, write_labels, write_png
from ..render.renderer import Renderer
from ..report.numbers import run_provenance, write_json, write_text
from ..report.result import RunResult
from ..report.table import Table, columns
from ..safe_io.files import whole_file
from ..safe_io.text_files import json_values, read_whole
from ..scene.progress import Progress
from .layout import DatasetLayout, LabeledDataset, camera_word
from .source import DatasetSource, ObjectLabels, PicturesInRain, PlacedBox

_RECORD = "dataset.json"
_MANY = 256  # a count of labels for which instances are stored with 16 bits
_STRIP_PX = 480  # width of a picture in the figure


def export_dataset(
    renderer: Renderer,
    source: DatasetSource,
    target: Path,
    rains: Sequence[RainSettings],
    layout: DatasetLayout,
) -> Generator[Progress, None, RunResult[Path]]:
    """Write the pictures, lidar and labels of a source in some rains into a folder.

    `labels` has what rain doesn't change, once: boxes, masks, depth, and the tables of the layout. `rain_8.5` has the
    pictures and turns, what each picture holds (`provenance`), and the tables, which share the disk's blocks with those
    in `labels` where the disk can. Files are complete or absent: the same call resumes, and may add rains.

    Raises:
        ValueError: For a folder that holds another data set or anything else, rains with equal names, and a source
            that the layout can't hold.
        CaptureError: For an image that can't be read.
        OSError: When a file can't be written.
    """
    left_out = [*source.left_out]
    if layout.needs_poses and not source.has_poses:
        raise ValueError(f"layout {layout.name}: {source.name} has no camera poses, which it holds; coco needs none")
    if not layout.has_lidar:
        left_out.append(f"lidar: the layout {layout.name} has none")
    folders = {target / f"rain_{rain.intensity_mm_h:g}": rain for rain in rains}
    if len(folders) < len(rains):
        raise ValueError("intensities: two of them have the same name; expected different ones")
    shots = [
        (moment, camera)
        for moment in range(len(source.moments))
        for camera in source.cameras
        if source.shot(moment, camera) is not None
    ]
    files = [layout.picture_file(source, *shot) for shot in shots]
    if len(set(files)) < len(files):
        raise ValueError(f"cameras: names of two cameras of {source.name} lead to the same file; leave one out")
    _check_target(target, source, layout)
    for folder, rain in folders.items():
        _check_same(folder / "rain.json", msgspec.to_builtins(rain), "was made in another rain")
    writer = _DatasetWriter(renderer, source, layout, target)
    steps = max(len(source.moments) * (1 + len(rains)) + len(shots) * (1 + len(rains)), 1)
    done = 0
    for moment in range(len(source.moments)):
        cameras = [camera for number, camera in shots if number == moment]
        what = f"Moment {moment + 1} of {len(source.moments)}"
        writer.write_moment(moment)
        done += 1
        yield Progress(done / steps, f"{what}, labels")
        for camera in cameras:
            writer.write_objects(moment, camera)
            done += 1
            yield Progress(done / steps, f"{what}, labels of {camera}")
        for folder, rain in folders.items():
            writer.write_sweep(moment, folder, rain)
            done += 1
            yield Progress(done / steps, f"{what}, {rain.intensity_mm_h:g} mm/h")
            for camera in cameras:
                writer.write_picture(moment, camera, folder, rain)
                done += 1
                yield Progress(done / steps, f"{what}, {rain.intensity_mm_h:g} mm/h, {camera}")
    dataset = writer.labeled(shots)
    tables = target / "labels" / layout.name
    layout.write_tables(dataset, tables)
    for folder in folders:
        for file in sorted(each for each in tables.rglob("*") if each.is_file()):
            _share(file, folder / file.relative_to(tables))
    return _result(writer, dataset, folders, shots, left_out)


class _DatasetWriter:
    def __init__(self, renderer: Renderer, source: DatasetSource, layout: DatasetLayout, target: Path) -> None:
        self.source, self.layout, self.target = source, layout, target
        self.written = self.found = 0
        """Numbers of pictures: drawn, and those of an earlier call."""
        self._renderer, self._labels = renderer, target / "labels"
        self._in_rain: dict[Path, PicturesInRain] = {}
        self._rainfall: dict[Path, RainSimulation] = {}

    def moment_file(self, moment: int) -> Path:
        return self._labels / "moments" / f"{moment:06d}.json"

    def objects_file(self, moment: int, camera: str) -> Path:
        return self._labels / "objects" / camera_word(camera) / f"{moment:06d}.json"

    def write_moment(self, moment: int) -> None:
        """Write place, time and boxes of a moment, unless they are there."""
        file = self.moment_file(moment)
        if file.exists():
            return
        boxes, at = self.source.boxes(moment), self.source.moments[moment]
        counts, lidar = self.source.lidar_points(moment, boxes), self.source.lidar_to_world(moment)
        rows = [
            {
                "object": box.id, "class_name": box.class_name, "size_lwh_m": list(box.size_lwh_m),
                "object_to_world": box.to_world.tolist(), "lidar_points": count,
            }
            for box, count in zip(boxes, counts, strict=True)
        ]  # fmt: skip
        values = {
            "moment": moment, "time_s": at.time_s, "vehicle_to_world": at.vehicle_to_world.tolist(),
            "lidar_to_world": None if lidar is None else lidar.tolist(), "boxes": rows,
        }  # fmt: skip
        write_text(file, json.dumps(values) + "\n")

    def write_objects(self, moment: int, camera: str) -> None:
        """Write the labels of a picture, unless they are there: masks and depth first."""
        file = self.objects_file(moment, camera)
        if file.exists():
            return
        labels: ObjectLabels = self.source.labels(self._renderer, moment, camera)
        shot = self.source.shot(moment, camera)
        assert shot is not None
        name = f"{camera_word(camera)}/{moment:06d}.png"
        if labels.instances is not None:
            write_labels(self._labels / "instances" / name, labels.instances, _MANY)
        if labels.depth_m is not None:  # cm, as gsrain render --depth writes it
            depth = np.rint(np.clip(labels.depth_m * 100, 0, 65535)).astype(np.uint16)
            write_png(self._labels / "depth" / name, depth)
        at = {"moment": moment, "camera": camera, "time_s": shot.time_s, "pose": shot.camera.to_json()}
        write_text(file, json.dumps(at | {"objects": list(labels.objects)}) + "\n")

    def write_picture(self, moment: int, camera: str, folder: Path, rain: RainSettings) -> None:
        """Write a picture in a rain after its provenance, unless it is there."""
        path = folder / self.layout.picture_file(self.source, moment, camera)
        if path.exists():
            self.found += 1
            return
        if folder not in self._in_rain:
            self._in_rain[folder] = self.source.in_rain(self._renderer, rain)
        picture, held = self._in_rain[folder].picture(moment, camera)
        write_json(folder / "provenance" / camera_word(camera) / f"{moment:06d}.json", msgspec.to_builtins(held))
        write_image(path, Image.fromarray(picture), COPY_JPEG_QUALITY)
        self.written += 1

    def write_sweep(self, moment: int, folder: Path, rain: RainSettings) -> None:
        """Write the lidar's turn in a rain, unless it is there."""
        if not (self.source.has_lidar and self.layout.has_lidar):
            return
        paths = [folder / name for name in self.layout.sweep_files(self.source, moment)]
        if paths and all(path.exists() for path in paths):
            return
        if folder not in self._rainfall:
            self._rainfall[folder] = RainSimulation.start(rain)
        rows = self.source.rows(moment, self._rainfall[folder])
        if rows is None or not paths:
            return
        with whole_file(paths[0]) as partial:
            partial.write_bytes(self.layout.sweep_bytes(rows))
        for path in paths[1:]:
            _share(paths[0], path)

    def labeled(self, shots: Sequence[tuple[int, str]]) -> LabeledDataset:
        """Read all labels back."""
        moments = [_json(self.moment_file(moment)) for moment in range(len(self.source.moments))]
        boxes = [[_box(each) for each in moment["boxes"]] for moment in moments]
        counts = [[int(each["lidar_points"]) for each in moment["boxes"]] for moment in moments]
        lidars: list[Pose | None] = [
            None if moment["lidar_to_world"] is None else np.array(moment["lidar_to_world"], np.float64)
            for moment in moments
        ]
        objects = {shot: _json(self.objects_file(*shot))["objects"] for shot in shots}
        return LabeledDataset(self.source, boxes, counts, lidars, objects)


def _box(values: Mapping[str, Any]) -> PlacedBox:
    length, width, height = values["size_lwh_m"]
    return PlacedBox(
        values["object"], values["class_name"], (length, width, height), np.array(values["object_to_world"], np.float64)
    )


def _json(file: Path) -> dict[str, Any]:
    values = json_values(read_whole(file))
    if not isinstance(values, dict):
        raise ValueError(f"{file}: expected a JSON object; remove it, and the same command writes it anew")
    return cast("dict[str, Any]", values)


def _share(file: Path, path: Path) -> None:
    """Make a file appear at another path, too, without using more of the disk where that is possible."""
    if path.exists() and path.samefile(file):
        return
    with whole_file(path) as partial:
        try:
            os.link(file, partial)
        except OSError:  # a disk without hard links
            shutil.copyfile(file, partial)


# What is there already


def _check_target(target: Path, source: DatasetSource, layout: DatasetLayout) -> None:
    """Raise ValueError, which begins with `output`, for a folder with anything else; writes what the data set is."""
    if target.is_dir() and any(target.iterdir()) and not (target / _RECORD).is_file():
        raise ValueError(f"output {target}: there is something else already; expected a new folder, or one to resume")
    values = {
        "name": source.name, "kind": source.kind, "layout": layout.name, "cameras": list(source.cameras),
        "times_s": [round(each.time_s, 6) for each in source.moments], "lidar": source.has_lidar,
        "left_out": list(source.left_out), "source": dict(source.facts),
    }  # fmt: skip
    facts = run_provenance({})
    record = {"versions": facts["versions"], "command": facts["command"]}
    _check_same(target / _RECORD, values, "holds another data set", record)


def _check_same(file: Path, values: Mapping[str, Any], problem: str, also: Mapping[str, Any] | None = None) -> None:
    """Write values to a file; where it is there, raise ValueError if it has others."""
    plain = json.loads(json.dumps(values))
    if not file.exists():
        write_json(file, {**plain, **(also or {})})
        return
    found = _json(file)
    other = next((name for name, value in plain.items() if found.get(name) != value), None)
    if other is not None:
        raise ValueError(
            f"output {file.parent}: {problem} ({other} differs); expected a new folder, or the same options"
        )


# Results


def _result(
    writer: _DatasetWriter,
    dataset: LabeledDataset,
    folders: Mapping[Path, RainSettings],
    shots: Sequence[tuple[int, str]],
    left_out: Sequence[str],
) -> RunResult[Path]:
    source, layout, target = writer.source, writer.layout, writer.target
    rows: list[tuple[str, float]] = []
    per_rain: list[dict[str, Any]] = []
    for folder, rain in folders.items():
        size = sum(each.stat().st_size for each in folder.rglob("*") if each.is_file())
        per_rain.append({"intensity_mm_h": rain.intensity_mm_h, "folder": folder.name, "bytes": size})
        rows.append((f"{folder.name}: MB", round(size / 1e6, 1)))
    objects = sum(len(each) for each in dataset.objects.values())
    sweeps = sum(each is not None for each in dataset.lidar_to_world) if layout.has_lidar else 0
    numbers: dict[str, Any] = {
        "layout": layout.name, "moments": len(source.moments), "cameras": list(source.cameras),
        "pictures_per_rain": len(shots), "lidar_turns_per_rain": sweeps, "objects_in_pictures": objects,
        "pictures_drawn": writer.written, "pictures_found": writer.found, "rains": per_rain,
        "left_out": list(left_out),
    }  # fmt: skip
    counts = {"moments": len(source.moments), "pictures in each rain": len(shots), "lidar turns in each rain": sweeps}
    rows = [*counts.items(), ("objects in pictures", objects), *rows]
    lines = [f"left out: {each}" for each in left_out]
    if writer.found:
        lines.append(f"{writer.found:,} of {writer.found + writer.written:,} pictures were there already")
    lines.append(
        f"{target}: {layout.name}, {len(source.moments):,} moments of {len(source.cameras)} cameras, "
        f"{len(shots):,} pictures and {sweeps:,} lidar turns in each of {len(folders)} rains, {objects:,} objects"
    )
    first = [folder / layout.picture_file(source, *shots[0]) for folder in folders] if shots else []
    table = Table(f"Data set of {source.name}", columns({"number of": "", "value": ",g"}), rows)
    return RunResult(made=target, table=table, numbers=numbers, lines=tuple(lines), draw=lambda: _strip(first))


def _strip(files: Sequence[Path]) -> UInt8[np.ndarray, "h w 3"]:
    """Return the first picture in each rain, side by side."""
    pictures: list[UInt8[np.ndarray, "h w 3"]] = []
    for file in files:
        image = Image.fromarray(read_color(file))
        pictures.append(np.asarray(image.resize((_STRIP_PX, max(round(image.height * _STRIP_PX / image.width), 1)))))
    return np.concatenate(pictures, axis=1) if pictures else np.zeros((1, 2, 3), np.uint8)
