"""CycleGAN-Turbo over views: sizes, order, tiles, guides, what is held, and the same bytes twice."""

import gc
import weakref
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")

from gsrain_engine.appearance.base import ClearView, Transfer, TransferSettings  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.translator import (  # noqa: E402
    NO_OVERLAP,
    OVERLAP_PX,
    WITHOUT_POSE,
    CycleGanTurboTransfer,
    blend_tiles,
    frame_size,
    resized,
    restore_size,
    split_into_tiles,
)
from gsrain_engine.appearance.scene_views import CachedViews  # noqa: E402
from gsrain_engine.scene.camera import Camera, look_at  # noqa: E402

# Sizes and tiles


@pytest.mark.parametrize(
    ("size", "side", "expected"),
    [((640, 960), 512, (512, 768)), ((900, 1600), 512, (512, 912)), ((270, 480), 512, (272, 480)),
     ((641, 959), None, (640, 960)), ((3, 5), 512, (8, 8))],
)  # fmt: skip
def test_sizes_keep_proportions_and_never_grow(size, side, expected):
    assert frame_size(*size, side, 8) == expected


@settings(max_examples=25)
@given(st.integers(1, 8), st.integers(1, 8), st.sampled_from([64, 128, 256]), st.integers(0, 2**32))
def test_tiles_cover_the_picture_overlap_and_blend_to_it(rows, columns, tile, seed):
    height, width = 64 * rows, 64 * columns
    windows = split_into_tiles(height, width, tile, 64)
    picture = np.random.default_rng(seed).random((height, width, 1), dtype=np.float32)
    assert all(w.top % 64 == 0 and w.left % 64 == 0 and w.height <= tile and w.width <= tile for w in windows)
    np.testing.assert_allclose(blend_tiles([picture[w.slices] for w in windows], windows), picture, atol=1e-6)
    for before, after in pairwise(sorted({w.left for w in windows})):
        assert before + tile - after >= min(OVERLAP_PX, tile - 64)


def test_the_detail_that_the_network_did_not_see_comes_back():
    clear = np.random.default_rng(2).random((80, 120, 3), dtype=np.float32) * 0.4 + 0.3
    small = resized(clear, 40, 60)
    darker = restore_size(small * 0.8, small, clear)
    np.testing.assert_allclose(darker - resized(small * 0.8, 80, 120), clear - resized(small, 80, 120), atol=1e-5)
    assert np.array_equal(restore_size(clear, clear, clear), clear)


# Views

WIDTH, HEIGHT = 96, 64


MUTUAL = TransferSettings(side_px=None)
ALONE = TransferSettings(side_px=None, mutual_attention=False)


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


def transferred(model, views, settings=MUTUAL, estimator=None):
    return CycleGanTurboTransfer(model, settings, estimator, px_per_token=(8, 16, 32, 64)).transferred(views)


def images(model, views, settings=MUTUAL):
    return {each.clear.name: each.image for each in transferred(model, views, settings)}


@pytest.mark.parametrize("tile_px", [None, 64])
def test_it_is_the_models_own_picture_tile_by_tile(model, tile_px):
    view = wall("wall", 0.0, 128, 128)
    (made,) = transferred(model, [view], TransferSettings(side_px=None, tile_px=tile_px))
    windows = split_into_tiles(128, 128, tile_px or 128, 64)
    picture = torch.from_numpy(view.image.transpose(2, 0, 1))[None] * 2 - 1
    with torch.inference_mode():
        parts = [model.translate(picture[:, :, *w.slices])[0].permute(1, 2, 0).numpy() / 2 + 0.5 for w in windows]
    assert made.clear is view and isinstance(CycleGanTurboTransfer(model), Transfer)
    np.testing.assert_allclose(made.image, blend_tiles(parts, windows), atol=1e-6)


def test_views_attend_to_neighbors_but_the_anchor_does_not_and_the_bytes_are_the_same_twice(model, views):
    alone, mutual = images(model, views, ALONE), images(model, views)
    changed = [name for name in alone if not np.array_equal(mutual[name], alone[name])]
    assert sorted(mutual) == ["center", "left", "right"] and sorted(changed) == ["left", "right"]
    again = images(model, views)
    assert all(image.tobytes() == again[name].tobytes() for name, image in mutual.items())
    for none in (TransferSettings(side_px=None, neighbours=0), ALONE):
        assert all(np.array_equal(image, alone[name]) for name, image in images(model, views, none).items())


def test_it_holds_only_views_that_others_attend_to_and_leaves_the_model_as_it_was(model):
    pictures, held = [], []

    def made(index):
        view = wall(str(index), 0.8 * index)
        pictures.append(weakref.ref(view.image))
        return view

    before = dict(model.unet.attn_processors)
    stream = transferred(model, CachedViews(8, made, 0), TransferSettings(side_px=None, neighbours=1))
    while next(stream, None) is not None:
        assert model.unet.attn_processors != before
        held.append(sum(picture() is not None for picture in pictures))
    assert len(held) == 8 and max(held) <= 4  # this view, the last one made, and both ends of what is done
    gc.collect()
    assert not any(picture() is not None for picture in pictures) and model.unet.attn_processors == before


class LevelGround:
    """Estimator of normals that point up everywhere."""

    def normals(self, image, camera):
        assert image.shape[:2] == (camera.height, camera.width)
        return np.broadcast_to(np.float32([0, 0, 1]), image.shape)


def test_normals_guide_it_from_the_view_or_an_estimator(model, views):
    ground = replace(views[0], normals=np.broadcast_to(np.float32([0, 0, 1]), (HEIGHT, WIDTH, 3)))
    guided, without = (
        images(model, [ground], TransferSettings(side_px=None, normals=normals))["left"]
        for normals in ("depth", "none")
    )
    assert np.abs(guided - without).max() > 0.01
    unknown = replace(ground, normals=np.zeros((HEIGHT, WIDTH, 3), np.float32))
    assert np.array_equal(images(model, [unknown])["left"], without)
    (estimated,) = transferred(model, views[:1], TransferSettings(side_px=None, normals="dsine"), LevelGround())
    assert np.array_equal(estimated.image, guided)


def test_views_without_poses_and_without_overlap_are_translated_alone_and_noted(model, views):
    def notes(views, settings=MUTUAL):
        return {each.clear.name: each.left_out for each in transferred(model, views, settings)}

    blind = [replace(view, has_pose=False) for view in views]
    assert notes(blind) == dict.fromkeys(("left", "center", "right"), WITHOUT_POSE)
    assert notes([*views[:2], blind[2]]) == {"left": "", "center": "", "right": WITHOUT_POSE}
    assert notes([views[0], replace(wall("far", 500.0), time_s=1.0)]) == {"left": NO_OVERLAP, "far": NO_OVERLAP}
    assert notes(blind[:1]) == {"left": ""} and set(notes(blind, ALONE).values()) == {""}
    alone = images(model, views, ALONE)
    assert all(np.array_equal(image, alone[name]) for name, image in images(model, blind).items())
