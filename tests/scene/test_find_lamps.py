"""Lamps that are found in a scene: their places and light by night, and none by day."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.scene.find_lamps import find_lamps
from gsrain_engine.scene.lamp_choice import lamp_choice
from gsrain_engine.scene.open import load_built_in
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from gsrain_engine.scene.transforms import with_wetness_baked
from night_scene import COLOR, INTENSITY_M2, LANTERN_M, bulb, cluster, in_half_meters, night_scene
from small_scene import small_scene


@pytest.mark.parametrize("half_meters", [False, True])
def test_a_lantern_is_found_with_its_place_light_and_color(half_meters) -> None:
    scene = in_half_meters(night_scene()) if half_meters else night_scene()
    found = find_lamps(scene)
    assert len(found) == 1  # neither the window, nor the stars, nor the lit ground
    lit = scene.lamps_at(0.0, found)
    assert np.linalg.norm(lit.positions_m[0] - LANTERN_M) < 0.1
    # The albedo is not known: 0.12 is assumed, and the yard has 0.15.
    assert 0.8 * INTENSITY_M2 < found[0].intensity_m2 < 1.6 * INTENSITY_M2
    np.testing.assert_allclose(found[0].color, COLOR, atol=0.05)
    np.testing.assert_allclose(lit.directions[0], [0.0, 0.0, -1.0], atol=1e-6)


def test_light_is_shared_between_lanterns() -> None:
    lamps = ((LANTERN_M, 120.0), (np.array([-5.0, -4.0, 5.0]), 60.0), (np.array([2.0, 1.0, 1.0]), 0.0))
    found = find_lamps(night_scene(lamps))
    assert len(found) >= 2
    for place, intensity in lamps[:2]:
        (lamp,) = [each for each in found if np.linalg.norm(each.position - place) < 0.1]
        assert 0.75 * intensity < lamp.intensity_m2 < 1.7 * intensity
    unlit = [each.intensity_m2 for each in found if np.linalg.norm(each.position - lamps[2][0]) < 0.1]
    assert sum(unlit) < 5  # a white spot that throws no light


def test_a_lamp_above_nothing_counts_as_clipped() -> None:
    dark = cluster(
        np.random.default_rng(1).uniform(-40, -20, (500, 3)), np.full((500, 3), 0.3), np.full((500, 3), 0.003)
    )
    scene = Scene("", (Layer("far", dark), Layer("lamp", bulb(LANTERN_M))))
    dim = Scene("", (Layer("far", dark), Layer("lamp", bulb(LANTERN_M, (0.85, 0.5, 0.2)))))
    (clipped,), (colored,) = find_lamps(scene), find_lamps(dim)
    assert 0.005 < clipped.intensity_m2 / 300 < 0.2  # m2 of its outline
    assert colored.intensity_m2 == pytest.approx(0.85 * clipped.intensity_m2 / 300, rel=0.01)
    np.testing.assert_allclose(colored.color, np.array([0.85, 0.5, 0.2]) / 0.85, atol=0.01)


def test_lamps_of_actors_follow_their_tracks() -> None:
    body = cluster(np.random.default_rng(2).uniform(-1, 1, (300, 3)), np.full((300, 3), 0.1), np.full((300, 3), 0.004))
    lights = [bulb(np.array([-2.0, y, 0.8]), (0.9, 0.03, 0.02)) for y in (-0.7, 0.7)]
    lights += [bulb(np.array([2.0, y, 0.6])) for y in (-0.7, 0.7)]
    times = np.array([0.0, 10.0])
    track = PoseTrack(times, np.array([[0.0, 0, 0], [50, 0, 0]]), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    gaussians = type(body).concatenate([body, *lights])
    scene = replace(night_scene(), actors=(Actor("car", "car", (4.0, 2.0, 1.5), gaussians, track),))
    found = [lamp for lamp in lamp_choice("auto").of(scene) if lamp.mount == "car"]
    assert sorted((lamp.intensity_m2, lamp.direction[0]) for lamp in found) == [(1, -1), (1, -1), (400, 1), (400, 1)]
    assert all(lamp.color[1] < 0.1 for lamp in found if lamp.intensity_m2 == 1)
    moved = scene.lamps_at(4.0, found).positions_m - scene.lamps_at(0.0, found).positions_m
    np.testing.assert_allclose(moved, np.tile([20.0, 0, 0], (4, 1)), atol=1e-9)


def test_there_are_none_by_day() -> None:
    street = load_built_in()
    overcast = with_wetness_baked(street, 1.0)
    assert find_lamps(street) == find_lamps(overcast) == find_lamps(small_scene()) == find_lamps(Scene("")) == ()
    lit = replace(small_scene(), layers=(*small_scene().layers, Layer("lamp", bulb(LANTERN_M))))
    assert find_lamps(lit) == ()
    ground = night_scene().layers[0]
    assert find_lamps(Scene("", (ground,))) == ()


def test_the_lanterns_of_the_street_by_night_are_found() -> None:
    street = load_built_in("street:night")
    found = find_lamps(street)
    lanterns = [lamp for lamp in street.lamps if lamp.name.startswith("lantern")]
    others = [each for each in found if each.mount == "scene"]
    for lantern in lanterns:
        (lamp,) = [each for each in others if np.linalg.norm(np.subtract(each.position, lantern.position)) < 0.1]
        assert 0.6 < lamp.intensity_m2 / lantern.intensity_m2 < 1.4  # asphalt has 0.1, not 0.12; trees shade it
        np.testing.assert_allclose(lamp.color, lantern.color, atol=0.08)
        others.remove(lamp)
    assert len(lanterns) == 8
    assert all(each.intensity_m2 < 100 for each in others)
    assert [each.intensity_m2 for each in found if each.mount == "lead"].count(400.0) == 2
