"""Sharpness of the built-in street: its Gaussians against photographs of its own mesh, from the ego's cameras.

    python -m benchmarks.street_sharpness [--pictures DIR]

The mesh is drawn with 4 x 4 samples per pixel. PSNR compares colors; gradient energy is the sum of squared differences
of neighboring pixels, of the Gaussians over that of the mesh.
"""

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32

from gsrain_engine.backends import open_renderer
from gsrain_engine.datasets.geometry import scaled_camera
from gsrain_engine.rain.simulation import OVERCAST
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene
from gsrain_extras.street.build import scene_of, street_surfaces
from gsrain_extras.street.ground_truth import StreetViews

_SAMPLES = 4


def ego_views(scene: Scene, width: int, count: int) -> list[RenderView]:
    """Front camera of the rig, scaled to a width, at even times of the drive."""
    front = scene.rigs["waymo_front3"][0]
    assert scene.ego is not None
    moments = np.linspace(scene.ego.times[0], scene.ego.times[-1], count + 2)[1:-1]
    height = round(width * front.height / front.width)
    cameras = ((float(t), rig_camera(scene, "waymo_front3", front.name, float(t))) for t in moments)
    return [RenderView(scaled_camera(camera, width, height), t) for t, camera in cameras]


def gradient_energy(image: Float32[np.ndarray, "h w 3"]) -> float:
    """Sum of squared differences of neighboring pixels."""
    return float(np.sum(np.diff(image, axis=0) ** 2) + np.sum(np.diff(image, axis=1) ** 2))


def mesh_picture(views: StreetViews, view: RenderView) -> Float32[np.ndarray, "h w 3"]:
    """Photograph of the mesh with 4 x 4 samples per pixel."""
    camera = view.camera
    fine = scaled_camera(camera, _SAMPLES * camera.width, _SAMPLES * camera.height)
    picture = views.view(fine, view.time_s, "").image
    return cv2.resize(picture.astype(np.float32) / 255, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--count", type=int, default=4, help="moments of the drive")
    parser.add_argument("--pictures", type=Path, help="folder for mesh and Gaussians beside each other")
    arguments = parser.parse_args()
    surfaces = street_surfaces()
    scene, views = scene_of(surfaces), StreetViews(surfaces)
    rows: list[dict[str, float]] = []
    with open_renderer("cpu") as renderer:
        for k, view in enumerate(ego_views(scene, arguments.width, arguments.count)):
            mesh = mesh_picture(views, view)
            draw(renderer, FrameInput.of(scene, None, OVERCAST, view))
            drawn = renderer.read_uint8().astype(np.float32) / 255
            error = float(np.mean((drawn - mesh) ** 2))
            rows.append(
                {
                    "time_s": view.time_s,
                    "psnr_db": -10 * np.log10(error),
                    "gradient_energy": gradient_energy(drawn) / gradient_energy(mesh),
                }
            )
            if arguments.pictures:
                arguments.pictures.mkdir(parents=True, exist_ok=True)
                both = np.concatenate([mesh, drawn], axis=1)[..., ::-1]
                cv2.imwrite(str(arguments.pictures / f"{k}.png"), np.round(255 * both).astype(np.uint8))
    json.dump({"gaussians": scene.gaussian_count, "width": arguments.width, "rows": rows}, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
