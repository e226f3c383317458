"""The built-in street: its meshes and Gaussians, what stands where, its light, its vehicles and its cameras."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.camera import look_at
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.geometry import matrices_from_quaternions
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.street.build import (
    SH_C1,
    Daylight,
    StreetSurfaces,
    build_street,
    displayed_colors,
    parked_boxes,
    quads_to_gaussians,
    scene_of,
    street_surfaces,
)
from gsrain_engine.scene.street.cars import TRUCK_FORM
from gsrain_engine.scene.street.layout import CURB_HEIGHT_M, Label, StreetParameters, plan_street
from gsrain_engine.scene.street.mesh import Quads, box, even_lines, graded_lines, panel, tube
from gsrain_engine.scene.street.trucks import build_truck

from ..formats.sample_files import assert_valid


@pytest.fixture(scope="module")
def surfaces() -> StreetSurfaces:
    return street_surfaces()


@pytest.fixture(scope="module")
def street(surfaces: StreetSurfaces) -> Scene:
    return scene_of(surfaces)


def _layer(scene: Scene, name: str) -> Gaussians:
    return next(layer.gaussians for layer in scene.layers if layer.name == name)


def test_the_same_parameters_give_the_same_sound_gaussians(street: Scene) -> None:
    assert 200_000 <= street.gaussian_count <= 410_000
    rebuilt = build_street()
    for each, same in zip(street.members, rebuilt.members, strict=True):
        assert_valid(each.gaussians)
        assert (each.gaussians.scales > 0).all() and (each.gaussians.opacities > 0).all()
        color = SH_C0 * each.gaussians.sh[:, 0] + 0.5
        assert color.min() > -0.5 and color.max() < 1.6
        for array, expected in zip(same.gaussians.arrays, each.gaussians.arrays, strict=True):
            assert array.tobytes() == expected.tobytes()


def test_layers_are_named_after_their_contents(street: Scene, surfaces: StreetSurfaces) -> None:
    names = ["road", "pavements", "houses", "trees", "parked cars", "parked trucks", "furniture", "surroundings", "sky"]
    assert [layer.name for layer in street.layers] == names
    assert [layer.name for layer in street.layers if layer.kind == "sky"] == ["sky"]
    for layer in street.layers:  # Gaussian i is quad i
        np.testing.assert_array_equal(layer.gaussians.means, surfaces.layers[layer.name].centers)


def test_road_is_level_and_its_gaussians_are_flat(street: Scene) -> None:
    road = _layer(street, "road")
    np.testing.assert_array_equal(road.means[:, 2], 0)
    upright = matrices_from_quaternions(road.quaternions)[:, 2, 2]
    np.testing.assert_allclose(np.abs(upright), 1, atol=1e-5)
    assert (road.scales[:, 2] < 0.05 * road.scales[:, 1]).all()


def test_road_has_no_holes_between_the_kerbs(surfaces: StreetSurfaces) -> None:
    p = surfaces.layout.parameters
    corners = surfaces.layers["road"].corners[..., :2]
    low, high = corners.min(axis=1), corners.max(axis=1)
    rng = np.random.default_rng(0)
    points = rng.uniform([p.start_x_m, -p.curb_y_m], [p.end_x_m, p.curb_y_m], (400, 2)).astype(np.float32)
    covered = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=2).sum(axis=1)
    assert (covered >= 1).all()


def test_markings_lie_where_a_driver_expects_them(surfaces: StreetSurfaces) -> None:
    p = surfaces.layout.parameters
    road = surfaces.layers["road"]
    at, painted = road.centers, road.labels == Label.LANE_MARKING
    middle = painted & (np.abs(at[:, 1]) < 0.05)
    free = np.min(np.abs(at[:, :1] - np.array(surfaces.layout.crossings)), axis=1) > 6
    assert (at[middle & free, 0] % 7.5 < 3.0).all()
    lane_middle = np.abs(at[:, 1] + 0.5 * p.lane_width_m) < 0.4
    assert not (painted & lane_middle & free).any()
    for c in surfaces.layout.crossings:
        on = (at[:, 0] > c) & (at[:, 0] < c + 3)
        assert 0.3 < painted[on].mean() < 0.6


def test_nothing_stands_in_the_lanes(surfaces: StreetSurfaces) -> None:
    p = surfaces.layout.parameters
    for name in ("houses", "trees", "parked cars", "parked trucks", "furniture", "pavements"):
        at = surfaces.layers[name].centers
        inside = (at[:, 0] > p.start_x_m + 0.5) & (at[:, 0] < p.end_x_m - 0.5) & (at[:, 2] < 2.4)
        assert np.abs(at[inside, 1]).min() > p.lane_width_m - 0.35, name


def test_sun_side_is_brighter(surfaces: StreetSurfaces, street: Scene) -> None:
    p = surfaces.layout.parameters
    houses, quads = _layer(street, "houses"), surfaces.layers["houses"]
    color = (SH_C0 * houses.sh[:, 0] + 0.5).mean(axis=1)
    high = (quads.centers[:, 2] > 5) & (quads.centers[:, 0] > 0) & (quads.centers[:, 0] < p.end_x_m)
    matte = high & (quads.gloss == 0)
    lit = matte & (quads.normals[:, 1] > 0.9) & (quads.centers[:, 1] < 0)
    shaded = matte & (quads.normals[:, 1] < -0.9) & (quads.centers[:, 1] > 0)
    assert color[lit].mean() > color[shaded].mean() + 0.15


def test_harmonics_of_degree_1_are_the_mirrored_sky(surfaces: StreetSurfaces) -> None:
    lead = surfaces.lead
    light = surfaces.lead_light
    glossy = lead.take(lead.gloss > 0.1)
    matte = light.display_colors(glossy, glossy.centers)
    direction = np.array([0.8, 0.36, -0.48])
    scene_sh = np.zeros((len(glossy), 3))
    sh = quads_to_gaussians(glossy, light).sh.astype(np.float64)
    x, y, z = direction
    for k, basis in enumerate((SH_C0, -SH_C1 * y, SH_C1 * z, -SH_C1 * x)):
        scene_sh += basis * sh[:, k]
    expected = displayed_colors(glossy, light, matte, np.tile(direction, (len(glossy), 1)))
    np.testing.assert_allclose(np.clip(scene_sh + 0.5, 0, 1), expected, atol=2e-5)


def test_a_mirror_that_looks_up_shows_more_light() -> None:
    light = Daylight.over(StreetParameters())
    constant, linear = light.gloss_of(np.array([[0.0, 0.0, 1.0]]))
    down = np.array([0.7, 0.0, -0.714])
    assert (constant + down @ linear[0] > constant).all()


def test_lead_car_stands_on_its_origin(street: Scene) -> None:
    (lead,) = street.actors
    length, width, height = lead.size_lwh
    body = lead.gaussians.means[lead.gaussians.opacities > 0.9]
    low, high = body.min(axis=0), body.max(axis=0)
    np.testing.assert_allclose(high[0] - low[0], length, atol=0.12)
    np.testing.assert_allclose(high[1] - low[1], width, atol=0.32)  # mirrors
    np.testing.assert_allclose([high[2], low[2]], [height, 0], atol=0.06)
    np.testing.assert_allclose(0.5 * (low + high)[:2], 0, atol=0.05)


def test_lead_keeps_ahead_of_the_ego(street: Scene) -> None:
    (lead,) = street.actors
    assert street.ego is not None
    gaps = lead.track.positions[:, 0] - street.ego.positions[:, 0]
    assert gaps[0] == pytest.approx(18)
    assert gaps.min() > 15
    speeds = np.diff(lead.track.positions[:, 0]) / np.diff(lead.track.times)
    assert speeds.mean() == pytest.approx(10, abs=0.3)
    assert 0.3 < np.ptp(speeds) < 2
    np.testing.assert_array_equal(lead.track.positions[:, 1], street.ego.positions[:, 1])


def test_ego_is_at_sensor_height_in_the_right_lane(street: Scene) -> None:
    pose = street.ego_to_world(2.0)
    assert pose is not None
    np.testing.assert_allclose(pose[:3, 3], [20, -1.7, 1.5], atol=1e-9)
    assert street.ground_m == 0


def test_rig_cameras_look_where_their_names_say(street: Scene) -> None:
    assert {name: len(rig) for name, rig in street.rigs.items()} == {"waymo_front3": 3, "nuscenes": 6}
    front = rig_camera(street, "waymo_front3", "FRONT", 1.0)
    left = rig_camera(street, "waymo_front3", "FRONT_LEFT", 1.0)
    back = rig_camera(street, "nuscenes", "CAM_BACK", 1.0)
    assert (front.width, front.height, front.exposure_s) == (1920, 1280, 0.004)
    np.testing.assert_allclose(front.camera_to_world[:3, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(front.camera_to_world[:3, 1], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(left.camera_to_world[:3, 2], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-12)
    np.testing.assert_allclose(back.camera_to_world[:3, 2], [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(front.position, [10 + 1.54, -1.7 - 0.02, 2.12], atol=1e-9)


def test_rig_cameras_that_are_not_there_are_named(street: Scene) -> None:
    with pytest.raises(ValueError, match="only waymo_front3, nuscenes"):
        rig_camera(street, "kitti", "FRONT", 0.0)
    with pytest.raises(ValueError, match="only FRONT, FRONT_LEFT, FRONT_RIGHT"):
        rig_camera(street, "waymo_front3", "BACK", 0.0)
    front = rig_camera(street, "nuscenes", "CAM_FRONT", 0.0)
    ahead = look_at(front.position, front.position + np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    np.testing.assert_allclose(front.world_to_camera, ahead, atol=1e-9)


def test_another_street_can_be_built() -> None:
    with pytest.raises(msgspec.ValidationError, match=r"length_m"):
        msgspec.convert({"length_m": 20.0}, StreetParameters)
    first, second = plan_street(StreetParameters()), plan_street(StreetParameters(seed=8))
    assert [house.width for house in first.left] != [house.width for house in second.left]
    changes = {"seed": 3, "length_m": 120.0, "pavement_width_m": 2.5, "parked_share": 0.0, "tree_spacing_m": 40.0}
    scene = build_street(msgspec.convert(changes, StreetParameters))
    assert scene.gaussian_count > 150_000
    assert _layer(scene, "pavements").means[:, 2].max() == pytest.approx(CURB_HEIGHT_M)
    assert len(_layer(scene, "parked cars")) == 0 and plan_street(StreetParameters(parked_share=0.0)).trucks == ()


# Lorries at the kerbs


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
        StreetParameters(seed=11, tree_spacing_m=8.0, parked_share=1.0),
        StreetParameters(seed=12, parking_width_m=2.6, pavement_width_m=2.5, parked_share=0.9),
    ],
)
def test_nothing_stands_where_a_lorry_stands(parameters):
    surfaces = street_surfaces(parameters)
    for truck in (each for each in parked_boxes(parameters) if each.class_name == "truck"):
        length, width, height = truck.size_lwh
        to_box = np.linalg.inv(truck.to_street)
        for name, quads in surfaces.layers.items():
            if name in ("road", "pavements", "sky", truck.layer):
                continue
            local = quads.centers @ to_box[:3, :3].T + to_box[:3, 3]
            inside = (np.abs(local[:, :2]) < [0.5 * length - 0.1, 0.5 * width - 0.1]).all(axis=1)
            inside &= local[:, 2] < height - 0.1
            assert not inside.any(), (name, truck.id)


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


# Meshes


def _areas(quads: Quads) -> np.ndarray:
    c = quads.corners.astype(np.float64)
    return 0.5 * np.linalg.norm(np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 1]), axis=1)


@given(st.lists(st.floats(0.02, 9.0), min_size=1, max_size=5), st.floats(0.01, 0.2), st.floats(0.2, 1.0))
def test_graded_lines_rise_and_hit_every_break(lengths: list[float], edge: float, coarse: float) -> None:
    breaks = [0.0, *np.cumsum(lengths)]
    lines = graded_lines(breaks, edge, coarse)
    assert (np.diff(lines) > 0).all()
    for at in breaks:
        assert np.min(np.abs(lines - at)) < 1e-9
    assert np.diff(lines).max() <= max(1.5 * coarse, 1.5 * edge) + 1e-9
    steps = np.diff(graded_lines([0.0, 4.0], 0.05, 0.5))
    assert steps[0] == pytest.approx(0.05) and steps[0] < steps[1] < steps[2] and steps.max() > 0.4


def test_panel_faces_u_cross_v_and_keeps_its_area() -> None:
    quads = panel(
        (1, 2, 3), (1, 0, 0), (0, 0, 1), even_lines(0.0, 2.0, 0.3), even_lines(0.0, 1.5, 0.2), 0.5, Label.BUILDING
    )
    np.testing.assert_allclose(quads.normals, np.tile([0, -1, 0], (len(quads), 1)), atol=1e-6)
    assert _areas(quads).sum() == pytest.approx(3.0, rel=1e-5)


def test_box_faces_outwards() -> None:
    quads = box((1, 2, 3), (2, 1, 0.5), 0.5, Label.FURNITURE, faces="xXyYzZ")
    outward = quads.centers - np.array([1, 2, 3], np.float32)
    assert (np.sum(outward * quads.normals, axis=1) > 0).all()
    assert _areas(quads).sum() == pytest.approx(2 * (2 * 1 + 2 * 0.5 + 1 * 0.5), rel=1e-5)


def test_tube_faces_outwards() -> None:
    z = np.linspace(0, 2, 6)
    path = np.stack([np.zeros(6), np.zeros(6), z], axis=1)
    quads = tube(path, np.full(6, 0.1), 0.5, Label.POLE, sides=12)
    assert (np.sum(quads.centers[:, :2] * quads.normals[:, :2], axis=1) > 0.09).all()


def test_repeated_moves_whole_copies() -> None:
    one = box((0, 0, 0), (1, 1, 1), 0.5, Label.CAR)
    two = one.repeated(np.array([[0.0, 0, 0], [5.0, 0, 0]]))
    np.testing.assert_allclose(two.corners[len(one) :], one.corners + np.float32([5, 0, 0]))
    np.testing.assert_array_equal(two.normals[len(one) :], one.normals)
