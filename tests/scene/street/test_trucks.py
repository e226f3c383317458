"""Lorries at the kerbs of the built-in street."""

import numpy as np
import pytest

from gsrain_engine.scene.street.build import StreetSurfaces, parked_boxes, street_surfaces
from gsrain_engine.scene.street.cars import TRUCK_FORM
from gsrain_engine.scene.street.layout import Label, StreetParameters, plan_street
from gsrain_engine.scene.street.trucks import build_truck


def test_a_lorry_fills_its_box_and_stands_on_the_ground():
    form = TRUCK_FORM
    truck = build_truck(plan_street(StreetParameters()).trucks[0])
    assert set(np.unique(truck.labels)) == {Label.TRUCK}
    low, high = truck.corners.min(axis=(0, 1)), truck.corners.max(axis=(0, 1))
    np.testing.assert_allclose(high[0] - low[0], form.length, atol=0.12)
    np.testing.assert_allclose([high[2], low[2]], [form.height, 0], atol=0.02)
    np.testing.assert_allclose(0.5 * (low + high)[:2], 0, atol=0.05)
    assert np.abs(truck.corners[..., 1]).max() < 0.5 * form.width + 0.2  # mirrors


def test_a_lorry_is_the_same_on_both_sides():
    truck = build_truck(plan_street(StreetParameters()).trucks[0])
    at = truck.centers[(truck.centers[:, 2] > 1.0) & (np.abs(truck.centers[:, 1]) > 0.3)]
    left, right = at[at[:, 1] > 0], at[at[:, 1] < 0] * [1, -1, 1]
    assert len(left) == len(right) > 500
    away = np.abs(left[:, None] - right[None]).max(axis=2).min(axis=1)
    assert (away < 0.02).mean() > 0.97  # the locks of the doors are not


def test_outer_walls_face_outwards():
    form = TRUCK_FORM
    truck = build_truck(plan_street(StreetParameters()).trucks[0])
    at, normals = truck.centers, truck.normals
    flank = (
        (np.abs(np.abs(at[:, 1]) - 0.5 * form.width) < 1e-3) & (at[:, 2] > form.floor) & (at[:, 0] < form.body_front)
    )
    assert flank.sum() > 200
    assert (at[flank, 1] * normals[flank, 1] > 0).all()
    rear = (np.abs(at[:, 0] - form.body_back) < 1e-3) & (at[:, 2] > form.floor)
    assert (normals[rear, 0] < -0.99).all()
    ahead = (at[:, 0] > 0.5 * form.length - 0.25) & (np.abs(at[:, 1]) < 0.6) & (at[:, 2] > 0.5) & (at[:, 2] < 2.0)
    assert (normals[ahead, 0] > 0.5).mean() > 0.9


def test_lorries_are_seen_from_behind_and_from_ahead():
    trucks = plan_street(StreetParameters()).trucks
    p = StreetParameters()
    drive = p.ego_speed_m_s * p.drive_seconds
    ways = {truck.turn_deg for truck in trucks if 10 < truck.x < drive}
    assert ways == {0.0, 180.0}
    for truck in trucks:
        assert (truck.y < 0) == (truck.turn_deg == 0.0)  # traffic keeps to the right


@pytest.mark.parametrize(
    "parameters",
    [
        StreetParameters(),
        StreetParameters(seed=3, length_m=120.0, tree_spacing_m=40.0),
        StreetParameters(seed=11, tree_spacing_m=8.0, parked_share=1.0),
        StreetParameters(seed=12, parking_width_m=2.6, pavement_width_m=2.5, parked_share=0.9),
    ],
)
def test_nothing_stands_where_a_lorry_stands(parameters):
    surfaces = street_surfaces(parameters)
    trucks = [box for box in parked_boxes(parameters) if box.class_name == "truck"]
    for box in trucks:
        length, width, height = box.size_lwh
        to_box = np.linalg.inv(box.to_street)
        for name, quads in surfaces.layers.items():
            if name in ("road", "pavements", "sky", box.layer):
                continue
            local = quads.centers @ to_box[:3, :3].T + to_box[:3, 3]
            inside = (np.abs(local[:, :2]) < [0.5 * length - 0.1, 0.5 * width - 0.1]).all(axis=1)
            inside &= local[:, 2] < height - 0.1
            assert not inside.any(), (name, box.id)


def test_a_lorry_darkens_the_ground_below_and_beside_it(surfaces: StreetSurfaces):
    truck = next(each for each in surfaces.layout.trucks if each.y > 0)  # the sun is on the left
    light, road = surfaces.light, surfaces.layers["road"]
    at = road.centers
    shown = light.display_colors(road, at).mean(axis=1)
    asphalt = road.labels == Label.ROAD
    ahead = asphalt & (np.abs(at[:, 0] - truck.x) < 2.5)
    below = ahead & (np.abs(at[:, 1] - truck.y) < 0.7)
    beside = asphalt & (np.abs(at[:, 1] - truck.y) < 0.7) & (np.abs(at[:, 0] - truck.x) > 6) & (at[:, 0] < truck.x + 8)
    beside &= at[:, 0] > truck.x - 8
    assert shown[below].mean() < 0.6 * shown[beside].mean()


def test_nobody_parks_where_nobody_may():
    assert plan_street(StreetParameters(parked_share=0.0)).trucks == ()
