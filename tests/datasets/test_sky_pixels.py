"""The sky of one picture: clouds belong to it, walls, trucks, beams and lamps don't, and doubt leaves it alone."""

import cv2
import numpy as np
import pytest

from gsrain_engine.datasets.io.images import read_color
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.sky_masks import certain_sky

HEIGHT, WIDTH, HORIZON = 180, 320, 90
BLUE, CLOUD, WHITE, GRAY, WARM = (90, 140, 220), (235, 236, 240), (255, 255, 255), (150, 155, 165), (225, 200, 150)


def street(sky=BLUE, ground=(85, 82, 78)):
    """Return a textured road and houses under an even sky."""
    image = np.empty((HEIGHT, WIDTH, 3), np.float32)
    image[:HORIZON], image[HORIZON:] = sky, ground
    image[60:HORIZON, 40:130] = (120, 90, 70)
    texture = np.random.default_rng(0).normal(0, 14, (HEIGHT, WIDTH, 1))
    is_solid = (np.arange(HEIGHT)[:, None] >= HORIZON) | (image[..., 0] == 120)
    return np.clip(image + is_solid[..., None] * texture, 0, 255).astype(np.uint8), ~is_solid


def with_box(image, rows, columns, color):
    image = image.copy()
    image[rows, columns] = color
    return image


def test_clouds_are_sky_and_what_stands_before_it_is_not():
    image, sky = street()
    soft = cv2.GaussianBlur((np.random.default_rng(5).random((HEIGHT, WIDTH)) > 0.5).astype(np.float32), (0, 0), 14)
    cloud = np.clip((soft - soft.min()) / np.ptp(soft) * 3.4 - 1, 0, 1)[..., None] * sky[..., None]
    cloudy = np.rint((1 - cloud) * image + cloud * CLOUD).astype(np.uint8)
    assert (cloud[..., 0][sky] > 0.9).mean() > 0.1
    truck = with_box(cloudy, slice(70, 140), slice(180, 250), (205, 205, 205))
    found, sureness = certain_sky(truck)
    sky[70:140, 180:250] = False
    assert sureness == 1
    assert found[sky].mean() > 0.96
    assert found[sky][cloud[..., 0][sky] > 0.9].mean() > 0.95
    assert found[~sky].mean() < 0.01


@pytest.mark.parametrize("color", [BLUE, WHITE, GRAY])
def test_skies_of_many_colors_are_found_at_any_size(color):
    image, sky = street(color, (60, 58, 55))
    for scale in (0.5, 1.0, 3.0):
        size = (round(scale * WIDTH), round(scale * HEIGHT))
        method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        found, sureness = certain_sky(cv2.resize(image, size, interpolation=method))
        assert found.shape == size[::-1] and sureness >= 0.5
        back = cv2.resize(found.astype(np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST) > 0
        assert back[sky].mean() > 0.95
        assert back[~sky].mean() < 0.02


def test_wires_and_twigs_leave_the_sky_between_them():
    image = street()[0]
    for row in (20, 50):
        image[row] = 30
    image[52:88, 200:300:10] = (60, 50, 40)
    found = certain_sky(image).pixels
    assert found[:45, :30].mean() > 0.85
    assert found[26:46, 150:].mean() > 0.8
    assert found[55:85, 202:298].mean() > 0.3
    assert found[92:].mean() == 0


DARK, DUSK, NIGHT = (60, 58, 55), (40, 42, 60), (8, 8, 10)
DOUBTFUL = {
    "a wall in the sun": with_box(street((120, 90, 70))[0], slice(0, 90), slice(0, WIDTH), WARM),
    "a beam over a bright road": with_box(street(DARK, (190, 188, 185))[0], slice(0, 80), slice(100, 160), GRAY),
    "a lamp at night": with_box(street(NIGHT, (12, 12, 12))[0], slice(0, 12), slice(150, 162), WHITE),
    "a wall in shade": with_box(street(DUSK, (45, 47, 66))[0], slice(0, 70), slice(60, 200), (125, 130, 158)),
    "a truck right ahead": with_box(street(DARK)[0], slice(0, 150), slice(60, 260), (240, 240, 240)),
    "even gray": np.full((HEIGHT, WIDTH, 3), 128, np.uint8),
    "noise": np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8),
    "too small": np.zeros((7, 3, 3), np.uint8),
}


@pytest.mark.parametrize("name", DOUBTFUL)
def test_where_it_is_not_sure_no_sky_is_marked(name):
    found, sureness = certain_sky(DOUBTFUL[name])
    assert sureness == 0 and not found.any()


def test_a_sunlit_wall_beside_a_blue_sky_is_no_cloud():
    image, _ = street()
    image[:50, :60] = (250, 232, 200)
    found = certain_sky(image).pixels
    assert found[:50, 80:].mean() > 0.95
    assert found[:50, :50].mean() < 0.05


def test_real_pictures_have_their_clouds_and_keep_their_walls(test_data):
    cameras = {file.name.split("__")[1]: file for file in (test_data / "driving" / "nuscenes_sample").glob("*.jpg")}
    front = certain_sky(read_color(cameras["CAM_FRONT"])).pixels
    assert front[:180, 1000:1500].mean() > 0.99  # a cumulus
    assert front[450:].mean() < 0.01
    assert front[250:600, 150:500].mean() == 0  # a white truck
    assert not certain_sky(read_color(cameras["CAM_FRONT_LEFT"])).pixels.any()  # beams of concrete
    waymo = open_capture(test_data / "driving" / "waymo_frame")
    stone = next(view for view in waymo if "SIDE_RIGHT" in view.name).image  # panels in a blue shade
    for width in (480, 960):
        small = cv2.resize(stone, (width, round(stone.shape[0] * width / stone.shape[1])), interpolation=cv2.INTER_AREA)
        assert not certain_sky(small).pixels.any()
    night = test_data / "weather" / "bdd100k" / "9aa94005-ff1d4c9a.jpg"
    assert certain_sky(read_color(night)).sureness == 0
