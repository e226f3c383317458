"""Sets of images for fine-tuning: sources by weather, the split, framing, guides."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.appearance.finetune.dataset import (
    ConditioningImages,
    ImageSettings,
    ImageSource,
    open_images,
)
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.scene.camera import Camera

INTRINSICS = "K_cam:\n16 0 8\n0 16 6\n0 0 1\ndistortion:\n0 0 0 0 0\n"


def save(file, seed=0, size=(16, 12)):
    file.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    Image.fromarray(pixels).save(file, quality=95)


def name_of(number):
    return f"{number:08x}-{number * 7919 % 2**32:08x}"


@pytest.fixture(scope="module")
def bdd100k(tmp_path_factory):
    """150 clear and 145 rainy frames by day, and some that nobody wants."""
    folder = tmp_path_factory.mktemp("bdd100k")
    weathers = ["clear"] * 150 + ["rainy"] * 145 + ["snowy"] * 3 + ["undefined"] * 2
    labels = []
    for number, weather in enumerate(weathers):
        save(folder / "images" / f"{name_of(number)}.jpg", number)
        labels.append({"name": f"{name_of(number)}.jpg", "attributes": {"weather": weather, "timeofday": "daytime"}})
    for row in labels[:4]:
        row["attributes"]["timeofday"] = "night"
    (folder / "det_train.json").write_text(json.dumps(labels))
    return folder


@pytest.fixture(scope="module")
def rainsense(tmp_path_factory):
    """Four sequences of 12 frames: one dry, three in rain."""
    folder = tmp_path_factory.mktemp("rainsense")
    for case, intensity in enumerate((0.0, 1.376, 4.75, 9.245)):
        place = folder / f"rain_{case}" / "scene_0" / "case_000"
        count = 12 if case else 30
        for number in range(count):
            save(place / "image" / f"image_{number:03d}.jpg", 100 * case + number)
        (place / "context").mkdir()
        (place / "context" / "camera_intrinsics.txt").write_text(INTRINSICS)
        (place / "context" / "rainfall_intensity.txt").write_text(f"{intensity}\n")
        rows = "".join(f"{0.1 * number:.3f},{number}\n" for number in range(count))
        (place / "timestamps.txt").write_text(f"timestamps,index\n{rows}")
    return folder


def settings(clear, rainy, **changes):
    def source(path, weather, count):
        return ImageSource(path=str(path), weather=weather, count=count)

    values = {"width_px": 16, "height_px": 16, "guide": "none"} | changes
    return ImageSettings(
        clear=tuple(source(path, "clear", count) for path, count in clear),
        rainy=tuple(source(path, "rainy", count) for path, count in rainy),
        **values,
    )


def test_composition_of_the_papers_table(bdd100k, rainsense):
    both = ((rainsense, 22), (bdd100k, 139))
    split = open_images(settings(both, both))
    assert [(look, count) for _, look, count, _ in split.table] == [
        ("clear", 22), ("clear", 139), ("rainy", 22), ("rainy", 139),
    ]  # fmt: skip
    for train, test in ((split.train.source, split.test.source), (split.train.target, split.test.target)):
        assert (len(train), len(test)) == (129, 32)
        assert not {picture.name for picture in train} & {picture.name for picture in test}
        assert len({picture.name for picture in train + test}) == 161


def test_seed_alone_decides_the_split_and_night_and_other_weather_are_left_out(bdd100k):
    def tested(seed):
        split = open_images(settings([(bdd100k, 20)], [(bdd100k, 20)], seed=seed))
        return {picture.name for picture in split.test.source}

    assert tested(3) == tested(3) != tested(4)
    split = open_images(settings([(bdd100k, None)], [(bdd100k, None)], test_share=0.0))
    assert (len(split.train.source), len(split.train.target)) == (146, 145)


def test_pictures_are_framed(tmp_path):
    stripes = np.zeros((20, 40, 3), np.uint8)
    stripes[:, 10:30, 0] = 255
    for look in ("clear", "rainy"):
        (tmp_path / look).mkdir()
        Image.fromarray(stripes).save(tmp_path / look / "stripes.png")
    sources = {look: (ImageSource(path=str(tmp_path / look)),) for look in ("clear", "rainy")}
    size = {"width_px": 16, "height_px": 16, "guide": "none", "test_share": 0.0}
    stretched, cropped = (
        open_images(ImageSettings(**sources, **size, framing=framing)).train.source[0].read()[0]
        for framing in ("stretch", "crop")
    )
    assert stretched.shape == cropped.shape == (16, 16, 3)
    assert stretched.dtype == np.float32
    np.testing.assert_allclose(stretched[..., 0].mean(), 0.5, atol=0.01)
    np.testing.assert_allclose(cropped[..., 0], 1.0, atol=0.01)


class Upward:
    """Estimates level ground everywhere; counts how often it is asked."""

    asked = 0

    def normals(self, image, camera):
        self.asked += 1
        return np.broadcast_to(np.float32([0, 0, 1]), image.shape)


def test_guides_come_from_normals_then_depth_then_an_estimator_once(tmp_path):
    wall = np.tile(np.float32([1, 0, 0]), (12, 16, 1))
    bare = CaptureFrame("v", Camera(16, 12, 10, 10, 8, 6), np.zeros((12, 16, 3), np.uint8))
    flat = replace(bare, depth_source=np.full((12, 16), 5, np.float32))  # its camera looks along z: a floor from above
    estimator = Upward()
    guides = ConditioningImages("up", estimator, "upward", tmp_path / "guides")
    assert not guides(replace(flat, normals_source=wall)).any()
    assert (guides(flat)[4:8, 6:10] < -0.9).all() and estimator.asked == 0
    first, cached = guides(bare), guides(bare)
    assert (first == 1).all() and np.array_equal(first, cached) and estimator.asked == 1
    (file,) = (tmp_path / "guides").iterdir()
    file.write_bytes(b"damaged")
    assert np.array_equal(guides(bare), first) and estimator.asked == 2
    assert ConditioningImages("up")(bare) is None
