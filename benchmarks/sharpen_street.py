"""Find the factors on the colors of a built-in street with which its pictures are as sharp as those of its mesh.

    python -m benchmarks.sharpen_street street street:dusk

Writes the files that `gsrain_extras.street.sharpness` reads; takes about 15 minutes a street on two cores, 4 GB
and EGL. The factors minimize squared errors of pictures against photographs of the mesh, in display colors and, with
more weight, in differences of neighboring pixels, by conjugate gradients. Edges, which are still softer than those of
the mesh then, get `GAIN` times that.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int64
from scipy.sparse import diags_array
from scipy.sparse.linalg import LinearOperator, cg

from benchmarks.street_sharpness import ego_views, mesh_picture
from gsrain_engine.backends import open_renderer
from gsrain_engine.datasets.geometry import scaled_camera
from gsrain_engine.rain.simulation import OVERCAST
from gsrain_engine.render.cpu.compositing import ColorOperator, color_operator
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.geometry import rotation_about_z
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene
from gsrain_extras.street.build import LEAD_ID, scene_of, street_surfaces
from gsrain_extras.street.ground_truth import StreetViews
from gsrain_extras.street.layout import STREETS
from gsrain_extras.street.sharpness import sharpness_file, write_color_factors

GAIN = 1.6
FRONT_VIEWS, OTHER_TIMES, FREE_VIEWS = 23, 12, 24
OTHER_WEIGHT = 0.5  # of a picture to the sides or back, or from beside the drive
_FREE_Y_M, _FREE_Z_M, _FREE_YAW_DEG = (-2.5, 5.0), (0.0, 4.0), (-40.0, 40.0)  # from the front camera
EDGE_WEIGHT = 3.0  # of differences between neighboring pixels
PRIOR = 1.0  # weight of no change, in pixels
ITERATIONS = 12
_DARKEST = 0.02  # display color that a factor changes

Pictures = list[Float32[np.ndarray, "h w 3"]]
Factors = Float32[np.ndarray, "n 1"]


def fit_views(scene: Scene) -> list[RenderView]:
    """Views of the front camera first, then of all other cameras of both rigs, and from places beside the drive."""
    views = ego_views(scene, 960, FRONT_VIEWS)
    assert scene.ego is not None
    for time_s in np.linspace(scene.ego.times[0], scene.ego.times[-1], OTHER_TIMES + 2)[1:-1]:
        for rig, cameras in scene.rigs.items():
            for each in cameras[rig == "waymo_front3" :]:
                views.append(_view(rig_camera(scene, rig, each.name, float(time_s)), float(time_s)))
    rng = np.random.default_rng(0)
    for time_s in np.linspace(scene.ego.times[0], scene.ego.times[-1], FREE_VIEWS + 2)[1:-1]:
        moved = np.eye(4)
        moved[:3, :3] = rotation_about_z(rng.uniform(*_FREE_YAW_DEG))
        camera = rig_camera(scene, "waymo_front3", "FRONT", float(time_s))
        pose = moved @ camera.camera_to_world
        pose[:3, 3] = camera.position + np.array([0.0, rng.uniform(*_FREE_Y_M), rng.uniform(*_FREE_Z_M)])
        views.append(_view(camera.moved(pose @ camera.world_to_camera), float(time_s)))
    return views


def _view(camera: Camera, time_s: float) -> RenderView:
    return RenderView(scaled_camera(camera, 800, round(800 * camera.height / camera.width)), time_s)


class PictureProblem:
    """Pictures of a scene as linear functions of its colors, and what they lack of those of the mesh."""

    def __init__(self, scene: Scene, views: Sequence[RenderView], targets: Pictures, weights: Sequence[float]) -> None:
        sizes = [len(member.gaussians) for member in scene.members]
        self.ends = np.cumsum([0, *sizes])
        every = np.concatenate([member.gaussians.sh[:, 0] for member in scene.members])
        self.colors = np.clip(every * SH_C0 + 0.5, _DARKEST, 1.5).astype(np.float32)
        self.operators: list[tuple[ColorOperator, Int64[np.ndarray, " m"]]] = []
        self.missing: Pictures = []
        with open_renderer("cpu") as renderer:
            for view, target in zip(views, targets, strict=True):
                draw(renderer, FrameInput.of(scene, None, OVERCAST, view))
                self.missing.append(target - renderer.read_uint8().astype(np.float32) / 255)
                self.operators.append(self._operator(scene, view))
        self.weights = weights

    def _operator(self, scene: Scene, view: RenderView) -> tuple[ColorOperator, Int64[np.ndarray, " m"]]:
        placed = [(k, scene.part(member, view.time_s)) for k, member in enumerate(scene.members)]
        rows = [np.arange(self.ends[k], self.ends[k + 1]) for k, item in placed if item is not None]
        operator = color_operator([item for _, item in placed if item is not None], view.camera)
        return operator, np.concatenate(rows)[operator.splats.indices]

    def pictures(self, factors: Factors) -> Pictures:
        change = self.colors * factors
        return [operator.blend(change[rows]) for operator, rows in self.operators]

    def gathered(self, pictures: Pictures) -> Factors:
        """Transpose of `pictures` with their weights."""
        sums = np.zeros_like(self.colors)
        for (operator, rows), picture, weight in zip(self.operators, pictures, self.weights, strict=True):
            sums[rows] += np.float32(weight) * operator.accumulate(picture)
        return (self.colors * sums).sum(axis=1, keepdims=True)

    def squares(self) -> Float32[np.ndarray, "n 1"]:
        sums = np.zeros((len(self.colors), 1), np.float32)
        for (operator, rows), weight in zip(self.operators, self.weights, strict=True):
            sums[rows, 0] += np.float32(weight) * operator.squared_sums()
        return sums


def with_edges(picture: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """The picture plus, by weight, the transpose of its differences applied to these."""
    total = picture.copy()
    down, across = (np.float32(EDGE_WEIGHT) * np.diff(picture, axis=axis) for axis in (0, 1))
    total[1:] += down
    total[:-1] -= down
    total[:, 1:] += across
    total[:, :-1] -= across
    return total


def find_factors(problem: PictureProblem) -> Float32[np.ndarray, " n"]:
    """Factors of all Gaussians of the scene's members."""

    def applied(factors: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        edges = [with_edges(each) for each in problem.pictures(factors[:, None].astype(np.float32))]
        return problem.gathered(edges)[:, 0] + np.float32(PRIOR) * energy * factors

    energy = (problem.colors**2).sum(axis=1)
    right = problem.gathered([with_edges(each) for each in problem.missing])[:, 0]
    diagonal = energy * (np.float32(1 + 3 * EDGE_WEIGHT) * problem.squares()[:, 0] + np.float32(PRIOR))
    system: Any = LinearOperator((len(right), len(right)), applied)
    change, _ = cg(system, right, rtol=0, maxiter=ITERATIONS, M=diags_array(1 / diagonal))
    return (1 + GAIN * change).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("streets", nargs="+", choices=[name for name, each in STREETS.items() if sharpness_file(each)])
    for name in parser.parse_args().streets:
        surfaces = street_surfaces(STREETS[name])
        scene = replace(scene_of(surfaces, sharp=False), lamps=())  # the mesh has no light of vehicles
        mesh = StreetViews(surfaces)
        views = fit_views(scene)
        weights = [1.0] * FRONT_VIEWS + [OTHER_WEIGHT] * (len(views) - FRONT_VIEWS)
        problem = PictureProblem(scene, views, [mesh_picture(mesh, view) for view in views], weights)
        factors = np.split(find_factors(problem), problem.ends[1:-1])
        keys = [*surfaces.layers, LEAD_ID]
        file = sharpness_file(STREETS[name])
        assert file is not None and len(keys) == len(factors)
        write_color_factors(file, dict(zip(keys, factors, strict=True)))
        print(f"{file}: {file.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
