"""`gsrain street DIR`: the built-in street as files."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from gsrain_engine.datasets.capture import View
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.open_scene import cached_street
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene

from ..console import print
from .arguments import JsonFile, write_numbers
from .outputs import check_scene_folder, check_writable, hold
from .progress import progress_bar


def street(
    directory: Annotated[Path, Parameter(help="Folder to write: DIR/scene is a scene folder, DIR/images a capture.")],
    /,
    *,
    rig: Annotated[str, Parameter(help="Cameras to photograph the street with: waymo_front3 or nuscenes.")] = (
        "waymo_front3"
    ),
    moments: Annotated[int, Parameter(help="How many moments of the drive to photograph; 0 for none.")] = 4,
    width: Annotated[int, Parameter(help="Width of the images in pixels.")] = 960,
    json: JsonFile = None,
) -> None:
    """Write the built-in street: Gaussians, tracks, rigs, and true images with depth, normals and labels."""
    if not 0 <= moments <= 1000:
        raise ValueError(f"--moments {moments}: must be within 0..1000")
    if not 16 <= width <= 4096:
        raise ValueError(f"--width {width}: must be within 16..4096")
    check_scene_folder(directory / "scene")
    check_writable(json, folders=[directory, directory / "images"])
    scene = cached_street()
    if rig not in scene.rigs:
        raise ValueError(f"--rig {rig}: the street has {', '.join(scene.rigs)}")
    hold(directory)
    write_scene(scene, directory / "scene")
    print(f"{directory / 'scene'}: {scene.gaussian_count:,} Gaussians, rigs {', '.join(scene.rigs)}")
    if moments:
        with progress_bar("Photographing", moments * len(scene.rigs[rig]), draws=True) as advance:
            for _ in write_views(directory / "images", _photographs(scene, rig, moments, width)):
                advance()
        print(f"{directory / 'images'}: {moments * len(scene.rigs[rig])} views with depth, normals and labels")
    write_numbers(json, {"gaussians": scene.gaussian_count, "views": moments * len(scene.rigs[rig])})


def _photographs(scene: Scene, rig: str, moments: int, width: int) -> Iterator[View]:
    """Photograph the mesh with every camera of a rig, at moments spread over the drive."""
    from gsrain_engine.datasets.street.views import StreetViews  # pyrender and OpenGL load only here
    from gsrain_engine.scene.street.build import street_surfaces

    assert scene.ego is not None
    photographer = StreetViews(street_surfaces())
    for time_s in np.linspace(scene.ego.times[0], scene.ego.times[-1], moments).tolist():
        for mounted in scene.rigs[rig]:
            camera = rig_camera(scene, rig, mounted.name, time_s)
            camera = camera.resized(width, round(width * camera.height / camera.width))
            view = photographer.view(camera, time_s, f"{mounted.name}_{time_s:07.3f}s")
            yield replace(view, sensor=mounted.name)
