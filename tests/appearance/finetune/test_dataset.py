"""Sets of images for fine-tuning: sources by weather, the split, framing, guides."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.appearance.finetune.dataset import ConditioningImages, ImageSettings, ImageSource, open_images
from gsrain_engine.datasets.capture import CaptureError, CaptureFrame
from gsrain_engine.scene.camera import Camera

INTRINSICS = "K_cam:\n16 0 8\n0 16 6\n0 0 1\ndistortion:\n0 0 0 0 0\n"


def save(file, seed=0):
    file.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(file, quality=95)


@pytest.fixture(scope="module")
def bdd100k(tmp_path_factory):
    """150 clear and 145 rainy frames, 4 of them at night, and others."""
    folder = tmp_path_factory.mktemp("bdd100k")
    weathers = ["clear"] * 150 + ["rainy"] * 145 + ["snowy"] * 3 + ["undefined"] * 2
    labels = []
    for number, weather in enumerate(weathers):
        name = f"{number:08x}-{number * 7919 % 2**32:08x}.jpg"
        save(folder / "images" / name, number)
        time = "night" if number < 4 else "daytime"
        labels.append({"name": name, "attributes": {"weather": weather, "timeofday": time}})
    (folder / "det_train.json").write_text(json.dumps(labels))
    return folder


@pytest.fixture(scope="module")
def rainsense(tmp_path_factory):
    """Four sequences: one dry, three in rain."""
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


def settings(sources, **changes):
    looks = {
        look: tuple(ImageSource(path=str(path), weather=look, count=count) for path, count in sources)
        for look in ("clear", "rainy")
    }
    return ImageSettings(**(looks | {"width_px": 16, "height_px": 16, "guide": "none"} | changes))


def test_the_papers_table_is_composed_and_split_by_the_seed_alone(bdd100k, rainsense):
    split, same, other = (open_images(settings([(rainsense, 22), (bdd100k, 139)], seed=seed)) for seed in (3, 3, 4))
    counts = [(look, count) for _, look, count, _ in split.table]
    assert counts == [("clear", 22), ("clear", 139), ("rainy", 22), ("rainy", 139)]
    assert split.problems == ()  # not even that RainSense's sequences share no world
    for train, test in ((split.train.source, split.test.source), (split.train.target, split.test.target)):
        assert (len(train), len(test)) == (129, 32) and len({picture.name for picture in train + test}) == 161
    tested = [{picture.name for picture in each.test.source} for each in (split, same, other)]
    assert tested[0] == tested[1] != tested[2]


def test_night_and_other_weather_are_left_out_and_missing_pictures_are_named(bdd100k, tmp_path):
    split = open_images(settings([(bdd100k, None)], test_share=0.0))
    assert (len(split.train.source), len(split.train.target)) == (146, 145)
    save(tmp_path / "plain" / "0.png")
    for sources, changes, name in (
        ([(bdd100k, 147)], {}, "147 is more than its 146 clear pictures by day; .*: count 147 .* 145 rainy pictures"),
        ([(bdd100k, 146)], {}, "^[^;]*: count 146 is more than its 145 rainy pictures by day$"),
        ([(tmp_path / "plain", 1)], {}, "weather"),
        ([(bdd100k, 1)], {"test_share": 0.9}, "test_share"),
    ):  # fmt: skip
        with pytest.raises(CaptureError, match=name):
            open_images(settings(sources, **changes))


@pytest.mark.parametrize(("framing", "red"), [("stretch", 0.5), ("crop", 1.0)])
def test_pictures_are_framed(tmp_path, framing, red):
    stripes = np.zeros((20, 40, 3), np.uint8)
    stripes[:, 10:30, 0] = 255
    Image.fromarray(stripes).save(tmp_path / "stripes.png")
    sources = dict.fromkeys(("clear", "rainy"), (ImageSource(path=str(tmp_path)),))
    (picture,) = open_images(settings([], **sources, test_share=0.0, framing=framing)).train.source
    image, guide = picture.read()
    assert image.shape == (16, 16, 3) and image.dtype == np.float32 and guide is None
    assert image[..., 0].mean() == pytest.approx(red, abs=0.01)


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
