"""Write the built-in street as a scene, and as images with depth, normals and labels."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np

from app.console import print, progress_bar
from app.options import JsonFile, check_within, option
from app.outputs import check_scene_folder, check_writable, lock_outputs, write_numbers
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.optional_packages import require_package
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.open import load_built_in
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene

from .build import street_surfaces


def street(
    directory: Annotated[Path, option("Folder to write: DIR/scene is a scene folder, DIR/images a capture.")],
    /,
    *,
    rig: Annotated[str, option("Camera rig that photographs the street: waymo_front3 or nuscenes.")] = "waymo_front3",
    moments: Annotated[int, option("Number of moments of the drive to photograph; 0 for none.")] = 4,
    width: Annotated[int, option("Width of the images in pixels.")] = 960,
    json: JsonFile = None,
) -> None:
    """Write the built-in street: Gaussians, tracks, rigs, and true images with depth, normals and labels."""
    check_within("--moments", moments, 0, 1000)
    check_within("--width", width, 16, 4096)
    if moments and sys.platform != "linux":
        raise ValueError(f"--moments {moments}: images need EGL, which Linux has; --moments 0 needs none")
    if moments:
        require_package("pyrender", f"--moments {moments}")
    check_scene_folder(directory / "scene")
    check_writable(json, folders=[directory, directory / "images"])
    scene = load_built_in()
    if rig not in scene.rigs:
        raise ValueError(f"--rig {rig}: the street has {', '.join(scene.rigs)}")
    lock_outputs(directory)
    write_scene(scene, directory / "scene")
    print(f"{directory / 'scene'}: {scene.gaussian_count:,} Gaussians, rigs {', '.join(scene.rigs)}")
    views = moments * len(scene.rigs[rig])
    if views:
        with progress_bar("Photographing", views) as advance:
            for _ in write_views(directory / "images", _photographs(scene, rig, moments, width)):
                advance()
        print(f"{directory / 'images'}: {views} views with depth, normals and labels")
    write_numbers(json, {"gaussians": scene.gaussian_count, "views": views})


def _photographs(scene: Scene, rig: str, moments: int, width: int) -> Iterator[CaptureFrame]:
    """Render the mesh with every camera of a rig, at times spread over the drive."""
    from .ground_truth import StreetViews  # loads pyrender and OpenGL only here

    assert scene.ego is not None
    photographer = StreetViews(street_surfaces())
    for time_s in np.linspace(scene.ego.times[0], scene.ego.times[-1], moments).tolist():
        for mounted in scene.rigs[rig]:
            camera = rig_camera(scene, rig, mounted.name, time_s)
            camera = camera.resized(width, round(width * camera.height / camera.width))
            view = photographer.view(camera, time_s, f"{mounted.name}_{time_s:07.3f}s")
            yield replace(view, sensor=mounted.name)
