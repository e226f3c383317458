"""The built-in street as a scene: its name, its objects and its lanes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from boxy_scene import boxy_scene
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.objects import scene_objects
from gsrain_engine.scene.open import is_built_in, load_built_in, load_scene
from gsrain_engine.simulation.geometry import PlanarBox
from gsrain_engine.simulation.ground import road_surface_of
from gsrain_engine.simulation.obstacles import drivable_of, occupied_space_of
from gsrain_extras.street.build import OBJECT_LAYERS
from gsrain_extras.street.layout import StreetParameters, plan_street
from gsrain_extras.street.signals import signal_heads
from small_scene import small_scene


def test_the_street_is_built_in_unless_a_scene_is_called_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert is_built_in(None) and is_built_in("street") and not is_built_in("road")
    write_scene(small_scene("own"), tmp_path / "street" / "scene")  # as the command `street` writes it
    (tmp_path / "street" / "meta.json").write_text("{}")  # none of SOG
    assert is_built_in("street") and not is_built_in("street/scene")
    for name in ("meta.json", "scene.json"):
        (tmp_path / "street" / name).write_text('{"means": {}}')
        assert not is_built_in("street")
        (tmp_path / "street" / name).unlink()
    (tmp_path / "street").rename(tmp_path / "other")
    write_scene(small_scene("own"), tmp_path / "street")
    assert not is_built_in("street") and load_scene("street").name == "own"


def test_objects_of_the_street_are_its_lead_car_its_vehicles_people_and_traffic_lights() -> None:
    street, layout = load_built_in(), plan_street(StreetParameters())
    objects = scene_objects(street)
    vehicles = [(f"parked-{k:02d}", "car", each) for k, each in enumerate(layout.cars)]
    vehicles += [(f"truck-{k:02d}", "truck", each) for k, each in enumerate(layout.trucks)]
    vehicles += [(f"bus-{k:02d}", "bus", each) for k, each in enumerate(layout.buses)]
    people = [*layout.pedestrians, *layout.cyclists]
    vehicles += [(f"person-{k:02d}", "person", each) for k, each in enumerate(people)]
    vehicles += [(f"bicycle-{k:02d}", "bicycle", each) for k, each in enumerate(layout.cyclists)]
    vehicles += [(f"traffic-light-{k:02d}", "traffic light", each) for k, each in enumerate(signal_heads(layout))]
    assert [(each.id, each.class_name) for each in objects[1:]] == [row[:2] for row in vehicles]
    assert len(layout.buses) == 1 and len(people) >= 7 and len(layout.cyclists) == 1
    for each, (_, _, vehicle) in zip(objects[1:], vehicles, strict=True):
        middle = street.member(each.member).gaussians.means[each.rows][:, :2].mean(axis=0)
        np.testing.assert_allclose(middle, (vehicle.x, vehicle.y), atol=1.2)
        np.testing.assert_allclose(each.track.pose(3.0)[:2, 3], (vehicle.x, vehicle.y))
    for name in OBJECT_LAYERS:
        rows = np.concatenate([each.rows for each in objects if each.member == f"layers/{name}"])
        assert len(np.unique(rows)) > 0.98 * len(street.member(f"layers/{name}").gaussians)
        assert len(np.unique(rows)) == len(rows) or name in ("pedestrians", "traffic lights")  # some stand close
    lead = street.actors[0].gaussians
    shadow = np.delete(np.arange(len(lead)), objects[0].rows)
    assert objects[0].id == "lead" and len(shadow) > 100
    np.testing.assert_allclose(lead.means[shadow, 2], 0.06, atol=1e-3)
    assert lead.opacities[shadow].max() < 0.6 and lead.opacities[objects[0].rows].min() > 0.5
    cars = street.member("layers/parked cars")
    moved = replace(cars.gaussians, means=cars.gaussians.means + np.float32([3, 0, 0]))
    elsewhere = street.with_member(cars.key, gaussians=moved)  # of another street
    assert {each.member for each in scene_objects(elsewhere)} == {each.member for each in objects} - {cars.key}
    assert len(scene_objects(replace(street, name="mine"))) == 1
    hidden = street
    for name in OBJECT_LAYERS:
        hidden = hidden.with_member(f"layers/{name}", visible=False)
    assert len(scene_objects(hidden)) == 1
    assert len(scene_objects(boxy_scene().with_member("actors/far", visible=False))) == 1


def car_at(x: float, y: float, yaw: float = 0.0) -> PlanarBox:
    return PlanarBox(x, y, yaw, 4.6, 1.85)


def test_the_streets_lanes_are_free_and_drivable_and_everything_that_stands_on_it_is_hit():
    street = load_built_in()
    space = occupied_space_of(street, road_surface_of(street))
    layout = plan_street(StreetParameters())
    for time_s in np.arange(0.0, 12.01, 0.05):
        pose = street.ego_to_world(float(time_s))
        assert not space.touches(car_at(pose[0, 3] + 1.3, pose[1, 3])), time_s
    pavement = layout.parameters.curb_y_m + 1.9
    free = [not space.touches(PlanarBox(float(x), pavement, 0.0, 1.0, 1.0)) for x in np.arange(0.0, 120.0)]
    assert np.mean(free) > 0.95
    for each in (*layout.cars, *layout.trucks):
        assert space.touches(PlanarBox(each.x, each.y - 1.2 * np.sign(each.y), 0.0, 4.0, 1.0)), each
    for each in (*layout.trees, *layout.lamps):
        x, y = (each.x, each.y) if hasattr(each, "x") else each[:2]
        assert space.touches(PlanarBox(x, y, 0.0, 0.6, 0.6)), each
    fronts = layout.parameters.front_y_m
    assert all(space.touches(PlanarBox(x, s * fronts, 0.0, 4.0, 1.0)) for x in range(0, 120, 5) for s in (-1, 1))
    drivable, curb = drivable_of(street, road_surface_of(street), space), layout.parameters.curb_y_m
    np.testing.assert_array_equal(drivable.share_on_road(car_at(30.0, -1.7)), np.ones((2, 2)))
    np.testing.assert_array_equal(drivable.share_on_road(car_at(30.0, -curb - 1.5)), np.zeros((2, 2)))
    half, turned = (drivable.share_on_road(car_at(30.0, -curb, yaw)) for yaw in (0.0, np.pi / 2))
    assert (half[:, 0] > 0.9).all() and (half[:, 1] < 0.25).all()
    assert (turned[0] > 0.9).all() and (turned[1] < 0.25).all()
