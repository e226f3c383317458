"""Level-of-detail trees: merged moments, cuts that cover everything once, images, files, and scenes with them."""

import logging
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.export import merges_details
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.render.level_of_detail import LodCut, LodSubset, subset_items
from gsrain_engine.render.renderer import Frame
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene import open as scene_files
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.lod_file import read_lod_tree
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache, write_scene_folder
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import matrices_from_quaternions
from gsrain_engine.scene.lod_tree import (
    FAN_OUT,
    LodTree,
    build_lod_tree,
    cut_lod_tree,
    level_starts,
    merged_harmonics,
    occlusion_by_trees,
)
from gsrain_engine.scene.open import load_drawable_scene, sorted_with_trees, with_lod_trees
from gsrain_engine.scene.scene import DrawItem, Layer, Scene
from gsrain_engine.threads import limited_kernels
from render.cpu.raster_scenes import psnr_db

from .formats.sample_files import sample_gaussians


def wall(cells: int, distance_m: float, seed: int = 0) -> Gaussians:
    """Tiles of a wall 20 m wide and high, facing a camera at the origin that looks along +z; its colors are smooth."""
    at = (np.arange(cells) + 0.5) / cells * 20 - 10
    x, y = (each.ravel() for each in np.meshgrid(at, at))
    n = len(x)
    order = np.random.default_rng(seed).permutation(n)
    means = np.stack([x, y, np.full(n, distance_m)], axis=1)[order].astype(np.float32)
    colors = 0.5 + 0.3 * np.stack([np.sin(0.9 * x), np.cos(0.7 * y), np.sin(0.5 * (x + y))], axis=1)[order]
    scales = np.tile(np.float32([0.63, 0.63, 0.02]) * np.float32(20 / cells), (n, 1))
    quaternions = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    return Gaussians(means, scales, quaternions, np.full(n, 0.99, np.float32), sh_from_color(np.float32(colors)))


def camera(width: int = 240, height: int = 160) -> Camera:
    return Camera.from_fov(width, height, 40.0, np.eye(4))


def below(tree: LodTree, node: int) -> np.ndarray:
    """Indices of the Gaussians below a node."""
    starts = tree.levels
    level = int(np.searchsorted(starts, node, side="right")) - 1
    first, size = node - int(starts[level]), FAN_OUT ** (level + 1)
    return tree.leaves[first * size : (first + 1) * size].astype(np.int64)


def covariances(g: Gaussians) -> np.ndarray:
    axes = matrices_from_quaternions(g.quaternions.astype(np.float64)) * g.scales.astype(np.float64)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def cross_section(covariance: np.ndarray) -> float:
    """Root of the sum of squared cross-sections along the axes, up to a factor."""
    return float(np.sqrt(max(0.5 * (np.trace(covariance) ** 2 - np.trace(covariance @ covariance)), 0)))


# Building


def test_nodes_have_the_moments_of_their_children_and_keep_the_integral_of_their_alpha() -> None:
    g = sample_gaussians(1500)
    tree = build_lod_tree(g)
    matrices, merged = covariances(g), covariances(tree.nodes)
    kinds = set[str]()
    for node in range(int(tree.levels[1])):
        members = below(tree, node)
        weights = g.opacities[members] * [cross_section(matrices[i]) for i in members]
        share = weights / weights.sum()
        mean = share @ g.means[members].astype(np.float64)
        np.testing.assert_allclose(tree.nodes.means[node], mean, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(tree.nodes.sh[node], np.einsum("n,nkc->kc", share, g.sh[members]), atol=1e-5)
        offsets = g.means[members] - mean
        within = np.einsum("n,nab->ab", share, matrices[members])
        between = np.einsum("n,na,nb->ab", share, offsets, offsets)
        integral = tree.nodes.opacities[node] * cross_section(merged[node])
        if cross_section(within + between) >= weights.sum():  # transparent enough to keep the covariance
            kinds.add("matched")
            np.testing.assert_allclose(merged[node], within + between, rtol=1e-3, atol=1e-6 * np.trace(merged[node]))
            assert integral == pytest.approx(weights.sum(), rel=1e-3)
        else:
            kinds.add("spread")
            assert tree.nodes.opacities[node] == pytest.approx(1, abs=1e-3)
            assert integral <= weights.sum() * 1.001
            largest = cross_section(within + 5 * between)
            assert cross_section(merged[node]) == pytest.approx(min(weights.sum(), largest), rel=1e-3)
    assert kinds == {"matched", "spread"}


def test_an_opaque_crowd_is_spread_by_no_more_than_five_times_its_covariance() -> None:
    f, offsets = np.float32, 0.3 * np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
    turns = np.tile(f([1, 0, 0, 0]), (4, 1))
    crowd = Gaussians(offsets.astype(f), np.ones((4, 3), f), turns, np.full(4, 0.99, f), np.zeros((4, 1, 3), f))
    (merged,) = covariances(build_lod_tree(crowd).nodes)
    np.testing.assert_allclose(merged, np.eye(3) + 5 * np.cov(offsets.T, bias=True), rtol=1e-3, atol=1e-4)


def test_balls_hold_what_is_below_and_errors_grow_upwards() -> None:
    g = sample_gaussians(3000)
    tree = build_lod_tree(g)
    starts = tree.levels
    assert sorted(tree.leaves.tolist()) == list(range(3000)) and len(tree.nodes) == starts[-1] == level_starts(3000)[-1]
    for node in range(0, int(starts[-1]), 7):
        members = below(tree, node)
        reach = np.linalg.norm(g.means[members] - tree.nodes.means[node], axis=1) + 3 * g.scales[members].max(axis=1)
        assert (reach <= tree.radii[node] * 1.001).all()
    for level in range(len(starts) - 2):
        lower, upper = tree.errors[starts[level] : starts[level + 1]], tree.errors[starts[level + 1] :]
        assert (upper[np.arange(len(lower)) // FAN_OUT] >= lower).all()


def test_any_number_of_threads_builds_the_same_tree() -> None:
    g = sample_gaussians(4000)
    trees: list[LodTree] = []
    for threads in (1, 3):
        with limited_kernels(threads):
            trees.append(build_lod_tree(g))
    one, other = ((*each.nodes.arrays, each.radii, each.errors, each.leaves) for each in trees)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_few_gaussians_have_a_tree(count: int) -> None:
    g = wall(3, 8.0).take(slice(0, count))
    tree = build_lod_tree(g)
    found = cut_lod_tree(tree, camera(), np.eye(4), 0.01)
    assert found.leaves.tolist() == list(range(count)) and len(found.nodes) == 0
    assert len(cut_lod_tree(tree, camera(), np.eye(4), 1e6).leaves) == (0 if count > 1 else count)


def test_values_that_are_not_finite_have_no_weight() -> None:
    g = wall(40, 8.0)
    means, scales = g.means.copy(), g.scales.copy()
    means[::5], scales[1::7] = np.nan, np.inf
    tree = build_lod_tree(replace(g, means=means, scales=scales))
    visible = tree.nodes.opacities > 0
    assert visible.mean() > 0.75 and all(np.isfinite(each[visible]).all() for each in tree.nodes.arrays)
    every = build_lod_tree(replace(g, means=np.full_like(g.means, np.nan)))
    assert not every.nodes.opacities.any()


# Cuts


@pytest.mark.parametrize("pixel", [0.3, 1.0, 5.0])
def test_a_cut_covers_each_gaussian_in_view_once(pixel: float) -> None:
    g = sample_gaussians(6000)
    g = replace(g, means=8 * g.means, scales=0.2 * g.scales)
    to_world = np.diag([0.5, 0.5, 0.5, 1.0])
    to_world[:3, 3] = 0, 0, 6
    tree = build_lod_tree(g)
    found = cut_lod_tree(tree, camera(), to_world, pixel)
    covered = np.concatenate([found.leaves, *(below(tree, int(node)) for node in found.nodes)])
    assert len(np.unique(covered)) == len(covered) and (np.diff(found.leaves) > 0).all()
    drawn = project([DrawItem(g, to_world)], camera())
    assert set(drawn.indices[drawn.colors[:, 3] > 0].tolist()) <= set(covered.tolist())
    assert len(covered) < len(g)  # those behind the camera are left out
    depths = tree.nodes.means[found.nodes] @ to_world[2, :3] + to_world[2, 3]
    assert (0.5 * tree.errors[found.nodes] * camera().fx <= pixel * 1.001 * depths).all()


def test_far_walls_are_drawn_with_a_fraction_of_the_gaussians_and_look_the_same() -> None:
    g = wall(300, 60.0)  # tiles of 0.24 pixels; the wall is 73 pixels high
    item = DrawItem(g, np.eye(4), tree=build_lod_tree(g))
    renderer = CpuRenderer()

    def image(thinning: LodCut | LodSubset | None) -> tuple[int, Frame, Frame]:
        """Number of splats, the image, and its part inside the wall."""
        renderer.draw(subset_items([item], thinning, camera()), camera())
        frame = renderer.read()
        return renderer.statistics.splats_drawn, frame, Frame(frame.rgba[52:-52, 92:-92])

    full, cut, fine, subset = (image(each) for each in (None, LodCut(1.0), LodCut(0.25), LodSubset(1 / 64)))
    assert (full[0], subset[0]) == (90_000, 1407) and cut[0] < 1407 and fine[0] < 90_000 / 6
    assert cut[2].rgba[..., 3].min() > 0.9 and fine[2].rgba[..., 3].min() > 0.99  # without holes
    assert psnr_db(full[2], fine[2]) > psnr_db(full[2], cut[2]) + 4 > psnr_db(full[2], subset[2]) + 6
    assert psnr_db(full[1], fine[1]) > psnr_db(full[1], cut[1]) + 2  # with the wall's edges


def test_near_walls_are_drawn_exactly() -> None:
    g = wall(40, 12.0)
    item = DrawItem(g, np.eye(4), tree=build_lod_tree(g))
    renderer = CpuRenderer()
    renderer.draw([item], camera())
    full = renderer.read().rgba
    renderer.draw(subset_items([item], LodCut(), camera()), camera())
    np.testing.assert_array_equal(renderer.read().rgba, full)


def thick_wall() -> Gaussians:
    """Wall at 20 m of overlapping tiles in three layers, opaque wherever they are merged."""
    walls = [wall(100, distance_m) for distance_m in (20.0, 20.2, 20.4)]
    return Gaussians.concatenate([replace(each, scales=each.scales * np.float32(2)) for each in walls])


def test_what_surfaces_hide_is_left_out() -> None:
    far, near = wall(300, 60.0), thick_wall()  # the near one is 220 pixels wide, the far one 73
    trees, renderer = [build_lod_tree(far), build_lod_tree(near)], CpuRenderer()

    def drawn(aside_m: float, opacity: float, cut: LodCut) -> tuple[int, Frame]:
        """Number of splats of the far wall, and the image, with the near wall moved to the right."""
        to_world = np.eye(4)
        to_world[0, 3] = aside_m
        parts = [DrawItem(far, np.eye(4), tree=trees[0]), DrawItem(near, to_world, tree=trees[1], opacity=opacity)]
        items = subset_items(parts, cut, camera())
        renderer.draw(items, camera())
        return sum(each.drawn_count for each in items[:2]), renderer.read()

    whole = LodCut(occlusion=False)
    number, _ = drawn(0.0, 1.0, whole)
    assert drawn(0.0, 1.0, LodCut())[0] == 0 and drawn(0.0, 0.5, LodCut())[0] == drawn(40.0, 1.0, LodCut())[0] == number
    half, image = drawn(10.0, 1.0, LodCut())
    assert 0.4 * number < half < 0.65 * number
    assert psnr_db(image, drawn(10.0, 1.0, whole)[1]) > 45


@pytest.mark.parametrize("threads", [1, 2])
def test_depths_of_occlusion_are_those_of_surfaces(threads: int) -> None:
    tree = build_lod_tree(thick_wall())
    with limited_kernels(threads):
        hidden = occlusion_by_trees([(tree, np.diag([0.5, 0.5, 1.0, 1.0]))], camera())
    cells = hidden.cells
    assert cells.shape == (48, 32) and hidden.depths_m[-1] == np.inf
    inside = cells[14:34, 6:26]
    assert (inside > 20).all() and (inside < 20 * 1.13).all()
    assert np.isinf(cells[[0, -1]]).all()


def test_wet_colors_of_nodes_are_those_of_their_gaussians() -> None:
    g = wall(120, 60.0)
    wet_sh = (g.sh * np.float32(0.5)).copy()
    tree = build_lod_tree(g)
    np.testing.assert_allclose(merged_harmonics(tree, g.sh), tree.nodes.sh, atol=1e-5)
    assert merged_harmonics(tree, wet_sh) is merged_harmonics(tree, wet_sh)
    soaked, renderer = g.with_sh(wet_sh), CpuRenderer()
    wet = DrawItem(g, np.eye(4), wet_sh=wet_sh, wetness=1.0, tree=tree)
    renderer.draw(subset_items([wet], LodCut(), camera()), camera())
    image = renderer.read().over()
    same_cut = replace(tree, gaussians=soaked, nodes=build_lod_tree(soaked).nodes)
    renderer.draw(subset_items([DrawItem(soaked, np.eye(4), tree=same_cut)], LodCut(), camera()), camera())
    np.testing.assert_allclose(image, renderer.read().over(), atol=1e-4)


def test_marked_parts_and_parts_of_other_gaussians_are_drawn_in_full() -> None:
    g = wall(120, 60.0)
    layer = Layer("wall", g, tree=build_lod_tree(g))
    some = BitMask.of(np.arange(len(g)) % 2 == 0)
    hidden = replace(layer, marks=SelectionFlags(hidden=some))
    chosen = replace(layer, marks=SelectionFlags(selected=some))
    edited = replace(layer, gaussians=replace(g, opacities=g.opacities * np.float32(0.5)))
    for each, selection, items in (
        (layer, True, 2),
        (hidden, False, 1),
        (chosen, True, 1),
        (chosen, False, 2),
        (edited, False, 1),
    ):
        (part,) = Scene("wall", (each,)).parts(selection=selection)
        found = LodCut().items(part, camera())
        assert len(found) == items and (items == 2 or found[0] is part)
        assert items == 2 or LodCut(others=LodSubset(0.5)).items(part, camera())[0].limit == len(g) // 2


# Scenes and files


def large_scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Scene of 14,400 Gaussians that counts as large."""
    for module in ("gsrain_engine.scene.open", "gsrain_engine.render.level_of_detail"):
        monkeypatch.setattr(f"{module}.MIN_GAUSSIANS", 10_000)
    return Scene("wall", (Layer("wall", wall(120, 60.0)), Layer("small", wall(4, 9.0))))


def test_a_tree_is_read_from_the_folder_of_its_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = sorted_with_trees(large_scene(monkeypatch))
    assert [each.tree is not None for each in scene.members] == [True, False]
    assert sorted_with_trees(scene) is scene
    folder = tmp_path / "scene"
    write_scene(scene, folder, in_drawing_order=True)
    monkeypatch.setattr(scene_files, "build_lod_tree", None)  # whatever builds another fails
    read = load_drawable_scene(folder).layers[0]
    assert read.tree is not None and scene.layers[0].tree is not None and read.tree.fits(read.gaussians)
    for found, array in zip(read.tree.nodes.arrays, scene.layers[0].tree.nodes.arrays, strict=True):
        assert found.tobytes() == array.tobytes()
    np.testing.assert_array_equal(read.tree.leaves, scene.layers[0].tree.leaves)
    # An edit writes other Gaussians, without that tree; the old one leaves with its layer.
    edited = replace(read, gaussians=replace(read.gaussians, opacities=read.gaussians.opacities * np.float32(0.5)))
    write_scene(replace(scene, layers=(edited,)), folder, in_drawing_order=True)
    assert not list(folder.rglob("*.lod")) and len(list(folder.rglob("*.ply"))) == 1


def test_damaged_trees_are_reported_and_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "scene"
    write_scene(sorted_with_trees(large_scene(monkeypatch)), folder, in_drawing_order=True)
    (file,), (ply,) = folder.rglob("*.lod"), folder.rglob("000-*.ply")
    whole, count = file.read_bytes(), 14_400
    leaves = len(whole) - 4 * 14 * count - 4
    too_high = whole[:leaves] + np.array([count], "<u4").tobytes() + whole[leaves + 4 :]
    cases = {
        b"": "is not a level-of-detail tree",
        whole[:-100]: "bytes, expected",
        whole + b"1": "bytes, expected",
        whole[:12] + b"}" + whole[13:]: "header is damaged",
        whole.replace(b'"version":2', b'"version":3'): "another version",
        whole.replace(b'"coefficients":1', b'"coefficients":2'): "of 2 coefficients a color",
        whole.replace(b'"gaussians":14400', b'"gaussians":1' + 12 * b"0").replace(b"        ", b"", 1): "lists 10000",
        whole.replace(b'"max_roots":1024', b'"max_roots":1023'): "another version",
        too_high: f"names Gaussian {count} of {count}",
        whole[:-8] + np.array([np.nan], "<f4").tobytes() + whole[-4:]: "not finite",
    }
    for data, message in cases.items():
        file.write_bytes(data)
        with pytest.raises(SceneFormatError, match=message):
            read_lod_tree(file, ply)
        caplog.clear()
        with caplog.at_level(logging.WARNING, "gsrain"):
            assert read_scene(folder).layers[0].tree is None
        assert message in caplog.text and caplog.text.count("\n") == 1
    known = FileCache()
    read = load_drawable_scene(folder, known)
    assert read.layers[0].tree is not None  # built again
    write_scene(read, folder, known, in_drawing_order=True)  # and written where the damaged one was
    assert file.read_bytes()[:9] == b"GSRAINLOD" and read_scene(folder).layers[0].tree is not None


@pytest.mark.parametrize("age_s", [-100, 100])
def test_a_tree_of_another_ply_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, age_s: int) -> None:
    folder = tmp_path / "scene"
    write_scene(sorted_with_trees(large_scene(monkeypatch)), folder, in_drawing_order=True)
    (ply,) = folder.rglob("000-*.ply")
    data, time_ns = ply.read_bytes(), ply.stat().st_mtime_ns
    ply.write_bytes(data[:-4000] + bytes(40) + data[-3960:])
    os.utime(ply, ns=(time_ns, time_ns + age_s * 10**9))
    assert read_scene(folder).layers[0].tree is None
    ply.write_bytes(data)
    os.utime(ply, ns=(time_ns, time_ns + age_s * 10**9))
    read = read_scene(folder).layers[0]
    assert read.tree is not None and read.tree.gaussians is read.gaussians


def test_numbers_of_a_tree_are_checked_once_and_not_those_of_own_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, checks = tmp_path / "scene", list[str]()
    check = "gsrain_engine.scene.formats.lod_file._check_values"
    monkeypatch.setattr(check, lambda *_: checks.append("checked"))
    write_scene(sorted_with_trees(large_scene(monkeypatch)), folder, in_drawing_order=True)
    assert read_scene(folder).layers[0].tree is not None and checks == []
    shutil.copytree(folder, tmp_path / "copy")
    for _ in range(2):
        assert read_scene(tmp_path / "copy").layers[0].tree is not None and checks == ["checked"]


def test_a_part_of_a_ply_that_changed_later_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gsrain_engine.scene.formats.lod_file._BLOCKS", 2)
    folder = tmp_path / "scene"
    write_scene(sorted_with_trees(large_scene(monkeypatch)), folder, in_drawing_order=True)
    (ply,) = folder.rglob("000-*.ply")
    data = ply.read_bytes()
    ply.write_bytes(data[:100_000] + bytes(4) + data[100_004:])
    os.utime(ply, ns=(0, ply.stat().st_mtime_ns + 10**9))
    assert read_scene(folder).layers[0].tree is None


def test_gaussians_with_a_tree_are_mapped_and_equal_those_of_the_ply(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, copy = tmp_path / "scene", tmp_path / "copy"
    write_scene(sorted_with_trees(large_scene(monkeypatch)), folder, in_drawing_order=True)
    before = {file.name: file.read_bytes() for file in folder.rglob("*.*")}
    with monkeypatch.context() as patched:
        patched.setattr("gsrain_engine.scene.formats.scene_folder.read_gaussians", lambda _: wall(4, 9.0))  # small
        known = FileCache()
        mapped = read_scene(folder, known)
    (file,) = folder.rglob("*.lod")
    file.rename(tmp_path / "away.lod")
    plain = read_scene(folder).layers[0].gaussians
    for found, array in zip(mapped.layers[0].gaussians.arrays, plain.arrays, strict=True):
        assert found.tobytes() == array.tobytes()
    (tmp_path / "away.lod").rename(file)
    mapped.layers[0].gaussians.means[:] = 0  # private: no kernel can change the file
    assert {each.name: each.read_bytes() for each in folder.rglob("*.*")} == before
    write_scene_folder(mapped, copy, known, linking=True, in_drawing_order=True)
    linked = next(copy.rglob("*.lod"))
    assert linked.samefile(file) and read_scene(copy).layers[0].tree is not None


def test_large_scenes_are_drawn_with_a_cut_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    large = large_scene(monkeypatch)
    small = replace(large, layers=large.layers[1:])
    for output, lod, expected in (
        ("a.png", None, (True, False)), ("a.npy", None, (False, False)), ("a.mp4", None, (True, False)),
        ("a.png", "off", (False, False)), ("a.npy", "pixel", (True, True)),
    ):  # fmt: skip
        settings = ExportSettings(output=output, lod=lod)
        assert (merges_details(settings, large), merges_details(settings, small)) == expected
    assert with_lod_trees(small) is small
