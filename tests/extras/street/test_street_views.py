from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.render.opengl.context import open_context
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.labels import Label
from gsrain_extras.street.build import StreetSurfaces
from gsrain_extras.street.ground_truth import StreetViews, capture_street

from .built_street import SHORT, street_of, surfaces_of

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def surfaces() -> StreetSurfaces:
    return surfaces_of(SHORT)


@pytest.fixture(scope="module")
def views(surfaces: StreetSurfaces) -> StreetViews:
    return StreetViews(surfaces)


@pytest.fixture(scope="module")
def ahead() -> Camera:
    pose = look_at(np.array([0.0, -1.7, 1.5]), np.array([100.0, -1.7, 1.5]), UP)
    return Camera(480, 320, 500.0, 500.0, 240.0, 160.0, pose)


@pytest.fixture(scope="module")
def view(views: StreetViews, ahead: Camera) -> CaptureFrame:
    return views.view(ahead, 0.0, "ahead")


def _world(view: CaptureFrame) -> np.ndarray:
    """Each pixel's surface point in the world."""
    c = view.camera
    x = (np.arange(c.width) + 0.5 - c.cx) / c.fx
    y = (np.arange(c.height) + 0.5 - c.cy) / c.fy
    local = np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=2) * view.depth[..., None]
    return local @ c.camera_to_world[:3, :3].T + c.position


def test_depth_is_that_of_the_planes_of_road_and_house_fronts(view: CaptureFrame, surfaces: StreetSurfaces) -> None:
    rows, columns = np.nonzero((view.labels == Label.ROAD) & (view.depth < 60))
    assert len(rows) > 20_000
    c = view.camera
    expected = 1.5 * c.fy / (rows + 0.5 - c.cy)  # a level view from 1.5 m above a plane
    np.testing.assert_allclose(view.depth[rows, columns], expected, rtol=2e-4)
    y = _world(view)[..., 1]
    fronts = np.abs(np.abs(y[view.labels == Label.BUILDING]) - surfaces.layout.parameters.front_y_m)
    assert np.mean(fronts < 0.01) > 0.3  # the rest are reveals, sills, roofs and the row at the end


def test_labels_are_right_and_a_second_picture_has_the_same_bytes(
    view: CaptureFrame, views: StreetViews, ahead: Camera
) -> None:
    assert view.labels[10, 200] == Label.SKY
    assert view.labels[300, 240] == Label.ROAD
    assert view.labels[185, 240] == Label.CAR  # the lead car
    found = set(np.unique(view.labels).tolist())
    assert {Label.LANE_MARKING, Label.PAVEMENT, Label.BUILDING, Label.VEGETATION, Label.POLE} <= found
    assert Label.NOTHING not in found
    second = views.view(ahead, 0.0, "again")
    assert second.image.tobytes() == view.image.tobytes() and second.depth.tobytes() == view.depth.tobytes()


def test_normals_point_to_the_camera(view: CaptureFrame) -> None:
    np.testing.assert_allclose(view.normals[300, 240], [0, 0, 1], atol=1e-6)
    solid = view.labels != Label.SKY
    np.testing.assert_allclose(np.linalg.norm(view.normals[solid], axis=1), 1, atol=1e-5)
    np.testing.assert_array_equal(view.normals[~solid], 0)
    away = _world(view) - view.camera.position
    assert (np.sum(away * view.normals, axis=2)[solid] <= 1e-6).all()


def test_mask_leaves_out_the_lead_car(view: CaptureFrame, views: StreetViews, ahead: Camera) -> None:
    assert not view.mask[185, 240]
    assert view.mask[300, 240]
    rows, columns = np.nonzero(~view.mask)
    assert columns.mean() == pytest.approx(240, abs=3)  # 18 m ahead in the same lane
    width_px = columns.max() - columns.min()
    assert width_px == pytest.approx(500 * 1.82 / (18 - 2.33), rel=0.1)
    later = views.view(ahead, 4.0, "later")
    assert 0 < np.sum(~later.mask) < 0.2 * len(rows)


def test_mesh_and_gaussians_show_the_same_street(view: CaptureFrame) -> None:
    with open_context() as context:
        renderer = SplatRenderer(context)
        renderer.draw(street_of(SHORT).parts(0.0), view.camera, with_depth=True)
        frame = renderer.read()
    psnr = 10 * np.log10(255**2 / np.mean((frame.to_uint8().astype(np.float64) - view.image) ** 2))
    solid = (view.depth > 0) & (view.depth < 60)
    error = np.median(np.abs(frame.depth - view.depth)[solid] / view.depth[solid])
    assert psnr > 20.5 and error < 0.03
    assert frame.rgba[..., 3].mean() > 0.98  # nothing to see through


def test_captures_have_everything(surfaces: StreetSurfaces, ahead: Camera) -> None:
    camera = replace(ahead, width=96, height=64)
    capture = capture_street([camera, replace(camera, fx=80.0, fy=80.0)], [0.0, 0.5], surfaces, with_lead=False)
    assert capture.has == {"depth", "normals", "labels", "mask", "sky"}
    assert [view.time_s for view in capture] == [0.0, 0.5]
    assert all(view.mask is not None and view.mask.all() for view in capture)
    with pytest.raises(ValueError, match="1 cameras need as many times"):
        capture_street([camera], [0.0, 1.0])
