"""Writes label files beside recorded frames: COCO's one file a camera, or KITTI's two texts a frame."""

import json
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.objects import scene_objects
from gsrain_engine.scene.progress import Progress

from ..pictures import write_labels
from ..recorded_files import RecordedFiles, recorded_files
from ..recording import Recording
from ..renderer import Renderer
from ..sequence import FrameSequence
from .coco_labels import CocoLabels
from .kitti_labels import calibration_file, instances, label_file
from .label_format import LabelFormat
from .seen_objects import SeenObject, seen_objects


def write_object_labels(
    renderer: Renderer,
    form: LabelFormat,
    recording: Recording,
    sequences: Mapping[str, FrameSequence],
    numbers: Sequence[int],
) -> Generator[Progress, None, list[Path]]:
    """Label the frames of a recording by their numbers; returns which files and folders were written.

    Rain takes no part, so that the clear twin has the same labels. Raises OSError where they can't be written, and
    ValueError for a scene in which nothing has a class and a box.
    """
    written: list[Path] = []
    for place, (name, sequence) in enumerate(sequences.items()):
        objects = scene_objects(sequence.scene)
        if not objects:
            raise ValueError(f"scene {sequence.scene.name!r} has no actors that labels could be about")
        camera_name = name if len(sequences) > 1 else None
        files = recorded_files(recording, camera_name)
        twin = recorded_files(recording, camera_name, is_clear=True) if recording.twin else None
        coco = CocoLabels(sequence.scene.name)
        for done, number in enumerate(numbers):
            shot = sequence.shot(number)
            seen = seen_objects(renderer, sequence.scene, objects, shot.camera, shot.time_s)
            if form == "coco":
                coco.add(number, shot.time_s, shot.camera, seen, **_names(files, twin, number))
            else:
                _write_kitti(files, number, sequence, seen)
            yield Progress((place + (done + 1) / len(numbers)) / len(sequences), f"Labels of frame {number}")
        if form == "coco":
            with whole_file(coco_file(files)) as beside:
                beside.write_text(json.dumps(coco.document) + "\n", encoding="utf-8")
        written.append(coco_file(files) if form == "coco" else kitti_folder(files))
    return written


def label_outputs(form: LabelFormat, recording: Recording, cameras: Sequence[str]) -> list[Path]:
    """Every file and folder that the labels of these cameras go to, but for those in folders of frames."""
    found = [recorded_files(recording, name if len(cameras) > 1 else None) for name in cameras]
    return [coco_file(each) if form == "coco" else kitti_folder(each) for each in found if not each.is_folder]


def coco_file(files: RecordedFiles) -> Path:
    """Where the labels of one camera go: into the folder of its frames, else beside its file."""
    return files.path / "labels.coco.json" if files.is_folder else files.path.with_name(f"{files.path.stem}.coco.json")


def kitti_folder(files: RecordedFiles) -> Path:
    """The folder that has label_2, calib and instance_2: that of the frames, else one beside their file."""
    return files.path if files.is_folder else files.path.with_name(f"{files.path.stem}.kitti")


def _names(files: RecordedFiles, twin: RecordedFiles | None, number: int) -> dict[str, str]:
    names = {"file_name": _name(files, number)}
    if twin is not None:
        name = _name(twin, number)
        names["clear_file_name"] = f"../{twin.path.name}/{name}" if twin.is_folder else name
    if "depth" in files.passes and files.format != "exr":
        depth = files.beside(number, "depth")
        names["depth_file_name"] = f"{depth.parent.name}/{depth.name}" if files.is_video else depth.name
    return names


def _name(files: RecordedFiles, number: int) -> str:
    """Name of a frame's file; that of a frame in a video is the video's with its number."""
    return f"{files.path.name}/{number:06d}" if files.is_video else files.color(number).name


def _write_kitti(files: RecordedFiles, number: int, sequence: FrameSequence, seen: Sequence[SeenObject]) -> None:
    folder, camera = kitti_folder(files), sequence.shot(number).camera
    for kind, text in (("label_2", label_file(seen)), ("calib", calibration_file(camera))):
        file = folder / kind / f"{number:06d}.txt"
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as beside:
            beside.write_text(text, encoding="ascii")
    (folder / "instance_2").mkdir(parents=True, exist_ok=True)
    write_labels(folder / "instance_2" / f"{number:06d}.png", instances(seen, camera), 256)
