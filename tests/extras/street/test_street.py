"""The built-in street: sound Gaussians, free lanes, vehicles on their wheels, cameras, and the meshes that it is of."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.gaussians import SH_C0, Gaussians, evaluate_sh
from gsrain_engine.scene.geometry import matrices_from_quaternions
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene, is_sky
from gsrain_extras.street.build import (
    OBJECT_LAYERS,
    PARKED_CARS,
    StreetSurfaces,
    build_street,
    displayed_colors,
    means_of,
    quads_to_gaussians,
    street_boxes,
    street_surfaces,
)
from gsrain_extras.street.cars import TRUCK_FORM, vehicle_shadow
from gsrain_extras.street.ground import build_road
from gsrain_extras.street.layout import CURB_HEIGHT_M, STREETS, StreetParameters, plan_street
from gsrain_extras.street.lighting import Illumination
from gsrain_extras.street.mesh import Quads, box, broken_lines, even_lines, panel
from gsrain_extras.street.refinement import ego_camera_line, refined, split_at_shadows
from gsrain_extras.street.shadows import vehicle_occluders
from gsrain_extras.street.trucks import build_truck

from ...scene.formats.sample_files import assert_valid
from .built_street import MOMENTS, SHORT, WHOLE, moments_of, street_of, surfaces_of


@pytest.fixture(scope="module")
def surfaces() -> StreetSurfaces:
    return surfaces_of(WHOLE)


@pytest.fixture(scope="module")
def street() -> Scene:
    return street_of(SHORT)


def test_gaussians_are_sound_and_those_of_the_quads(street: Scene) -> None:
    names = ["road", "pavements", "houses", "trees", *OBJECT_LAYERS, "furniture", "surroundings", "sky"]
    assert [layer.name for layer in street.layers] == names
    assert [layer.name for layer in street.layers if layer.kind == "sky"] == ["sky"]
    for each in street.members:
        assert_valid(each.gaussians)
        color = SH_C0 * each.gaussians.sh[:, 0] + 0.5
        assert color.min() > -0.5 and color.max() < 2.2
        assert len(each.gaussians)
    for layer in street.layers:  # Gaussian i is quad i
        np.testing.assert_array_equal(layer.gaussians.means, means_of(surfaces_of(SHORT).layers[layer.name]))


def test_all_parts_are_what_they_were(surfaces: StreetSurfaces) -> None:
    """Sizes, places, colors and lamps of everything that is built, which no rule but these numbers fixes."""
    assert 1_000_000 <= len(surfaces.lead) + sum(map(len, surfaces.layers.values())) <= 1_200_000
    found, expected = moments_of(surfaces), json.loads(MOMENTS.read_text(encoding="utf-8"))
    assert found.keys() == expected.keys()
    for part, numbers in expected.items():
        for name, value in numbers.items():
            assert found[part][name] == pytest.approx(value, rel=1e-5, abs=1e-6), f"{name} of {part}"


def test_the_road_is_flat_whole_and_marked_in_its_middle(surfaces: StreetSurfaces) -> None:
    p, quads = surfaces.layout.parameters, surfaces.layers["road"]
    road = quads_to_gaussians(quads, surfaces.light())
    assert road.means[:, 2].max() == 0 and road.means[:, 2].min() > -0.003  # what fills gaps lies beneath
    np.testing.assert_allclose(np.abs(matrices_from_quaternions(road.quaternions)[:, 2, 2]), 1, atol=1e-5)
    assert (road.scales[:, 2] < 0.05 * road.scales[:, 1]).all()
    low, high = (end(quads.corners[..., :2], axis=1) for end in (np.min, np.max))
    points = np.random.default_rng(0).uniform([p.start_x_m, -p.curb_y_m], [p.end_x_m, p.curb_y_m], (400, 2))
    covered = ((points[:, None] >= low - 1e-5) & (points[:, None] <= high + 1e-5)).all(axis=2)
    assert covered.any(axis=1).all()
    at, painted = quads.centers, quads.labels == Label.LANE_MARKING
    free = np.min(np.abs(at[:, :1] - np.array(surfaces.layout.crossings)), axis=1) > 6
    assert (at[painted & free & (np.abs(at[:, 1]) < 0.05), 0] % 7.5 < 3.0).all()  # dashes of 3 m, 4.5 m apart
    assert not (painted & free & (np.abs(at[:, 1] + 0.5 * p.lane_width_m) < 0.4)).any()
    for start in surfaces.layout.crossings:
        assert 0.3 < painted[(at[:, 0] > start) & (at[:, 0] < start + 3)].mean() < 0.6


NARROW = StreetParameters(
    seed=11, tree_spacing_m=8.0, parking_width_m=2.6, pavement_width_m=2.5, parked_share=1.0, length_m=120.0
)


@pytest.mark.parametrize("parameters", [None, NARROW])
def test_nothing_stands_in_the_lanes_or_where_trucks_and_buses_stand(
    surfaces: StreetSurfaces, parameters: StreetParameters | None
) -> None:
    layers = (surfaces if parameters is None else street_surfaces(parameters)).layers
    p = parameters = parameters or StreetParameters()
    for name in ("houses", "trees", *OBJECT_LAYERS, "furniture", "pavements"):
        at = layers[name].centers
        inside = (at[:, 0] > p.start_x_m + 0.5) & (at[:, 0] < p.end_x_m - 0.5) & (at[:, 2] < 2.4)
        assert np.abs(at[inside, 1]).min(initial=99) > p.lane_width_m - 0.35, name
    for truck in [each for each in street_boxes(parameters) if each.class_name in ("truck", "bus")]:
        to_box = np.linalg.inv(truck.to_layer)
        half = np.array(truck.size_lwh) / 2 - [0.1, 0.1, 0]
        for name in set(layers) - {"road", "pavements", "sky", truck.layer}:
            local = layers[name].centers @ to_box[:3, :3].T + to_box[:3, 3]
            inside = (np.abs(local[:, :2]) < half[:2]).all(axis=1) & (local[:, 2] < truck.size_lwh[2] - 0.1)
            assert not inside.any(), (name, truck.id)


def test_harmonics_of_degree_1_are_the_mirrored_sky(surfaces: StreetSurfaces) -> None:
    glossy, light = surfaces.lead.take(surfaces.lead.gloss > 0.1), surfaces.lead_light()
    directions = np.tile([0.8, 0.36, -0.48], (len(glossy), 1))
    found = evaluate_sh(quads_to_gaussians(glossy, light).sh.astype(np.float64), directions)
    expected = displayed_colors(glossy, light, light.display_colors(glossy, glossy.centers), directions)
    np.testing.assert_allclose(np.clip(found, 0, 1), expected, atol=2e-5)
    constant, linear = light.gloss_of(np.array([[0.0, 0.0, 1.0]]))
    assert (constant + np.array([0.7, 0.0, -0.714]) @ linear[0] > constant).all()  # looking down into a level mirror


def test_vehicles_fill_their_boxes_and_stand_on_the_ground(street: Scene) -> None:
    (lead,) = street.actors
    car = lead.gaussians.means[lead.gaussians.opacities > 0.9]
    truck = build_truck(plan_street(StreetParameters()).trucks[0])
    form = TRUCK_FORM
    assert set(np.unique(truck.labels)) == {Label.TRUCK}
    sizes = (car, lead.size_lwh), (truck.corners.reshape(-1, 3), (form.length, form.width, form.height))
    for points, size in sizes:
        low, high = points.min(axis=0), points.max(axis=0)
        np.testing.assert_allclose((high - low)[[0, 2]], [size[0], size[2]], atol=0.12)
        assert 0 <= (high - low)[1] - size[1] < 0.4  # mirrors
        assert abs(low[2]) < 0.06
        np.testing.assert_allclose(0.5 * (low + high)[:2], 0, atol=0.05)
    flank = (np.abs(np.abs(truck.centers[:, 1]) - 0.5 * form.width) < 1e-3) & (truck.centers[:, 2] > form.floor)
    assert (truck.centers[flank, 1] * truck.normals[flank, 1] > 0).mean() > 0.9


def test_the_ego_follows_the_lead_car_with_cameras_that_look_where_their_names_say(street: Scene) -> None:
    pose, (lead,) = street.ego_to_world(2.0), street.actors
    assert pose is not None and street.ego is not None and street.ground_m == 0
    gaps = lead.track.positions[:, 0] - street.ego.positions[:, 0]
    assert gaps[0] == pytest.approx(18) and gaps.min() > 15
    np.testing.assert_array_equal(lead.track.positions[:, 1], street.ego.positions[:, 1])
    np.testing.assert_allclose(pose[:3, 3], [20, -1.7, 1.5], atol=1e-9)  # in the right lane, at sensor height
    assert {name: len(rig) for name, rig in street.rigs.items()} == {"waymo_front3": 3, "nuscenes": 6}
    front = rig_camera(street, "waymo_front3", "FRONT", 1.0)
    assert (front.width, front.height, front.exposure_s) == (1920, 1280, 0.004)
    np.testing.assert_allclose(front.position, [10 + 1.54, -1.7 - 0.02, 2.12], atol=1e-9)
    np.testing.assert_allclose(front.camera_to_world[:3, 1], [0, 0, -1], atol=1e-12)
    ways = {"FRONT": [1, 0, 0], "FRONT_LEFT": [np.sqrt(0.5), np.sqrt(0.5), 0], "CAM_BACK": [-1, 0, 0]}
    for name, way in ways.items():
        camera = rig_camera(street, "nuscenes" if name.startswith("CAM") else "waymo_front3", name, 1.0)
        np.testing.assert_allclose(camera.camera_to_world[:3, 2], way, atol=1e-12)
    for rig, name, known in (("kitti", "FRONT", "waymo_front3, nuscenes"), ("nuscenes", "BACK", "CAM_BACK_LEFT")):
        with pytest.raises(ValueError, match=known):
            rig_camera(street, rig, name, 0.0)


def test_another_street_can_be_built() -> None:
    with pytest.raises(msgspec.ValidationError, match=r"length_m"):
        msgspec.convert({"length_m": 20.0}, StreetParameters)
    changes = {
        "seed": 3,
        "length_m": 120.0,
        "edge_px": 8.0,
        "pavement_width_m": 2.5,
        "parked_share": 0.0,
        "tree_spacing_m": 40.0,
    }
    scene = build_street(msgspec.convert(changes, StreetParameters))
    assert scene.gaussian_count > 150_000
    counts = {layer.name: len(layer.gaussians) for layer in scene.layers}
    assert counts["parked cars"] == counts["parked trucks"] == counts["parked buses"] == 0
    assert scene.layers[1].gaussians.means[:, 2].max() == pytest.approx(CURB_HEIGHT_M)
    widths = [[house.width for house in plan_street(StreetParameters(seed=seed)).left] for seed in (7, 8)]
    assert widths[0] != widths[1]


def test_the_overcast_street_has_the_light_of_rain_without_its_water() -> None:
    coarse = msgspec.structs.replace(SHORT, edge_px=16.0)
    sunny, overcast = build_street(coarse), build_street(msgspec.structs.replace(coarse, time_of_day="overcast"))
    for one, other in zip(sunny.members, overcast.members, strict=True):
        for name in ("means", "scales", "quaternions", "opacities"):
            assert getattr(one.gaussians, name).tobytes() == getattr(other.gaussians, name).tobytes()
        assert one.wet_sh is not None and other.wet_sh is not None
        assert one.wet_sh.tobytes() == other.wet_sh.tobytes()
        assert not np.array_equal(one.gaussians.sh, other.gaussians.sh)
        assert is_sky(one) == np.array_equal(other.gaussians.sh, other.wet_sh)  # clouds are neither wet nor dry


def test_a_long_street_is_lit_in_sections_as_in_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    layout = plan_street(STREETS["street:long"])
    assert len(layout.crossings) >= 16 and len(layout.trucks) >= 20 and len(layout.trees) > 130
    assert layout.right[-1].origin[0] == pytest.approx(1170) and layout.parameters.drive_seconds == 57
    quads = build_road(layout)
    chosen = quads.take((quads.centers[:, 0] > 400) & (quads.centers[:, 0] < 640))
    light = Illumination.over(layout.parameters, layout)
    in_sections = light.display_colors(chosen, chosen.centers)
    monkeypatch.setattr("gsrain_extras.street.lighting._SECTION_M", 2000.0)
    np.testing.assert_array_equal(in_sections, light.display_colors(chosen, chosen.centers))


def test_chunks_of_quads_become_the_same_gaussians(surfaces: StreetSurfaces, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = quads_to_gaussians(surfaces.layers[PARKED_CARS], surfaces.light())
    monkeypatch.setattr("gsrain_extras.street.build._CHUNK", 1000)
    found = quads_to_gaussians(surfaces.layers[PARKED_CARS], surfaces.light())
    for array, same in zip(found.arrays, expected.arrays, strict=True):
        np.testing.assert_allclose(array, same, atol=1e-6)


# Meshes


def areas(quads: Quads) -> np.ndarray:
    c = quads.corners.astype(np.float64)
    return 0.5 * np.linalg.norm(np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 1]), axis=1)


@given(st.lists(st.floats(0.02, 9.0), min_size=1, max_size=5), st.floats(0.2, 1.0))
def test_broken_lines_rise_and_hit_every_break(lengths: list[float], spacing: float) -> None:
    breaks = [0.0, *np.cumsum(lengths)]
    lines = broken_lines(breaks, spacing)
    assert (np.diff(lines) > 0).all()
    assert all(np.min(np.abs(lines - at)) < 1e-9 for at in breaks)
    assert np.diff(lines).max() <= spacing + 1e-9


def alphas(gaussians: Gaussians, points: np.ndarray, plane: tuple[int, int, int]) -> np.ndarray:
    """Alpha of each Gaussian at points, whose distance from the plane does not count."""
    axes = matrices_from_quaternions(gaussians.quaternions) / gaussians.scales[:, None]
    away = (points[:, None] - gaussians.means) * plane
    return gaussians.opacities * np.exp(-0.5 * np.sum(np.einsum("pni,nij->pnj", away, axes) ** 2, axis=2))


@pytest.mark.parametrize(("size", "parts", "most"), [(0.04, 1, 0.52), (0.1, 5, 0.34), (0.2, 9, 0.29), (0.3, 13, 0.25)])
def test_a_leaf_has_the_alpha_of_its_quad(size: float, parts: int, most: float) -> None:
    """Root mean square of what differs within 1.4 of its width, over that of the quad's own alpha."""
    half = 0.5 * size
    y, z = half * np.array([-1, -1, 1, 1]), half * np.array([-1, 1, 1, -1])
    square = np.stack(np.broadcast_arrays(30.0, 8 + y, 2 + z), axis=1)[None]
    leaf = Quads.of(square, 0.2, Label.VEGETATION, opacity=0.98, spread=0.38)
    fine = refined(leaf, ego_camera_line(StreetParameters()), 1.4)
    assert len(fine) == parts
    gaussians = quads_to_gaussians(fine, Illumination.over(StreetParameters()))
    at = np.linspace(-1.4 * half, 1.4 * half, 60)
    y, z = (each.reshape(-1) for each in np.meshgrid(at, at))
    points = np.stack(np.broadcast_arrays(30.0, 8 + y, 2 + z), axis=1)
    alpha = 1 - np.prod(1 - alphas(gaussians, points, (0, 1, 1)), axis=1)
    true = (np.maximum(np.abs(y), np.abs(z)) < half).astype(float)
    assert np.sqrt(np.mean((alpha - true) ** 2) / np.mean(true**2)) < most


def test_gaussians_of_a_surface_turned_away_do_not_stand_out() -> None:
    """A flat roof above the camera, with a narrow rim: little alpha is beyond it."""
    rim = np.array([0.0, 0.05, 0.9, 1.8, 1.85])
    roof = panel((60, 4.0, 3.4), (1, 0, 0), (0, 1, 0), 2 * even_lines(0, 2, 0.25), rim, 0.5, Label.TRUCK)
    fine = refined(roof, ego_camera_line(StreetParameters()), 1.4)
    gaussians = quads_to_gaussians(fine, Illumination.over(StreetParameters()))
    x = np.linspace(60.5, 63.5, 40)
    for out in (0.03, 0.2):
        points = np.stack(np.broadcast_arrays(x, 4.0 - out, 3.4), axis=1)
        assert (1 - np.prod(1 - alphas(gaussians, points, (1, 1, 0)), axis=1)).max() < 0.05


def test_overlapping_gaussians_of_a_shadow_together_have_its_alpha() -> None:
    shadow = vehicle_shadow(4.4, 1.8)
    gaussians = quads_to_gaussians(shadow, Illumination.over(StreetParameters()))
    chosen = np.flatnonzero(np.abs(shadow.centers[:, :2]).max(axis=1) < 0.6)
    alpha = 1 - np.prod(1 - alphas(gaussians, shadow.centers[chosen], (1, 1, 0)), axis=1)
    assert alpha == pytest.approx(shadow.opacity[chosen], abs=0.06)


def test_cells_are_small_at_color_edges_and_grow_away_from_them() -> None:
    line = ego_camera_line(StreetParameters())
    lines = even_lines(-2.0, 2.0, 0.5)
    wall = panel((60, 8.0, 2.0), (1, 0, 0), (0, 0, 1), lines, lines, 0.5, Label.BUILDING)  # faces the road
    wall = wall.tinted(np.where(wall.centers[:, :1] < 60, 0.3, 1.0))
    fine = refined(wall, line, 1.0)
    fine = fine.take(fine.spread[:, 0] < 1)  # without what fills gaps
    assert areas(fine).sum() == pytest.approx(16.0, rel=1e-5)
    assert set(np.unique(fine.albedo)) == set(np.unique(wall.albedo))
    extent = np.ptp(fine.corners, axis=1)[:, [0, 2]]
    away = np.abs(fine.centers[:, 0] - 60)
    pixel = (8.0 + 1.7) / 0.4663 / 1030 * (1 / 0.4663)  # along the wall, as the camera passes
    inside = np.abs(fine.centers[:, 2] - 2) < 1.5  # without the outline
    at_edge = extent[inside & (away < pixel), 0]
    assert len(at_edge) and (0.5 * pixel < at_edge).all() and (at_edge < 1.5 * pixel).all()
    assert extent[inside & (away > 0.5) & (away < 1.5)] == pytest.approx(0.5)
    assert len(refined(wall, line, 0.5)) > len(fine) > 1.5 * len(wall)
    behind = replace(wall, corners=wall.corners[:, ::-1])
    assert len(refined(behind, line, 1.0)) < len(fine)


def test_nearer_cells_end_where_the_next_begin_beneath_them() -> None:
    """A wall of two colors, blended by depth: no gaps, and its colors meet where they should, within half a pixel."""
    lines = even_lines(-2.0, 2.0, 0.5)
    wall = panel((60, 8.0, 2.0), (1, 0, 0), (0, 0, 1), lines, lines, 0.5, Label.BUILDING)  # faces the road
    wall = wall.tinted(np.where(wall.centers[:, :1] < 60, 0.3, 1.0))
    fine = refined(wall, ego_camera_line(StreetParameters()), 1.0)
    pixel = (8.0 + 1.7) / 0.4663 / 1030 * (1 / 0.4663)
    gaussians = quads_to_gaussians(fine, Illumination.over(StreetParameters()))
    order = np.argsort(gaussians.means[:, 0], kind="stable")
    x = np.arange(59.0, 61.0, 0.1 * pixel)
    for z in (1.87, 2.02, 2.25):
        alpha = alphas(gaussians, np.stack(np.broadcast_arrays(x, 8.0, z), axis=1), (1, 0, 1))[:, order]
        left = np.cumprod(1 - alpha, axis=1)
        share = alpha * np.concatenate([np.ones((len(x), 1)), left[:, :-1]], axis=1)
        assert left[:, -1].max() < 0.25 and left[:, -1].mean() < 0.1
        bright = share[:, fine.albedo[order, 0] > 0.3].sum(axis=1) / share.sum(axis=1)
        middle = x[np.argmin(np.abs(bright - 0.5))]
        assert abs(middle - 60) < 0.5 * pixel
        assert bright[x < 60 - 2 * pixel].max() < 0.15 and bright[x > 60 + 2 * pixel].min() > 0.85


def test_shadows_are_cut_where_the_sun_casts_them(surfaces: StreetSurfaces) -> None:
    p = surfaces.layout.parameters
    road = build_road(surfaces.layout)
    light = Illumination.over(p, surfaces.layout)
    cells = split_at_shadows(road, ego_camera_line(p), light, 1.4)
    assert areas(cells).sum() == pytest.approx(areas(road).sum(), rel=1e-5)

    def changes(quads: Quads) -> np.ndarray:
        """Square meters of road by the change of the sun's light inside a quad, from 0 to 1."""
        at = [light.sun_reaching(quads.corners[:, k]) for k in range(4)]
        return np.histogram(np.ptp(at, axis=0), 5, (0, 1), weights=areas(quads))[0]

    assert changes(cells)[3:].sum() < 0.5 * changes(road)[3:].sum()


def test_what_casts_shadows_lies_within_its_vehicle_or_person() -> None:
    occluders = vehicle_occluders(plan_street(StreetParameters()))
    for each in occluders:
        low, high = np.array(each.boxes)[:, 0].min(axis=0), np.array(each.boxes)[:, 1].max(axis=0)
        assert (np.maximum(np.abs(low), np.abs(high))[:2] <= np.array([each.length, each.width]) / 2 + 1e-9).all()
        assert 0 <= low[2] < high[2] and (high[2] <= each.height or each.height == 1.2)  # a car's roof shades no other
    trucks = [np.array(each.boxes) for each in occluders if each.shades_itself]
    assert len(trucks) == 3
    for boxes in trucks:  # else they would shade the surface itself
        assert boxes[:, 0, 0].min() > TRUCK_FORM.body_back and boxes[:, 1, 2].max() < TRUCK_FORM.height


def test_panels_and_boxes_face_outwards_and_keep_their_area() -> None:
    u, v = even_lines(0.0, 2.0, 0.3), even_lines(0.0, 1.5, 0.2)
    quads = panel((1, 2, 3), (1, 0, 0), (0, 0, 1), u, v, 0.5, Label.BUILDING)
    np.testing.assert_allclose(quads.normals, np.tile([0, -1, 0], (len(quads), 1)), atol=1e-6)
    assert areas(quads).sum() == pytest.approx(3.0, rel=1e-5)
    quads = box((1, 2, 3), (2, 1, 0.5), 0.5, Label.FURNITURE, faces="xXyYzZ")
    assert (np.sum((quads.centers - np.float32([1, 2, 3])) * quads.normals, axis=1) > 0).all()
    assert areas(quads).sum() == pytest.approx(2 * (2 * 1 + 2 * 0.5 + 1 * 0.5), rel=1e-5)
