"""Attribution of what rain does to detectors: conditions of coalitions, shares and the sum of them, drop sizes."""

import numpy as np
import pytest
from msgspec import structs

from appearance.sunny_street import capture_of, street_photo
from boxy_scene import boxy_scene
from evaluation.detection.test_run import AHEAD, SKY, Oracle
from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.appearance.scene_views import PlacedCamera
from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.evaluation.detection.attribution import (
    drop_size_figure,
    drop_size_scores,
    rain_attributions,
    size_variant,
)
from gsrain_engine.evaluation.detection.run import (
    Condition,
    ConditionRenderer,
    RainVariant,
    evaluate_images,
    recorded_frames,
    scene_frames,
)
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.rig import rig_camera

RAIN = RainSettings(glass="lens", glass_wet_s=2.0)
SEEDS = (0, 1)


@pytest.fixture(scope="module")
def scene():
    return boxy_scene()


@pytest.fixture(scope="module")
def frame(scene):
    camera = rig_camera(scene, "one", "FRONT", 0.0).resized(144, 96)
    return scene_frames(CpuRenderer(), scene, [PlacedCamera("first", camera)])[0]


def evaluated(pictures, frame, conditions):
    images = evaluate_images(pictures, [Oracle(frame.truths)], [frame], conditions)
    return [each.judgements["oracle"] for each in images]


def test_shares_of_all_objects_and_of_each_sum_to_the_whole_effect(scene, frame):
    (part,) = rain_attributions(RAIN, ("all",), "boxy", scene, (0.0, 50.0), SEEDS, in_front=False)
    assert part.factors.names == ("streaks", "medium", "glass")  # this scene has no wet colors
    own = RainVariant(RAIN, scene, SKY)
    pictures = ConditionRenderer(CpuRenderer(), scene, RAIN, SKY, variants=part.variants(own, None))
    clear = Condition("clear", 0.0, SEEDS)
    results = evaluated(pictures, frame, [clear, *part.conditions])
    assert len(part.conditions) == 1 + 7 * 2
    assert [title for title, _ in part.steps] == ["without rain", "+ streaks", "+ medium", "+ glass"]
    assert {each for _, each in part.steps} <= set(part.conditions)
    found = part.attributed(results)
    objects = [each.measure.object for each in found if each.measure.name == "confidence"]
    counted = [f"{each.id} ({each.class_name})" for each in frame.truths if each.counts]
    assert objects == [None, *counted] and counted
    by_condition = {each.trial: each for each in results}
    for each in found:
        np.testing.assert_allclose(each.by_seed.sum(axis=1), each.rainy - each.without, atol=1e-12)
        plain = each.plain
        assert sum(share["mean"] for share in plain["shares"]) == pytest.approx(plain["whole"]["mean"], abs=1e-12)
    whole = found[0]
    rainy = [by_condition[Condition("rainy", 50.0, (seed,))].matches[0].confidence for seed in SEEDS]
    np.testing.assert_allclose(whole.rainy, rainy)  # the oracle is equally sure of all
    assert abs(whole.whole.value) > 1e-4 and all(abs(share.value) > 1e-5 for share in whole.shares.values())


def test_photographs_have_streaks_and_haze_before_them():
    photo = np.full((48, 64, 3), 40, np.uint8)
    photo[:16] = 200
    view = CaptureFrame("a", Camera(64, 48, 60.0, 60.0, 32.0, 24.0, AHEAD), photo)
    capture = Capture("drive", (view,))
    photos = CapturePhotos(capture)
    (frame,) = recorded_frames(photos.world, [PlacedCamera("a", view.camera)], capture, {"a": ()})
    rain = structs.replace(RAIN, exposure_s=0.05, streak_gain=5.0, glass="none")
    (part,) = rain_attributions(rain, ("all",), None, photos.world, (50.0,), (0,), in_front=True)
    assert part.factors.names == ("streaks", "medium")
    own = RainVariant(part.factors.rain, photos.world, SKY)
    pictures = ConditionRenderer(CpuRenderer(), photos.world, rain, SKY, photos, part.variants(own, None))
    assert part.conditions[0] == Condition("original", 0.0, (0,))
    levels = [pictures.take(frame, each)[20:].mean() for each in part.conditions]
    assert levels[0] == 40 and all(level > 40.01 for level in levels[1:]) and max(levels) == levels[-1]
    (part,) = rain_attributions(rain, ("streaks", "glass"), None, photos.world, (50.0,), (0,), in_front=True)
    assert part.factors.names == ("streaks", "glass")
    with pytest.raises(ValueError, match="has none"):
        rain_attributions(rain, ("wet",), None, photos.world, (50.0,), (0,), in_front=True)


def test_rain_that_can_not_be_taken_apart(scene):
    for rain, rates, words in (
        (RAIN, (0.0,), "above 0 mm/h"),
        (structs.replace(RAIN, streaks=False, haze="none", glass="none"), (0.0, 5.0), "no factors"),
    ):
        with pytest.raises(ValueError, match=words):
            rain_attributions(rain, ("all",), "boxy", scene, rates, SEEDS, in_front=False)


def test_drop_sizes_are_compared_at_the_same_rate(scene, frame):
    scales = (0.5, 1.0, 2.0)
    rain = RainSettings()
    variants = {size_variant(s): RainVariant(structs.replace(rain, diameter_scale=s), scene, SKY) for s in (0.5, 2.0)}
    pictures = ConditionRenderer(CpuRenderer(), scene, rain, SKY, variants=variants)
    rainy = [Condition("rainy", 50.0, (seed,)) for seed in (0, 1)]
    sizes = {s: [each._replace(variant="" if s == 1 else size_variant(s)) for each in rainy] for s in scales}
    clear = Condition("clear", 0.0, (0, 1))
    results = evaluated(pictures, frame, [clear, *(each for own in sizes.values() for each in own)])
    scores = drop_size_scores(results, rain, sizes)
    assert [each.diameter_scale for each in scores] == list(scales)
    assert scores[0].drops_per_m3 > 2 * scores[1].drops_per_m3 > 4 * scores[2].drops_per_m3
    assert scores[0].extinction_per_m > scores[1].extinction_per_m > scores[2].extinction_per_m
    assert len({each.change.value for each in scores}) == 3
    base = next(each for each in results if each.trial == clear).matches[0].confidence
    assert scores[2].change.value == pytest.approx(scores[2].confidence.value - base)
    assert drop_size_figure(scores).shape[2] == 3


def test_light_of_sunny_photographs_is_a_factor_where_it_is_softened():
    capture = capture_of(street_photo())
    photos = CapturePhotos(capture)
    (frame,) = recorded_frames(photos.world, [PlacedCamera("view 0", capture[0].camera)], capture, {"view 0": ()})
    rain = structs.replace(RAIN, glass="none")

    def attributed(intensity_mm_h, **changes):
        changed = structs.replace(rain, **changes)
        return rain_attributions(
            changed, ("all",), None, photos.world, (intensity_mm_h,), (0,), in_front=True, softens_light=True
        )[0]

    assert attributed(2.0).factors.names == attributed(8.0, keep_light=True).factors.names == ("streaks", "medium")
    part = attributed(8.0)
    assert part.factors.names == ("streaks", "medium", "light")
    own = RainVariant(part.factors.rain, photos.world, SKY)
    pictures = ConditionRenderer(CpuRenderer(), photos.world, rain, SKY, photos, part.variants(own, None))
    blue = {each.variant: np.ptp(pictures.take(frame, each)[:20].mean(axis=(0, 1))) for each in part.conditions}
    assert blue["light"] < 15 and blue["streaks+light"] < 15 and blue["streaks+medium"] > 40
    assert pictures.lights([frame], 8.0) == {"softened to overcast": 1}
