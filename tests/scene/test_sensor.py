"""Sensors: their files, the lens that follows from f-number, pixel pitch and camera, and the rolling shutter."""

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.sensor import DEFAULT_SENSOR, Sensor, load_sensor, sensor_names

NATIVE = Camera(1920, 1280, 2060.0, 2060.0, 960.0, 640.0)


def test_the_shipped_sensors():
    assert sensor_names() == ["automotive", "pinhole", "rainsense", "waymo_front"]
    assert not load_sensor("pinhole").changes_picture
    assert load_sensor("pinhole").lens(NATIVE).aperture_m == 0
    assert all(load_sensor(name).changes_picture for name in sensor_names() if name != "pinhole")
    rainsense = load_sensor("rainsense").lens(Camera(1920, 1080, 1916.0, 1916.0, 1024.0, 580.0))
    assert rainsense.aperture_m == pytest.approx(1.02e-3, rel=0.01)  # that of docs/real_rain_method.md
    assert load_preset("paper").sensor == "pinhole"


@pytest.mark.parametrize("size", [(1920, 1280), (960, 640), (480, 480), (3840, 2160)])
def test_lens_opening_and_circle_of_confusion_at_any_size_of_the_picture(size):
    """A = f p / N and c = f A |1/d - 1/d_focus| px: an angle, of as many native pixels at each size."""
    sensor, camera = Sensor(size_px=(1920, 1280), pixel_pitch_um=3.0, f_number=1.8), NATIVE.resized(*size)
    lens = sensor.lens(camera)
    assert lens.aperture_m == pytest.approx(2060 * 3e-6 / 1.8)
    depth = np.array([0.4, 1.0, 5.0])
    pixels = camera.fy * lens.circle_of_confusion_m(depth) / depth
    expected = 2060 * (2060 * 3e-6 / 1.8) * np.abs(1 / depth - 1 / lens.focus_m)
    np.testing.assert_allclose(pixels, expected * size[1] / 1280)


def test_hyperfocal_focus_blurs_infinity_over_one_native_pixel():
    lens = load_sensor("automotive").lens(NATIVE)
    far = np.array([1e9])
    assert 2060 * lens.circle_of_confusion_m(far) / far == pytest.approx(1.0)


def test_the_readout_crosses_the_picture_in_its_direction():
    """First and last row are exposed half of the readout before and after the middle."""
    camera = Camera(100, 80, 90.0, 85.0, 40.0, 50.0)
    corners = {"down": (0.0, 0.0), "up": (0.0, 80.0), "right": (0.0, 0.0), "left": (100.0, 0.0)}
    for direction, (u, v) in corners.items():
        scan = Sensor(readout_s=0.02, readout_direction=direction).readout(camera)
        phases = []
        for x, y in ((u, v), (50.0, 40.0), (100.0 - u, 80.0 - v)):
            phases.append(scan.right * (x - 40.0) / 90.0 + scan.down * (y - 50.0) / 85.0 + scan.offset)
        assert phases == pytest.approx([-0.5, 0.0, 0.5], abs=1e-12)
        assert scan.time_s == 0.02


def test_exposure_beats_the_named_sensors_shutter_which_beats_the_cameras():
    camera = Camera(96, 64, 80.0, 80.0, 48.0, 32.0, exposure_s=0.01)

    def exposure(**rain):
        return RainSimulation.start(RainSettings(intensity_mm_h=1.0, **rain)).exposure_s(camera)

    assert exposure() == exposure(sensor="pinhole") == 0.01
    assert exposure(sensor="waymo_front") == 0.00256
    assert exposure(sensor="waymo_front", exposure_s=0.05) == 0.05


def test_aperture_and_focus_of_the_rain_replace_those_of_the_sensor():
    def lens(**rain):
        return RainSimulation.start(RainSettings(intensity_mm_h=1.0, **rain)).lens(NATIVE)

    own = load_sensor(DEFAULT_SENSOR).lens(NATIVE)
    assert lens() == own == lens(sensor=DEFAULT_SENSOR)
    assert lens(focus_distance_m=3.0) == own._replace(focus_m=3.0)
    assert lens(aperture_mm=8.0) == (8e-3, 10.0)  # as before there were sensors
    assert lens(aperture_mm=0.0, focus_distance_m=10.0) == (0.0, 10.0)


def test_a_change_of_the_sensor_leaves_the_drops_where_they_are():
    start = RainSimulation.start(RainSettings(intensity_mm_h=1.0))
    changed = start.changed(msgspec.structs.replace(start.rain, sensor="rainsense"), 2.0)
    assert changed.sensor == load_sensor("rainsense")
    assert changed.changed(start.rain, 2.0).sensor == load_sensor(DEFAULT_SENSOR)
    assert changed.motion.fall_speed_m_s is not None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("f_number: 0.2", "0.2 must be at least 0.7 - at `$.f_number`"), ("pixel_pitch_um: 0", "pixel_pitch_um"),
        ("shutter: 3", "shutter_s"), ("tone_curve: film", "tone_curve"), ("size_px: [4, 4]", "size_px"),
        ("jpeg_quality: 101", "jpeg_quality"), ("[1, 2]", "object"),
        ("chroma_blur_px: [0, 8.1]", "chroma_blur_px"),
        ("readout_s: .nan", "readout_s"),
    ],
)  # fmt: skip
def test_a_bad_file_gives_one_sentence(tmp_path, text, words):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ValueError) as error:
        load_sensor(file)
    assert str(file) in str(error.value) and words in str(error.value) and "\n" not in str(error.value)


def test_an_unknown_name_lists_the_shipped_ones(tmp_path):
    with pytest.raises(ValueError, match=r"sensor nikon: no such file.*automotive, pinhole, rainsense, waymo_front"):
        RainSimulation.start(RainSettings(sensor="nikon"))


def test_a_preset_names_a_sensor_file_next_to_it(tmp_path):
    (tmp_path / "mine.yaml").write_text("f_number: 2.0")
    (tmp_path / "rain.yaml").write_text("{intensity_mm_h: 2, sensor: mine.yaml}")
    rain = load_preset(str(tmp_path / "rain.yaml"))
    assert RainSimulation.start(rain).sensor.f_number == 2.0
