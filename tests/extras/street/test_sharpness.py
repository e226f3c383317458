"""Factors on the colors of the built-in streets: files, the streets that they belong to, and how they are found."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from benchmarks.sharpen_street import GAIN, PictureProblem, find_factors, with_edges
from benchmarks.street_sharpness import ego_views, gradient_energy, mesh_picture
from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.simulation import OVERCAST
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.open import load_built_in
from gsrain_extras.street.build import LEAD_ID, quads_to_gaussians
from gsrain_extras.street.ground_truth import StreetViews
from gsrain_extras.street.layout import STREETS
from gsrain_extras.street.mesh import Quads
from gsrain_extras.street.sharpness import STEPS, color_factors, sharpened, sharpness_file, write_color_factors
from small_scene import small_scene

from .built_street import WHOLE, surfaces_of


@pytest.mark.parametrize("name", ["street", "street:dusk"])
def test_factors_are_those_of_the_streets_gaussians(name: str) -> None:
    surfaces = surfaces_of(STREETS[name])
    factors = color_factors(STREETS[name])
    sizes = {**{key: len(quads) for key, quads in surfaces.layers.items()}, LEAD_ID: len(surfaces.lead)}
    assert {key: len(each) for key, each in factors.items()} == sizes
    assert all(each.min() >= 0.25 and each.max() <= 2 for each in factors.values())
    assert np.std(factors["houses"]) > 0.01


def test_light_does_not_change_factors_but_geometry_does() -> None:
    street = sharpness_file(STREETS["street"])
    assert street == sharpness_file(STREETS["street:night"]) == sharpness_file(STREETS["street:overcast"])
    assert sharpness_file(STREETS["street:dusk"]) not in (None, street)
    assert sharpness_file(STREETS["street:long"]) is None
    assert not color_factors(structs.replace(WHOLE, seed=8))


def test_written_factors_are_read_to_a_step(tmp_path, monkeypatch) -> None:
    factors = {"road": np.linspace(0.2, 5, 1000), "houses": np.ones(3)}
    file = tmp_path / "a.npz"
    write_color_factors(file, factors)
    monkeypatch.setattr("gsrain_extras.street.sharpness.sharpness_file", lambda _: file)
    found = color_factors(WHOLE)
    assert np.abs(np.log2(found["road"] / np.clip(factors["road"], 0.25, 2))).max() < 0.501 / STEPS
    assert np.array_equal(found["houses"], np.ones(3))


def test_colors_are_multiplied_and_what_changes_with_direction_stays() -> None:
    sh = np.random.default_rng(2).normal(size=(5, 4, 3)).astype(np.float32)
    factors = np.array([0.5, 1, 1.5, 2, 4], np.float32)
    sharp = sharpened(sh, factors)
    np.testing.assert_allclose(SH_C0 * sharp[:, 0] + 0.5, factors[:, None] * (SH_C0 * sh[:, 0] + 0.5), atol=1e-6)
    assert np.array_equal(sharp[:, 1:], sh[:, 1:])
    assert np.array_equal(sharpened(sh, None), sh)
    assert np.array_equal(sharpened(sh, factors[:4]), sh)  # of other Gaussians


def test_pictures_and_their_transpose_agree() -> None:
    scene = small_scene()
    pose = look_at(np.array([0.0, 0, 1.5]), np.array([20.0, 0, 1.5]), np.array([0, 0, 1.0]))
    view, shape = RenderView(Camera.from_fov(120, 80, 60.0, pose), 0.0), (80, 120, 3)
    problem = PictureProblem(scene, [view], [np.zeros(shape, np.float32)], [1.0])
    rng = np.random.default_rng(5)
    factors = rng.normal(size=(len(problem.colors), 1)).astype(np.float32)
    picture = rng.normal(size=shape).astype(np.float32)
    (drawn,) = problem.pictures(factors)
    assert np.abs(drawn).max() > 0.1
    assert np.vdot(drawn, picture) == pytest.approx(np.vdot(factors, problem.gathered([picture])), rel=1e-3)
    edges, transposed = (
        np.vdot(each.astype(float), other)
        for each, other in ((with_edges(drawn), picture), (drawn, with_edges(picture)))
    )
    assert edges == pytest.approx(transposed, rel=1e-4)
    problem.missing = [0.2 * drawn]
    change = find_factors(problem)[:, None] - 1
    assert np.linalg.norm(0.2 * drawn - problem.pictures(change / np.float32(GAIN))[0]) < 0.2 * np.linalg.norm(
        0.2 * drawn
    )


def around_picture(quads: Quads, camera: Camera) -> Quads:
    """Take those in front of a camera that can reach into its picture."""
    turned = camera.world_to_camera
    x, y, z = (quads.centers @ turned[:3, :3].T + turned[:3, 3]).T
    depth, margin_m = np.maximum(z, 0.5), 1.5
    beside = np.abs(x) - camera.width / 2 / camera.fx * depth, np.abs(y) - camera.height / 2 / camera.fy * depth
    return quads.take((z > 0.5) & (beside[0] < margin_m + 0.1 * depth) & (beside[1] < margin_m + 0.1 * depth))


def test_pictures_are_as_sharp_as_those_of_the_mesh() -> None:
    """The middle of a picture from the ego's camera, at a moment that is not among those of the fit.

    Of the mesh, and of the Gaussians without factors, only what lies in it is lit.
    """
    sharp = load_built_in()
    view = ego_views(sharp, 960, 4)[2]
    camera = replace(view.camera, width=480, height=320, cx=view.camera.cx - 240, cy=view.camera.cy - 160)
    view, whole = replace(view, camera=camera), surfaces_of(WHOLE)
    layers = {name: quads if name == "sky" else around_picture(quads, camera) for name, quads in whole.layers.items()}
    surfaces, soft = replace(whole, layers=layers), sharp
    for name, quads in layers.items():
        gaussians = quads_to_gaussians(quads, surfaces.light())
        soft = soft.with_member(f"layers/{name}", gaussians=gaussians, wet_sh=None)
    mesh = mesh_picture(StreetViews(surfaces), view)
    energies, errors = {}, {}
    with open_renderer("cpu") as renderer:
        for scene in (sharp, soft):
            draw(renderer, FrameInput.of(scene, None, OVERCAST, view))
            drawn = renderer.read_uint8().astype(np.float32) / 255
            energies[scene is sharp] = gradient_energy(drawn) / gradient_energy(mesh)
            errors[scene is sharp] = np.mean((drawn - mesh) ** 2)
    assert errors[True] < 0.8 * errors[False]
    assert energies[False] < 0.8 < energies[True] < 1.05
