"""CycleGAN-Turbo over views: sizes, order, tiles, guides, what is held, and the same bytes twice."""

import gc
import weakref
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")

from gsrain_engine.appearance.base import ClearView, Transfer  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.cross_view_attention import CrossViewAttention  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.translator import (  # noqa: E402
    NO_OVERLAP,
    WITHOUT_POSE,
    CycleGanTurboTransfer,
    RunSettings,
    blend_tiles,
    frame_size,
    resized,
    restore_size,
    split_into_tiles,
)
from gsrain_engine.scene.camera import Camera, look_at  # noqa: E402

# Sizes and tiles


@pytest.mark.parametrize(
    ("size", "side", "expected"),
    [((640, 960), 512, (512, 768)), ((1280, 1920), 512, (512, 768)), ((900, 1600), 512, (512, 912)),
     ((270, 480), 512, (272, 480)), ((641, 959), None, (640, 960)), ((3, 5), 512, (8, 8))],
)  # fmt: skip
def test_sizes_keep_proportions(size, side, expected):
    assert frame_size(*size, side, 8) == expected


@settings(max_examples=25)
@given(
    st.integers(1, 8), st.integers(1, 8), st.sampled_from([64, 128, 192]), st.integers(0, 160), st.integers(0, 2**32)
)
def test_tiles_cover_everything_overlap_as_asked_and_blend_to_the_same_picture(rows, columns, tile, overlap, seed):
    height, width = 64 * rows, 64 * columns
    windows = split_into_tiles(height, width, tile, overlap, 64)
    picture = np.random.default_rng(seed).random((height, width, 1), dtype=np.float32)
    parts = [picture[w.top : w.top + w.height, w.left : w.left + w.width] for w in windows]
    assert all(w.top % 64 == 0 and w.left % 64 == 0 and w.height <= tile and w.width <= tile for w in windows)
    np.testing.assert_allclose(blend_tiles(parts, windows, overlap), picture, atol=1e-6)
    for before, after in pairwise(sorted({w.left for w in windows})):
        assert before + tile - after >= min(overlap, tile - 64)


def test_what_the_network_did_not_see_comes_back():
    rng = np.random.default_rng(2)
    clear = resized(rng.random((40, 60, 3), dtype=np.float32), 80, 120) * 0.5 + 0.2
    fine = clear + 0.05 * (np.indices((80, 120)).sum(axis=0) % 2 * 2 - 1)[..., None].astype(np.float32)
    seen = resized(fine, 40, 60)
    darker = restore_size(seen * 0.8, seen, fine, detail=True)
    np.testing.assert_allclose(darker - resized(seen * 0.8, 80, 120), fine - resized(seen, 80, 120), atol=1e-5)
    blurred = restore_size(seen * 0.8, seen, fine, detail=False)
    assert np.abs(np.diff(darker, axis=1)).mean() > 2 * np.abs(np.diff(blurred, axis=1)).mean()
    assert np.array_equal(restore_size(fine, fine, fine, detail=True), fine)


# Views

WIDTH, HEIGHT = 96, 64


ALONE = RunSettings(side_px=None, mutual=None)


def wall(name: str, shift_m: float, width: int = WIDTH, height: int = HEIGHT) -> ClearView:
    """A view of a painted wall 4 m away, from a place `shift_m` to the side."""
    eye = np.array([0.0, -shift_m, 1.5])
    pose = look_at(eye, eye + np.array([1.0, 0, 0]), np.array([0.0, 0, 1]))
    camera = Camera.from_fov(width, height, 60, pose)
    rows, columns = np.mgrid[:height, :width] + 0.5
    y = (columns - camera.cx) / camera.fx * 4 + shift_m
    z = (rows - camera.cy) / camera.fy * 4
    image = 0.5 + 0.4 * np.stack([np.sin(3 * y), np.cos(5 * z + y), np.sin(4 * z)], axis=-1)
    plane = np.zeros((height, width), np.float32)
    normals = np.zeros((height, width, 3), np.float32)
    normals[..., 0] = -1
    return ClearView(name, camera, 0.0, image.astype(np.float32), plane + 4, normals, plane, plane)


class Rendered(Sequence):
    """Views along a wall, each made when it is asked for; knows which are still held."""

    def __init__(self, count):
        self.count, self.pictures = count, []

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        if not 0 <= index < self.count:
            raise IndexError(index)
        view = wall(str(index), 0.8 * index)
        self.pictures.append(weakref.ref(view.image))
        return view

    @property
    def held(self):
        return sum(picture() is not None for picture in self.pictures)


@pytest.fixture(scope="module")
def model():
    model = build_random_model(tiny(), normals=True)
    with torch.no_grad():  # as if trained: the new channel and the skips count
        for vae in (model.vae, model.vae_b2a):
            vae.encoder.conv_in.weight[:, 3] = 0.2
    return model


@pytest.fixture
def views():
    return [wall(name, shift) for name, shift in (("left", -0.5), ("center", 0.0), ("right", 0.5))]


def images(model, views, settings):
    made = {each.clear.name: each for each in CycleGanTurboTransfer(model, settings).transferred(views)}
    assert sorted(made) == sorted(view.name for view in views)
    return {name: each.image for name, each in made.items()}


def replace_mutual(settings: RunSettings, **choice) -> RunSettings:
    return replace(settings, mutual=CrossViewAttention(px_per_token=(8, 16, 32, 64), **choice))


def test_it_is_the_models_own_picture(model, views):
    transfer = CycleGanTurboTransfer(model, ALONE)
    assert isinstance(transfer, Transfer)
    (made,) = transfer.transferred(views[:1])
    picture = torch.from_numpy(views[0].image.transpose(2, 0, 1))[None] * 2 - 1
    with torch.inference_mode():
        expected = model.translate(picture, torch.zeros(1, 1, HEIGHT, WIDTH))[0].permute(1, 2, 0).numpy() / 2 + 0.5
    assert made.clear is views[0]
    np.testing.assert_allclose(made.image, expected, atol=1e-6)
    assert np.abs(made.image - views[0].image).max() > 0.05


@pytest.mark.parametrize("order", ["outward", "together"])
def test_the_same_views_give_the_same_bytes(model, views, order):
    settings = RunSettings(side_px=48, mutual=CrossViewAttention(order=order))
    first, second = images(model, views, settings), images(model, views, settings)
    for name, image in first.items():
        assert image.tobytes() == second[name].tobytes()
        assert image.shape == (HEIGHT, WIDTH, 3)
        assert image.dtype == np.float32
        assert 0 <= image.min() < image.max() <= 1


def test_views_look_at_neighbours_and_the_anchor_does_not(model, views):
    alone = images(model, views, ALONE)

    def changed(**choice):
        mutual = images(model, views, replace_mutual(ALONE, **choice))
        return [name for name in alone if not np.array_equal(mutual[name], alone[name])]

    assert sorted(changed(order="outward")) == ["left", "right"]
    assert sorted(changed(order="together")) == ["center", "left", "right"]
    assert changed(neighbours=0) == []


def test_it_holds_only_what_is_still_looked_at(model):
    row = Rendered(8)
    names, held = [], []
    for made in CycleGanTurboTransfer(model, replace_mutual(ALONE, neighbours=1)).transferred(row):
        names.append(made.clear.name)
        held.append(row.held)
    assert sorted(names) == [str(i) for i in range(8)]
    assert max(held) <= 4  # this view, the last one made, and both ends of what is done
    del made
    gc.collect()
    assert row.held == 0


def test_an_interrupted_run_leaves_the_model_as_it_was(model, views):
    before = dict(model.unet.attn_processors)
    stream = CycleGanTurboTransfer(model, RunSettings(side_px=None)).transferred(views)
    next(stream)
    assert model.unet.attn_processors != before
    stream.close()
    assert model.unet.attn_processors == before


class LevelGround:
    """Estimator of normals that point up everywhere."""

    def normals(self, image, camera):
        assert image.shape[:2] == (camera.height, camera.width)
        return np.broadcast_to(np.float32([0, 0, 1]), image.shape)


def test_normals_guide_it_from_the_view_or_an_estimator(model, views):
    ground = replace(views[0], normals=np.broadcast_to(np.float32([0, 0, 1]), (HEIGHT, WIDTH, 3)))
    guided = images(model, [ground], ALONE)["left"]
    without = images(model, [ground], replace(ALONE, normals="none"))["left"]
    assert np.abs(guided - without).max() > 0.01
    unknown = replace(ground, normals=np.zeros((HEIGHT, WIDTH, 3), np.float32))
    assert np.array_equal(images(model, [unknown], ALONE)["left"], without)
    (estimated,) = CycleGanTurboTransfer(model, replace(ALONE, normals="dsine"), LevelGround()).transferred(views[:1])
    assert np.array_equal(estimated.image, guided)
    narrow = build_random_model(tiny(), normals=False)
    assert images(narrow, views, RunSettings(side_px=None)).keys() == {"left", "center", "right"}


def test_views_without_poses_and_without_overlap_stay_alone_and_say_so(model, views):
    settings = RunSettings(side_px=None)
    alone = images(model, views, ALONE)
    blind = [replace(view, has_pose=False) for view in views]
    made = list(CycleGanTurboTransfer(model, settings).transferred(blind))
    assert {each.left_out for each in made} == {WITHOUT_POSE}
    for each in made:
        np.testing.assert_array_equal(each.image, alone[each.clear.name])
    partly = list(CycleGanTurboTransfer(model, settings).transferred([*views[:2], blind[2]]))
    assert {each.clear.name: each.left_out for each in partly} == {"left": "", "center": "", "right": WITHOUT_POSE}
    far = [views[0], replace(wall("far", 500.0), time_s=1.0)]
    assert {each.left_out for each in CycleGanTurboTransfer(model, settings).transferred(far)} == {NO_OVERLAP}
    assert [each.left_out for each in CycleGanTurboTransfer(model, settings).transferred(blind[:1])] == [""]
    assert {each.left_out for each in CycleGanTurboTransfer(model, ALONE).transferred(blind)} == {""}
