"""Blocks of mapped Gaussians: the same rows and images as from arrays in memory, in a part of their memory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.render.cpu.block_cache import BLOCK, BlockCache, BlockCaches
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.level_of_detail import LodCut, subset_items
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.mapped_arrays import is_mapped, map_arrays, release_pages
from gsrain_engine.scene.open import sorted_with_trees
from gsrain_engine.scene.scene import Layer, Scene
from scene.formats.sample_files import sample_gaussians


def numbers(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(count * 3, dtype=np.float32).reshape(count, 3), np.arange(count, dtype=np.float32)


def test_rows_are_those_of_the_sources_while_blocks_are_replaced() -> None:
    means, opacities = numbers(5000)
    cache, rng = BlockCache((means, opacities)), np.random.default_rng(3)
    whole = means.nbytes + opacities.nbytes
    assert cache.nbytes < 0.3 * whole
    for _ in range(40):
        first = int(rng.integers(0, 4200))
        members = np.sort(rng.choice(np.arange(first, first + 800), 300, replace=False))
        rows = cache.rows(members)
        assert len(np.unique(rows)) == len(rows)
        np.testing.assert_array_equal(cache.arrays[0][rows], means[members])
        np.testing.assert_array_equal(cache.arrays[1][rows], opacities[members])
        assert cache.nbytes < 0.3 * whole
    members = np.arange(4999, -1, -1)  # grows for a frame that needs all, the short last block included
    rows = cache.rows(members)
    np.testing.assert_array_equal(cache.arrays[0][rows], means[members])
    assert cache.nbytes <= 1.01 * whole and len(cache.rows(members[:0])) == 0


def test_blocks_in_use_are_not_read_again() -> None:
    means, opacities = numbers(64 * BLOCK)
    cache = BlockCache((means, opacities))
    members = np.arange(0, 12 * BLOCK)
    first = cache.rows(members).copy()
    means[:] = -1  # sources must not change: a block that is read again would show it
    cache.rows(np.arange(40 * BLOCK, 43 * BLOCK))  # in slots that are free
    np.testing.assert_array_equal(cache.rows(members), first)
    assert cache.arrays[0][first].min() == 0


def test_wet_colors_are_added_to_the_blocks_in_memory_and_dropped_when_they_are_idle(tmp_path, monkeypatch) -> None:
    scene, _ = mapped_scene(tmp_path / "scene", monkeypatch)
    layer, caches = scene.layers[0], BlockCaches()
    g, wet, members = layer.gaussians, layer.wet_sh, np.arange(30, 300)
    assert wet is not None
    caches.present(g, None, members)
    dry_bytes = caches.nbytes
    for more, colors in ((0, wet), (1200, wet), (0, wet.copy())):  # blocks before, blocks read since, other colors
        found, wet_found, rows = caches.present(g, colors, members + more)
        assert wet_found is not None
        np.testing.assert_array_equal(wet_found[rows], wet[members + more])
        np.testing.assert_array_equal(found.sh[rows], g.sh[members + more])
    assert caches.nbytes > dry_bytes
    for _ in range(65):
        assert caches.present(g, None, members)[1] is None
        caches.release_unused()
    assert caches.nbytes == dry_bytes


def mapped_scene(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Scene, Scene]:
    """The same scene twice, mapped and in memory; with wet colors."""
    monkeypatch.setattr("gsrain_engine.scene.open.MIN_GAUSSIANS", 1000)
    g = sample_gaussians(6000)
    g = replace(g, means=8 * g.means + np.float32([0, 0, 30]), scales=0.3 * g.scales)
    scene = Scene("dots", (Layer("dots", g, wet_sh=(g.sh * np.float32(0.5)).copy()),))
    write_scene(sorted_with_trees(scene), folder, in_drawing_order=True)
    mapped = read_scene(folder)
    layer = mapped.layers[0]
    assert layer.tree is not None and layer.wet_sh is not None
    assert all(map(is_mapped, (*layer.gaussians.arrays, layer.wet_sh, layer.tree.errors)))
    plain = Gaussians(*(each.copy() for each in layer.gaussians.arrays))
    nodes = Gaussians(*(each.copy() for each in layer.tree.nodes.arrays))
    tree = replace(layer.tree, gaussians=plain, nodes=nodes)
    return mapped, replace(mapped, layers=(replace(layer, gaussians=plain, wet_sh=layer.wet_sh.copy(), tree=tree),))


def test_images_of_mapped_scenes_are_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mapped, plain = mapped_scene(tmp_path / "scene", monkeypatch)
    one, other = CpuRenderer(), CpuRenderer()
    counts = set[int]()
    for turn_deg in (0, 60, 5, 180, 0):
        angle = np.radians(turn_deg)
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
        camera = Camera.from_fov(120, 80, 40.0, pose)
        for wetness in (0.0, 0.7):
            for renderer, scene in ((one, mapped), (other, plain)):
                renderer.draw(subset_items(scene.parts(wetness=wetness), LodCut(3.0), camera), camera)
            assert one.read().rgba.tobytes() == other.read().rgba.tobytes()
            counts.add(one.statistics.splats_drawn)
    assert len(counts) > 2


def test_gaussians_in_memory_are_used_where_they_are_and_idle_caches_are_freed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mapped, plain = mapped_scene(tmp_path / "scene", monkeypatch)
    caches, members = BlockCaches(), np.arange(50)
    own = plain.layers[0].gaussians
    same, _, rows = caches.present(own, None, members)
    assert same is own and rows is members and caches.nbytes == 0
    found, _, rows = caches.present(mapped.layers[0].gaussians, None, members)
    np.testing.assert_array_equal(found.sh[rows], own.sh[members])
    for _ in range(65):
        assert caches.nbytes > 0
        caches.release_unused()
    assert caches.nbytes == 0


def test_arrays_of_a_file_are_mapped_for_one_process(tmp_path: Path) -> None:
    path = tmp_path / "numbers"
    path.write_bytes(bytes(4) + np.arange(6, dtype="<f4").tobytes())
    with path.open("rb") as file:
        (array,) = map_arrays(file, [((2, 3), np.dtype("<f4"), 4)])
    assert array.tolist() == [[0, 1, 2], [3, 4, 5]] and is_mapped(array[1:]) and not is_mapped(array.copy())
    array[:] = 7
    assert path.read_bytes()[4:8] == bytes(4)
    release_pages([array, array.copy()])
    assert array[0, 0] == 0  # read from the file again
