import hashlib
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.render.cpu.projection import project
from gsrain_engine.scene.camera import read_camera
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import DrawItem
from oracles.rasterizer import rasterize_slowly, sh_basis_slowly
from rasterized import rasterize

from .raster_scenes import random_gaussians, small_camera

HERE = np.eye(4)
FIELDS = ("means", "scales", "quaternions", "opacities", "sh")


def similarity(scale: float, seed: int) -> np.ndarray:
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation * np.sign(np.linalg.det(rotation))
    return matrix


def moved(gaussians: Gaussians, to_world: np.ndarray) -> DrawItem:
    """Put Gaussians elsewhere in their own frame so that `to_world` brings their means back."""
    rotation = to_world[:3, :3]
    means = np.linalg.solve(rotation, gaussians.means.T - to_world[:3, 3:]).T.astype(np.float32)
    return DrawItem(
        Gaussians(means, gaussians.scales, gaussians.quaternions, gaussians.opacities, gaussians.sh), to_world
    )


def assert_like_the_reference(parts, camera, rain=None) -> None:
    frame = rasterize(parts, camera, rain)
    slow = rasterize_slowly(parts, camera, rain)
    difference = np.abs(frame.rgba - slow[..., :4]).max(axis=-1)
    # A fragment at a cut may fall on either side of it in float32: rarely, and by no more than the cut.
    assert difference.max() < 6e-3
    assert (difference > 1e-4).mean() < 0.005
    solid = slow[..., 3] > 0.05
    expected = slow[solid, 4] / slow[solid, 3]
    error = np.abs(frame.depth[solid] - expected) / expected
    assert np.quantile(error, 0.99) < 1e-3
    assert (frame.depth[slow[..., 3] == 0] == 0).all()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_agrees_with_the_reference_at_every_sh_degree(degree):
    assert_like_the_reference([DrawItem(random_gaussians(150, degree, degree), HERE)], small_camera())


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_the_reference_where_parts_are_turned_and_scaled(seed):
    parts = [DrawItem(random_gaussians(60, seed, 1), HERE)]
    parts += [moved(random_gaussians(60, 10 + seed, 3), similarity(0.5 + seed, seed))]
    assert_like_the_reference(parts, small_camera())


def test_agrees_with_the_reference_where_pixels_finish_early():
    gaussians = random_gaussians(400, 3)
    gaussians = Gaussians(
        gaussians.means, 4 * gaussians.scales, gaussians.quaternions, np.full(400, 0.97, np.float32), gaussians.sh
    )
    frame = rasterize([DrawItem(gaussians, HERE)], small_camera())
    assert (1 - frame.rgba[..., 3] < 2e-3).mean() > 0.8  # it does finish
    assert_like_the_reference([DrawItem(gaussians, HERE)], small_camera())


def test_rain_is_cut_later_and_keeps_its_integral():
    gaussians = random_gaussians(60, 4)
    scales = (gaussians.scales * 0.02).astype(np.float32)
    faint = Gaussians(gaussians.means, scales, gaussians.quaternions, gaussians.opacities * 0.02, gaussians.sh)
    parts = [DrawItem(random_gaussians(40, 2), HERE), DrawItem(faint, HERE)]
    rain = [None, np.arange(60) % 3 > 0]
    assert_like_the_reference(parts, small_camera(), rain)
    alone = rasterize(parts[1:], small_camera(), [np.ones(60, bool)]).rgba[..., 3]
    slow = rasterize_slowly(parts[1:], small_camera(), [np.ones(60, bool)])[..., 3]
    np.testing.assert_allclose(alone, slow, rtol=1e-3, atol=2e-5)
    assert 0 < alone.max() < 1 / 255


def test_equal_depths_keep_their_index():
    one = random_gaussians(1, 0)
    red, blue = (sh_from_color(np.array([color], np.float32)) for color in ((1, 0, 0), (0, 0, 1)))
    pair = Gaussians(
        np.array([[0, 0, 3]] * 2, np.float32), np.full((2, 3), 0.5, np.float32), np.tile(one.quaternions, (2, 1)),
        np.full(2, 0.9, np.float32), np.concatenate([red, blue]),
    )  # fmt: skip
    camera = small_camera()
    center = rasterize([DrawItem(pair, HERE)], camera).rgba[int(camera.cy), int(camera.cx)]
    assert center[0] > 0.8 > 0.2 > center[2]
    flipped = rasterize([DrawItem(pair.take(np.array([1, 0])), HERE)], camera).rgba[int(camera.cy), int(camera.cx)]
    assert flipped[2] > 0.8 > 0.2 > flipped[0]


def test_nothing_gives_an_empty_picture():
    for parts in ([], [DrawItem(Gaussians.empty(), HERE)], [DrawItem(random_gaussians(5, depth_m=(-9, 0.2)), HERE)]):
        frame = rasterize(parts, small_camera())
        assert frame.rgba.shape == (53, 75, 4)
        assert not frame.rgba.any()
        assert not frame.depth.any()


def test_the_same_bytes_at_any_thread_count():
    parts = [DrawItem(random_gaussians(3000, 6, 1), HERE)]
    digests, before = set[str](), numba.get_num_threads()
    try:
        for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):
            numba.set_num_threads(threads)
            frame = rasterize(parts, small_camera(300, 200))
            digests.add(hashlib.sha256(frame.rgba.tobytes() + frame.depth.tobytes()).hexdigest())
    finally:
        numba.set_num_threads(before)
    assert len(digests) == 1


def test_reference_harmonics_are_orthonormal_and_signed_as_in_3dgs():
    z, weight = np.polynomial.legendre.leggauss(8)
    phi = (np.arange(16) + 0.5) * np.pi / 8
    directions = np.stack(
        [
            np.sqrt(1 - z[:, None] ** 2) * np.cos(phi),
            np.sqrt(1 - z[:, None] ** 2) * np.sin(phi),
            np.broadcast_to(z[:, None], (8, 16)),
        ],
        axis=-1,
    )
    basis = sh_basis_slowly(directions)
    np.testing.assert_allclose(np.einsum("zpi,zpj,z->ij", basis, basis, weight) * np.pi / 8, np.eye(16), atol=1e-12)
    assert (sh_basis_slowly(np.eye(3))[[1, 2, 0], [1, 2, 3]] * [-1, 1, -1] > 0).all()


def read_3dgs_ply(path: Path) -> Gaussians:
    raw = path.read_bytes()
    body = raw.index(b"end_header\n") + len(b"end_header\n")
    names = [line.split()[2] for line in raw[:body].decode().splitlines() if line.startswith("property")]
    rows = np.frombuffer(raw, np.dtype([(name, "<f4") for name in names]), offset=body)

    def columns(*keys):
        return np.stack([rows[key] for key in keys], axis=1)

    rest = columns(*(f"f_rest_{i}" for i in range(45))).reshape(-1, 3, 15).transpose(0, 2, 1)
    quaternions = columns("rot_0", "rot_1", "rot_2", "rot_3")
    return Gaussians(
        columns("x", "y", "z"),
        np.exp(columns("scale_0", "scale_1", "scale_2")),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        1 / (1 + np.exp(-rows["opacity"])),
        np.concatenate([columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None], rest], axis=1),
    )


def read_splat_rows(path: Path) -> Gaussians:
    rows = np.fromfile(path, np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("wxyz", "u1", 4)]))
    quaternions = (rows["wxyz"].astype(np.float32) - 128) / 128
    rgba = rows["rgba"].astype(np.float32) / 255
    return Gaussians(
        np.ascontiguousarray(rows["mean"]),
        np.ascontiguousarray(rows["scale"]),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        np.ascontiguousarray(rgba[:, 3]),
        sh_from_color(rgba[:, :3]),
    )


@pytest.mark.parametrize(("case", "least_db"), [("street_sh3", 60), ("plant", 70)])
def test_golden_images(case, least_db, golden, test_data):
    if case == "plant":
        gaussians = read_splat_rows(test_data / "scenes" / "plant.splat")
    else:
        gaussians = read_3dgs_ply(golden / f"{case}.ply")
    frame = rasterize([DrawItem(gaussians, HERE)], read_camera(golden / f"{case}.camera.json"))
    reference = np.load(golden / f"{case}.reference.npz")["rgb"].astype(np.float64)
    psnr_db = -10 * np.log10(np.mean((frame.rgba[..., :3] - reference) ** 2))
    assert psnr_db > least_db


def test_a_limit_draws_the_first_ones_and_indices_count_all():
    parts = [DrawItem(random_gaussians(80, 1, 1), HERE, 30), DrawItem(random_gaussians(50, 2), HERE)]
    cut = [DrawItem(parts[0].gaussians.take(slice(0, 30)), HERE), parts[1]]
    camera = small_camera()
    np.testing.assert_array_equal(rasterize(parts, camera).rgba, rasterize(cut, camera).rgba)
    splats, whole = project(parts, camera), project([DrawItem(part.gaussians, HERE) for part in parts], camera)
    kept = (whole.indices < 30) | (whole.indices >= 80)
    assert 0 < kept.sum() < len(kept)
    np.testing.assert_array_equal(splats.indices, whole.indices[kept])
    np.testing.assert_array_equal(splats.shapes, whole.shapes[kept])
    np.testing.assert_array_equal(splats.colors, whole.colors[kept])


def test_memory_is_taken_for_what_may_be_seen_only():
    behind = random_gaussians(500, 1, depth_m=(-9, 0.1))
    aside = random_gaussians(500, 2)
    aside = Gaussians(aside.means + np.float32([200, 0, 0]), *(getattr(aside, name) for name in FIELDS[1:]))
    seen = random_gaussians(20, 3)
    assert len(project([DrawItem(each, HERE) for each in (behind, seen, aside)], small_camera())) == 20


@settings(max_examples=30)
@given(seed=st.integers(0, 1000), size=st.sampled_from([1e-3, 0.5, 20.0]), enlarged=st.sampled_from([0.5, 7.0]))
def test_no_gaussian_that_is_seen_is_left_out(seed, size, enlarged):
    g = random_gaussians(200, seed, depth_m=(-2.0, 9.0))
    wide = np.random.default_rng(seed).uniform(-12, 12, (200, 3)).astype(np.float32)
    g = Gaussians(g.means + wide, g.scales * np.float32(size), g.quaternions, g.opacities, g.sh)
    part, camera = moved(g, similarity(enlarged, seed)), small_camera()
    splats = project([part], camera)
    found = set(splats.indices[splats.nearest_first()].tolist())
    for i in range(0, 200, 7):
        one = DrawItem(part.gaussians.take(np.array([i])), part.to_world)
        if rasterize_slowly([one], camera).any():
            assert i in found
