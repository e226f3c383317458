"""Camera paths for other programs: nerfstudio's `camera_path.json` and the `cameras.json` of 3DGS, frame by frame."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.camera import Camera

from .camera_path import CameraPath
from .edits import key_camera

_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def frame_times(camera_path: CameraPath, fps: float) -> Float64[np.ndarray, " n"]:
    """Moments of a path's frames; of a loop, without the last one, which is the first again."""
    count = max(1, round(camera_path.duration_s * fps) + (0 if camera_path.loop else 1))
    return camera_path.start_s + np.arange(count) / fps


def write_nerfstudio_path(
    path: Path | str, camera_path: CameraPath, fps: float, width: int = 1920, height: int = 1080
) -> None:
    """Write a path for nerfstudio: every frame, which `ns-render camera-path` reads, and the keys for its viewer."""
    times = frame_times(camera_path, fps)
    keys = [key_camera(camera_path, key, width, height) for key in range(len(camera_path.times_s))]
    gaps = np.diff(camera_path.times_s, append=camera_path.end_s).tolist()
    values = {
        "camera_type": "perspective",
        "render_height": height,
        "render_width": width,
        "fps": fps,
        "seconds": float(times[-1] - times[0]),
        "is_cycle": camera_path.loop,
        "default_fov": float(camera_path.vertical_fov_deg[0]),
        "default_transition_sec": float(np.mean(gaps)),
        "keyframes": [
            {
                "matrix": _opengl_pose(key),
                "fov": key.vertical_fov_deg,
                "aspect": width / height,
                "override_transition_enabled": True,
                "override_transition_sec": gap,
            }
            for key, gap in zip(keys, gaps, strict=True)
        ],
        "camera_path": [
            {"camera_to_world": _opengl_pose(camera), "fov": camera.vertical_fov_deg, "aspect": width / height}
            for camera in (camera_path.camera(t, width, height) for t in times.tolist())
        ],
    }
    _write(path, values)


def write_training_cameras(
    path: Path | str, camera_path: CameraPath, fps: float, width: int = 1920, height: int = 1080
) -> None:
    """Write every frame of a path as a camera of 3DGS (its `cameras.json`), which knows no times."""
    values: list[dict[str, Any]] = []
    for number, t in enumerate(frame_times(camera_path, fps).tolist()):
        camera = camera_path.camera(t, width, height)
        pose = camera.camera_to_world
        values.append(
            {
                "id": number,
                "img_name": f"{number:05d}",
                "width": width,
                "height": height,
                "position": pose[:3, 3].tolist(),
                "rotation": pose[:3, :3].tolist(),
                "fy": camera.fy,
                "fx": camera.fx,
            }
        )
    _write(path, values)


def _opengl_pose(camera: Camera) -> list[float]:
    """Camera to world, row by row, for a camera with y up and z backward."""
    return (camera.camera_to_world @ _TO_OPENGL).ravel().tolist()


def _write(path: Path | str, values: Any) -> None:
    with whole_file(Path(path)) as beside:
        beside.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
