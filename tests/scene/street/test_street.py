import hashlib

import msgspec
import numpy as np
import pytest

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
    quads_to_gaussians,
)
from gsrain_engine.scene.street.layout import CURB_HEIGHT_M, Label, StreetParameters, plan_street


def _digest(scene: Scene) -> str:
    found = hashlib.sha256()
    for each in (*scene.layers, *scene.actors):
        g = each.gaussians
        for array in (g.means, g.scales, g.quaternions, g.opacities, g.sh):
            found.update(array.tobytes())
    return found.hexdigest()


def _layer(scene: Scene, name: str) -> Gaussians:
    return next(layer.gaussians for layer in scene.layers if layer.name == name)


def test_the_same_parameters_give_the_same_bytes(street: Scene) -> None:
    again = build_street()
    assert _digest(again) == _digest(street)


def test_another_seed_is_another_street() -> None:
    first, second = plan_street(StreetParameters()), plan_street(StreetParameters(seed=8))
    assert [h.width for h in first.left] != [h.width for h in second.left]


def test_has_as_many_gaussians_as_a_small_machine_can_draw(street: Scene) -> None:
    assert 200_000 <= street.gaussian_count <= 410_000


def test_every_gaussian_is_sound(street: Scene) -> None:
    for each in (*street.layers, *street.actors):
        g = each.gaussians
        for array in (g.means, g.scales, g.quaternions, g.opacities, g.sh):
            assert array.dtype == np.float32
            assert np.isfinite(array).all()
        np.testing.assert_allclose(np.linalg.norm(g.quaternions, axis=1), 1, atol=1e-5)
        assert (g.scales > 0).all()
        assert ((g.opacities > 0) & (g.opacities <= 1)).all()
        color = SH_C0 * g.sh[:, 0] + 0.5
        assert color.min() > -0.5
        assert color.max() < 1.6


def test_layers_tell_what_they_show(street: Scene, surfaces: StreetSurfaces) -> None:
    names = [layer.name for layer in street.layers]
    assert names == [
        "road",
        "pavements",
        "houses",
        "trees",
        "parked cars",
        "parked trucks",
        "furniture",
        "surroundings",
        "sky",
    ]
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


def test_rig_camera_names_what_is_there(street: Scene) -> None:
    with pytest.raises(ValueError, match="only waymo_front3, nuscenes"):
        rig_camera(street, "kitti", "FRONT", 0.0)
    with pytest.raises(ValueError, match="only FRONT, FRONT_LEFT, FRONT_RIGHT"):
        rig_camera(street, "waymo_front3", "BACK", 0.0)


def test_look_at_agrees_with_a_rig_camera(street: Scene) -> None:
    front = rig_camera(street, "nuscenes", "CAM_FRONT", 0.0)
    seen = look_at(front.position, front.position + np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    np.testing.assert_allclose(front.world_to_camera, seen, atol=1e-9)


def test_bounds_name_the_field() -> None:
    with pytest.raises(msgspec.ValidationError, match=r"length_m"):
        msgspec.convert({"length_m": 20.0}, StreetParameters)


def test_another_street_can_be_built() -> None:
    changes = {"seed": 3, "length_m": 120.0, "pavement_width_m": 2.5, "parked_share": 0.0, "tree_spacing_m": 40.0}
    scene = build_street(msgspec.convert(changes, StreetParameters))
    assert scene.gaussian_count > 150_000
    assert _layer(scene, "pavements").means[:, 2].max() == pytest.approx(CURB_HEIGHT_M)
    assert len(_layer(scene, "parked cars")) == 0
