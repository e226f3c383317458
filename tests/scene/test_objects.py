"""The things in a scene that have a class and a box."""

from dataclasses import replace

import numpy as np
import pytest

from boxy_scene import boxy_scene
from gsrain_engine.scene.objects import COCO_CATEGORIES, scene_objects
from gsrain_engine.scene.open import load_street
from gsrain_engine.scene.street.layout import StreetParameters, plan_street


@pytest.fixture(scope="module")
def street():
    return load_street()


def test_the_street_has_its_lead_car_and_every_parked_vehicle(street):
    objects = scene_objects(street)
    layout = plan_street(StreetParameters())
    cars, trucks = layout.cars, layout.trucks
    assert [each.id for each in objects] == [
        "lead", *(f"parked-{k:02d}" for k in range(len(cars))), *(f"truck-{k:02d}" for k in range(len(trucks)))
    ]  # fmt: skip
    assert [each.class_name for each in objects] == ["car"] * (1 + len(cars)) + ["truck"] * len(trucks)
    assert len(trucks) >= 2
    parked = objects[1:]
    for kind, count in (("cars", len(cars)), ("trucks", len(trucks))):
        own = [each.rows for each in parked if each.member == f"layers/parked {kind}"]
        rows = np.concatenate(own)
        assert len(own) == count
        assert len(np.unique(rows)) == len(rows)
        assert len(rows) > 0.98 * len(street.member(f"layers/parked {kind}").gaussians)
    for each, car in zip(parked, (*cars, *trucks), strict=True):
        middle = street.member(each.member).gaussians.means[each.rows][:, :2].mean(axis=0)
        np.testing.assert_allclose(middle, (car.x, car.y), atol=0.9)
        np.testing.assert_allclose(each.track.pose(3.0)[:2, 3], (car.x, car.y))


def test_the_shadow_that_a_car_carries_along_is_not_the_car(street):
    lead = street.actors[0]
    rows = scene_objects(street)[0].rows
    left_out = np.delete(np.arange(len(lead.gaussians)), rows)
    assert len(left_out) > 100
    np.testing.assert_allclose(lead.gaussians.means[left_out, 2], 0.06, atol=1e-3)
    assert lead.gaussians.opacities[left_out].max() < 0.6
    assert lead.gaussians.opacities[rows].min() > 0.5


def test_another_street_has_no_known_parked_vehicles(street):
    cars, trucks = street.member("layers/parked cars"), street.member("layers/parked trucks")
    moved = replace(cars.gaussians, means=cars.gaussians.means + np.float32([3, 0, 0]))
    elsewhere = street.with_member(cars.key, gaussians=moved)
    assert {each.member for each in scene_objects(elsewhere)} == {"actors/lead", trucks.key}
    assert len(scene_objects(replace(street, name="mine"))) == 1
    unseen = street.with_member(cars.key, visible=False)
    assert {each.class_name for each in scene_objects(unseen)} == {"car", "truck"}
    assert len(scene_objects(unseen.with_member(trucks.key, visible=False))) == 1


def test_actors_are_objects_while_they_can_be_seen():
    scene = boxy_scene()
    assert [each.class_name for each in scene_objects(scene)] == ["Car", "Car"]
    assert len(scene_objects(scene.with_member("actors/far", visible=False))) == 1


def test_category_ids_are_those_of_coco_2017():
    known = {"person": 1, "car": 3, "truck": 8, "stop sign": 13, "umbrella": 28, "skis": 35, "dining table": 67}
    assert {name: COCO_CATEGORIES[name] for name in known} == known
    assert (len(COCO_CATEGORIES), COCO_CATEGORIES["tv"], COCO_CATEGORIES["toothbrush"]) == (80, 72, 90)
