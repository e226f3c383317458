"""Cameras of AlpaSim's messages against OpenCV's own functions and f-theta's formula, and back."""

import cv2
import numpy as np
import pytest

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.lens_faces import assemble, lens_faces
from gsrain_engine.scene.scene import RigCamera
from gsrain_extras.alpasim.lenses import LensError, camera_of, write_lens
from gsrain_extras.alpasim.messages import message

WIDTH, HEIGHT = 160, 120
MATRIX = np.array([[90.0, 0, 78], [0, 92, 61], [0, 0, 1]])
WIDE = np.array([[55.0, 0, 78], [0, 56, 61], [0, 0, 1]])
RADIAL, TANGENTIAL, PRISM = [-0.31, 0.09, -0.004, 0.01, 0.002, 0.0], [0.001, -0.002], [0.001, 0.0, -0.001, 0.0]
KANNALA = [0.05, -0.02, 0.004, -0.0005]


def camera(model: str, size: tuple[int, int] = (WIDTH, HEIGHT), **fields):
    spec = message("CameraSpec")(resolution_w=size[0], resolution_h=size[1])
    lens = getattr(spec, model)
    lens.principal_point_x, lens.principal_point_y = MATRIX[:2, 2]
    for name, value in fields.items():
        if isinstance(value, list):
            getattr(lens, name)[:] = value
        else:
            setattr(lens, name, value)
    return spec


def opencv(model: str, **fields):
    return camera(model, focal_length_x=MATRIX[0, 0], focal_length_y=MATRIX[1, 1], **fields)


def fisheye():
    focal = {"focal_length_x": WIDE[0, 0], "focal_length_y": WIDE[1, 1]}
    return camera("opencv_fisheye_param", radial_coeffs=KANNALA, max_angle=1.4, **focal)


def rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (x, y) that a ray comes to, and their directions."""
    rows, columns = np.nonzero(camera.rays.is_imaged)
    return np.stack([columns + 0.5, rows + 0.5], axis=1), camera.rays.directions[rows, columns].astype(np.float64)


def test_pinhole_distortion_is_opencvs() -> None:
    spec = opencv("opencv_pinhole_param", radial_coeffs=RADIAL, tangential_coeffs=TANGENTIAL, thin_prism_coeffs=PRISM)
    pixels, directions = rays(camera_of(spec, WIDTH, HEIGHT))
    coefficients = np.array([*RADIAL[:2], *TANGENTIAL, *RADIAL[2:], *PRISM])
    found, _ = cv2.projectPoints(directions[:, None], np.zeros(3), np.zeros(3), MATRIX, coefficients)
    assert len(pixels) > 0.9 * WIDTH * HEIGHT
    np.testing.assert_allclose(found[:, 0], pixels, atol=0.02)


def test_fisheye_is_opencvs() -> None:
    pixels, directions = rays(camera_of(fisheye(), WIDTH, HEIGHT))
    ahead = directions[:, 2] > 0.2
    found, _ = cv2.fisheye.projectPoints(directions[ahead, None], np.zeros(3), np.zeros(3), WIDE, np.array(KANNALA))
    np.testing.assert_allclose(found[:, 0], pixels[ahead], atol=0.02)
    assert np.arccos(directions[:, 2] / np.linalg.norm(directions, axis=1)).max() <= 1.4 + 1e-6


FORWARD = [0.0, 80.0, 0.0, -4.0]
ANGLES = np.linspace(0, 1.3, 200)
BACKWARD = np.polynomial.polynomial.polyfit(np.polynomial.polynomial.polyval(ANGLES, FORWARD), ANGLES, 7).tolist()


@pytest.mark.parametrize(
    "fields",
    [
        {"angle_to_pixeldist_poly": FORWARD, "reference_poly": 2},
        {"angle_to_pixeldist_poly": FORWARD},
        {"pixeldist_to_angle_poly": BACKWARD, "reference_poly": 1},
        {"pixeldist_to_angle_poly": BACKWARD, "angle_to_pixeldist_poly": [1.0], "reference_poly": 1},
    ],
)
def test_f_theta_by_either_polynomial(fields: dict) -> None:
    spec = camera("ftheta_param", max_angle=1.2, **fields)
    spec.ftheta_param.linear_cde.linear_c, spec.ftheta_param.linear_cde.linear_d = 1.01, 0.003
    spec.ftheta_param.linear_cde.linear_e = -0.002
    pixels, directions = rays(camera_of(spec, WIDTH, HEIGHT))
    angle = np.arctan2(np.linalg.norm(directions[:, :2], axis=1), directions[:, 2])
    assert 1.0 < angle.max() < 1.2 + 1e-6
    length = np.polynomial.polynomial.polyval(angle, FORWARD)
    around = directions[:, :2] / np.linalg.norm(directions[:, :2], axis=1, keepdims=True)
    point = (length[:, None] * around) @ np.array([[1.01, 0.003], [-0.002, 1.0]]).T + MATRIX[:2, 2]
    np.testing.assert_allclose(point, pixels, atol=0.05)


def test_a_picture_through_a_lens_is_sampled_where_its_rays_go() -> None:
    """Of a picture whose colors are directions, each pixel gets the color of its own."""
    camera, pictures = camera_of(fisheye(), WIDTH, HEIGHT), []
    faces = lens_faces(camera)
    assert len(faces) > 1
    for face in faces:
        u, v = np.meshgrid(np.arange(face.camera.width) + 0.5, np.arange(face.camera.height) + 0.5)
        ray = np.stack([(u - face.camera.cx) / face.camera.fx, (v - face.camera.cy) / face.camera.fy, np.ones_like(u)])
        ray = np.einsum("ij,jhw->hwi", face.turn, ray / np.linalg.norm(ray, axis=0))
        pictures.append(np.rint(127.5 + 127.5 * ray).astype(np.uint8))
    picture = assemble(faces, pictures)
    pixels, directions = rays(camera)
    columns, rows = (pixels - 0.5).astype(int).T
    expected = 127.5 + 127.5 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(picture[rows, columns], expected, atol=1.6)
    assert not picture[~camera.rays.is_imaged].any()


def test_a_size_scales_the_lens() -> None:
    spec = opencv("opencv_pinhole_param")
    doubled = camera_of(spec, 2 * WIDTH, HEIGHT)
    assert doubled.lens is None
    assert (doubled.fx, doubled.fy, doubled.cx) == (180, 92, 156)


@pytest.mark.parametrize(
    "spec",
    [
        opencv("opencv_pinhole_param", radial_coeffs=RADIAL, tangential_coeffs=TANGENTIAL, thin_prism_coeffs=PRISM),
        fisheye(),
        camera("ftheta_param", angle_to_pixeldist_poly=[0.0, 80.0, 0.0, -4.0], reference_poly=2, max_angle=1.2),
    ],
)
def test_a_camera_comes_back_from_the_message_that_is_written_for_it(spec) -> None:
    first, again = camera_of(spec, WIDTH, HEIGHT), message("CameraSpec")(resolution_w=WIDTH, resolution_h=HEIGHT)
    numbers = first.fx, first.fy, first.cx, first.cy
    write_lens(again, RigCamera("front", WIDTH, HEIGHT, *numbers, np.eye(4), 0.004, first.lens))
    second = camera_of(again, WIDTH, HEIGHT)
    np.testing.assert_allclose(second.rays.directions, first.rays.directions, atol=1e-6)
    assert (second.rays.is_imaged == first.rays.is_imaged).all()


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        (message("CameraSpec")(), "camera_param"),
        (camera("opencv_pinhole_param"), "focal_length: must be at least 1 px"),
        (opencv("opencv_pinhole_param", radial_coeffs=[0.1] * 7), "radial_coeffs: must be 6 numbers, or none, not 7"),
        (opencv("opencv_pinhole_param", radial_coeffs=[0.1] * 3), "radial_coeffs: must be 6 numbers, or none, not 3"),
        (opencv("opencv_pinhole_param", tangential_coeffs=[float("nan")]), "tangential_coeffs: must be finite"),
        (opencv("opencv_pinhole_param", size=(0, HEIGHT)), "resolution_w: must be the size of the camera"),
        (opencv("opencv_pinhole_param", size=(5, HEIGHT)), "principal_point_x: must be at most one picture outside"),
        (opencv("opencv_pinhole_param", size=(WIDTH, 2**16)), "resolution_h: must be within a factor of 256 of"),
        (opencv("opencv_fisheye_param", radial_coeffs=[-1e5, 0, 0, 0]), "no pixel sees|must rise"),
        (camera("ftheta_param"), "must have 1 to 16 numbers"),
        (camera("ftheta_param", angle_to_pixeldist_poly=[0.0, -5.0]), "must rise"),
        (camera("ftheta_param", pixeldist_to_angle_poly=[1e6] * 3), "no pixel sees anything"),
    ],
)  # fmt: skip
def test_impossible_lenses_are_refused(spec, words: str) -> None:
    with pytest.raises(LensError, match=words):
        camera_of(spec, WIDTH, HEIGHT)
    with pytest.raises(LensError, match="4096 px"):
        camera_of(spec, 4097, HEIGHT)
