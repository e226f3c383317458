"""Does a clip of a sweep: pictures, labels, and the row that says what they show."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from msgspec import structs

from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.render.objects.label_files import write_object_labels
from gsrain_engine.render.record import record
from gsrain_engine.render.recorded_views import frame_numbers, sequences_of
from gsrain_engine.scene.atomic_files import whole_folder
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.content_hash import file_hash
from gsrain_engine.scene.drive_path import drive_path
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from .job import RenderJob
from .outcome import Outcome, Value
from .workbench import Workbench


def do_render(job: RenderJob, bench: Workbench, clips: Path) -> Outcome:
    """Record into a folder of the job's id, which appears whole; one that stands is an equal one and stays.

    Raises ValueError for what contradicts itself or the scene lacks, OSError where it can't be written.
    """
    scene = bench.scene(job.scene, job.scene_hash)
    place = clips / job.id
    values = _values(job, scene)
    clips.mkdir(parents=True, exist_ok=True)
    if not place.is_dir():
        try:
            with whole_folder(place, shared=True) as beside:
                _record(job, scene, bench, beside)
        except OSError:
            if not place.is_dir():  # else another sweep has put the same clip there meanwhile
                raise
    return Outcome(id=job.id, values={**values, "clip": f"{clips.name}/{job.id}", "clip_hash": _hash(place)})


def _record(job: RenderJob, scene: Scene, bench: Workbench, folder: Path) -> None:
    recording = structs.replace(job.recording, output=str(folder / job.recording.output))
    rainfall = Rainfall.start(job.rain)
    sequences = sequences_of(recording, scene, rainfall, _viewpoint(job, scene), in_scene_time=True)
    numbers = frame_numbers(recording, sequences)
    renderer = bench.renderer(job.backend)
    for _ in record(renderer, recording, sequences, numbers):
        pass
    if job.labels is not None:
        for _ in write_object_labels(renderer, job.labels, recording, sequences, numbers):
            pass


def _values(job: RenderJob, scene: Scene) -> dict[str, Value]:
    """What can be said about it without its pictures."""
    sequences = sequences_of(job.recording, scene, Rainfall.start(job.rain), _viewpoint(job, scene), in_scene_time=True)
    state = Rainfall.start(job.rain).state_at(job.recording.first_s)
    sizes = {f"{each.width}x{each.height}" for each in sequences.values()}
    return {
        "cameras": len(sequences),
        "frames": len(frame_numbers(job.recording, sequences)),
        "sizes_px": ", ".join(sorted(sizes)),
        "implied_mm_h": float(state.implied_mm_h),
        "drops": int(state.drops),
    }


def _viewpoint(job: RenderJob, scene: Scene) -> Camera | CameraPath:
    """The path that was made for the scene, else that of the camera which looks most straight ahead."""
    if scene.path is not None:
        return scene.path.moved(scene.scene_to_world)
    mounted = [camera for rig in scene.rigs.values() for camera in rig]
    if not mounted or scene.ego is None:
        raise ValueError(f"scene {scene.name!r} has neither a camera path nor an ego vehicle with cameras")
    front = max(mounted, key=lambda each: each.camera_to_ego[0, 2])
    return drive_path(scene, front, *(job.recording.size_px or (front.width, front.height)))


def _hash(folder: Path) -> str:
    found = hashlib.sha256()
    files: Sequence[Path] = sorted(each for each in folder.rglob("*") if each.is_file())
    for file in files:
        found.update(f"{file.relative_to(folder).as_posix()}\0{file_hash(file)}\n".encode())
    return found.hexdigest()[:16]
