"""Label export: COCO and KITTI files with boxes, instance masks, visibility and 3D boxes."""

import json
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, UInt16

from ..choices import LabelFormat
from ..safe_io.files import whole_file
from ..scene.camera import Camera
from ..scene.objects import COCO_CATEGORIES, coco_class, scene_objects
from ..scene.progress import Progress
from .export_settings import ExportFiles, ExportSettings, export_files
from .images import write_labels
from .object_labels import VisibleObject, visible_objects
from .renderer import Renderer
from .sequence import FrameSequence

_FIRST_OWN = 1000  # first category id of classes missing in COCO


class CocoLabels:
    """COCO labels of the frames of one camera; `document` is the file's content."""

    def __init__(self, scene: str) -> None:
        self._scene = scene
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []
        self._own_classes: dict[str, int] = {}

    def add(self, number: int, time_s: float, camera: Camera, objects: Sequence[VisibleObject], **files: str) -> None:
        """Add a frame; `files` are its files by kind, of which `file_name` is part of COCO."""
        self.add_annotations(number, time_s, camera, [object_annotation(each) for each in objects], **files)

    def add_annotations(
        self, number: int, time_s: float, camera: Camera, objects: Sequence[Mapping[str, Any]], **files: str
    ) -> None:
        """Add a frame with objects as `object_annotation` describes them."""
        image_id, size = len(self._images) + 1, {"width": camera.width, "height": camera.height}
        times = {"frame": number, "time_s": time_s, "camera": camera.to_json()}
        self._images.append({"id": image_id, **size, **files, **times})
        for each in objects:
            rest = {name: value for name, value in each.items() if name != "class_name"}
            category = {"category_id": self._category(str(each["class_name"]))}
            self._annotations.append({"id": len(self._annotations) + 1, "image_id": image_id, **category, **rest})

    @property
    def document(self) -> dict[str, Any]:
        categories = COCO_CATEGORIES | self._own_classes
        return {
            "info": {
                "description": f"Rendered frames of {self._scene}: boxes and masks are those of visible pixels; "
                "rain does not change them. box_3d is in the camera's frame (x right, y down, z forward), metres.",
                "version": "1",
            },
            "licenses": [],
            "images": self._images,
            "annotations": self._annotations,
            "categories": [{"id": number, "name": name} for name, number in categories.items()],
        }

    def _category(self, class_name: str) -> int:
        name, own = coco_class(class_name), self._own_classes
        if name not in COCO_CATEGORIES:
            own.setdefault(name, _FIRST_OWN + len(own))
        return (COCO_CATEGORIES | own)[name]


def object_annotation(item: VisibleObject) -> dict[str, Any]:
    """Return the annotation of a visible object without its ids; `class_name` takes the place of the category's."""
    left, top, right, bottom = item.box_xyxy
    return {
        "class_name": item.object.class_name,
        "bbox": [left, top, right - left, bottom - top],
        "area": int(item.mask.sum()),
        "segmentation": encode_rle(item.mask),
        "iscrowd": 0,
        "object": item.object.id,
        "visibility": round(item.visibility, 4),
        "truncation": round(item.truncation, 4),
        "distance_m": round(item.distance_m, 3),
        "box_3d": box_annotation(item.size_lwh_m, item.to_camera),
    }


def box_annotation(size_lwh_m: Sequence[float], to_camera: Float64[np.ndarray, "4 4"]) -> dict[str, Any]:
    """Return a 3D box as plain values: its sides, and its pose in the camera's frame, meters."""
    return {
        "size_lwh_m": [round(side, 4) for side in size_lwh_m],
        "object_to_camera": to_camera.round(6).tolist(),
    }


# KITTI
# Format of KITTI's object benchmark (Geiger et al., 2012): label_2, calib, and instance masks. Its pixel centers
# are whole numbers, ours are halves: boxes and principal points are shifted by half a pixel.

_CLASSES = {"car": "Car", "truck": "Truck", "person": "Pedestrian", "cyclist": "Cyclist", "train": "Tram"}
_FREE, _PARTLY = 0.8, 0.4  # minimum visibility of a fully visible, and of a partly occluded object
_EGO_TO_CAMERA = "0 -1 0 0 0 0 -1 0 1 0 0 0"
"""From x forward, y left, z up (KITTI's lidar) to x right, y down, z forward; without translation."""


def label_line(item: VisibleObject) -> str:
    """Type, truncation, occlusion, alpha, 2D box, height, width, length, bottom center, rotation about y."""
    return label_of_box(
        item.object.class_name, item.box_xyxy, item.size_lwh_m, item.to_camera, item.visibility, item.truncation
    )


def label_of_box(
    name: str,
    box_xyxy: Sequence[float],
    size_lwh_m: Sequence[float],
    to_camera: Float64[np.ndarray, "4 4"],
    visibility: float,
    truncation: float,
) -> str:
    """Return the line of `label_line` for an object with this class, 2D box (pixels, outer edges) and 3D box."""
    x, y, z = to_camera[:3, 3]
    ahead = to_camera[:3, 0]
    turn = float(np.arctan2(-ahead[2], ahead[0]))
    alpha = float((turn - float(np.arctan2(x, z)) + np.pi) % (2 * np.pi) - np.pi)
    occlusion = 0 if visibility >= _FREE else 1 if visibility >= _PARTLY else 2
    length, width, height = size_lwh_m
    box = [edge - 0.5 for edge in box_xyxy]
    numbers = [alpha, *box, height, width, length, x, y, z, turn]
    kind = "Van" if name.lower() == "van" else _CLASSES.get(coco_class(name), "Misc")
    return f"{kind} {truncation:.2f} {occlusion} " + " ".join(f"{each:.2f}" for each in numbers)


def calibration_file(camera: Camera, lidar_to_camera: Float64[np.ndarray, "4 4"] | None = None) -> str:
    """Calibration of a frame: four identical cameras without a baseline, and a lidar, by default at their position."""
    matrix = f"{camera.fx:.12e} 0 {camera.cx - 0.5:.12e} 0 0 {camera.fy:.12e} {camera.cy - 0.5:.12e} 0 0 0 1 0"
    cameras = "".join(f"P{number}: {matrix}\n" for number in range(4))
    lidar = _EGO_TO_CAMERA
    if lidar_to_camera is not None:
        lidar = " ".join(f"{each:.12e}" for each in lidar_to_camera[:3].ravel())
    return f"{cameras}R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {lidar}\nTr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0\n"


def instances(objects: Sequence[VisibleObject], camera: Camera) -> UInt16[np.ndarray, "h w"]:
    """Number of the label line, counted from 1, for each pixel; 0 is none."""
    picture = np.zeros((camera.height, camera.width), np.uint16)
    for line, each in enumerate(objects, start=1):
        picture[each.mask] = line
    return picture


# Label files


def write_object_labels(
    renderer: Renderer,
    form: LabelFormat,
    recording: ExportSettings,
    sequences: Mapping[str, FrameSequence],
    numbers: Sequence[int],
) -> Generator[Progress, None, list[Path]]:
    """Label the frames of an export by their numbers; returns the written files and folders.

    Labels don't depend on rain, so the clear twin has the same ones. Raises `OSError` if they can't be written, and
    `ValueError` for a scene without labeled objects.
    """
    written: list[Path] = []
    for place, (name, sequence) in enumerate(sequences.items()):
        objects = scene_objects(sequence.scene)
        if not objects:
            raise ValueError(f"scene {sequence.scene.name!r} has no actors that labels could be about")
        camera_name = name if len(sequences) > 1 else None
        files = export_files(recording, camera_name)
        twin = export_files(recording, camera_name, is_clear=True) if recording.twin else None
        coco = CocoLabels(sequence.scene.name)
        for done, number in enumerate(numbers):
            shot = sequence.shot(number)
            visible = visible_objects(renderer, sequence.scene, objects, shot.camera, shot.time_s)
            if form == "coco":
                coco.add(number, shot.time_s, shot.camera, visible, **_names(files, twin, number))
            else:
                _write_kitti(files, number, sequence, visible)
            yield Progress((place + (done + 1) / len(numbers)) / len(sequences), f"Labels of frame {number}")
        written.append(_labels_of(form, files))
        if form == "coco":
            with whole_file(written[-1]) as partial:
                partial.write_text(json.dumps(coco.document) + "\n", encoding="utf-8")
    return written


def label_outputs(form: LabelFormat, recording: ExportSettings, cameras: Sequence[str]) -> list[Path]:
    """Files and folders of these cameras' labels, except those inside folders of frames."""
    found = [export_files(recording, name if len(cameras) > 1 else None) for name in cameras]
    return [_labels_of(form, each) for each in found if not each.is_folder]


def _labels_of(form: LabelFormat, files: ExportFiles) -> Path:
    """Labels of one camera, in the folder of its frames or next to its file.

    COCO has one file, KITTI a folder with label_2, calib and instance_2.
    """
    if files.is_folder:
        return files.path / "labels.coco.json" if form == "coco" else files.path
    return files.path.with_name(f"{files.path.stem}.{'coco.json' if form == 'coco' else 'kitti'}")


def _names(files: ExportFiles, twin: ExportFiles | None, number: int) -> dict[str, str]:
    names = {"file_name": _name(files, number)}
    if twin is not None:
        name = _name(twin, number)
        names["clear_file_name"] = f"../{twin.path.name}/{name}" if twin.is_folder else name
    if "depth" in files.passes and files.format != "exr":
        depth = files.pass_file(number, "depth")
        names["depth_file_name"] = f"{depth.parent.name}/{depth.name}" if files.is_video else depth.name
    return names


def _name(files: ExportFiles, number: int) -> str:
    """Name of a frame's file; for videos the video's name and the frame number."""
    return f"{files.path.name}/{number:06d}" if files.is_video else files.color(number).name


def _write_kitti(files: ExportFiles, number: int, sequence: FrameSequence, objects: Sequence[VisibleObject]) -> None:
    folder, camera = _labels_of("kitti", files), sequence.shot(number).camera
    lines = "".join(f"{label_line(each)}\n" for each in objects)  # nearest object first
    for kind, text in (("label_2", lines), ("calib", calibration_file(camera))):
        file = folder / kind / f"{number:06d}.txt"
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as partial:
            partial.write_text(text, encoding="ascii")
    (folder / "instance_2").mkdir(parents=True, exist_ok=True)
    write_labels(folder / "instance_2" / f"{number:06d}.png", instances(objects, camera), 256)


# COCO masks
# Run lengths by column (maskApi.c of the COCO API, Lin and Dollar, 2015). Strings hold five bits per
# character, starting at "0", and from the third run on the difference to the run before the last.


def run_lengths(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    """Lengths of the runs of equal pixels, column by column; the first run is of False pixels and may be 0."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    changes = np.flatnonzero(flat[1:] != flat[:-1])
    edges = np.concatenate([[0], changes[changes < mask.size], [mask.size]])
    return np.diff(edges).tolist()


def encode_rle(mask: Bool[np.ndarray, "h w"]) -> dict[str, Any]:
    """Return a mask in COCO's compressed format: "size" (height, width), and "counts", its runs as a string."""
    runs = run_lengths(mask)
    text = "".join(_characters(run - (runs[k - 2] if k > 2 else 0)) for k, run in enumerate(runs))
    return {"size": list(mask.shape), "counts": text}


def _characters(value: int) -> str:
    text = ""
    while True:
        bits, value = value & 0x1F, value >> 5
        more = value != (-1 if bits & 0x10 else 0)
        text += chr((bits | (0x20 if more else 0)) + ord("0"))
        if not more:
            return text
