"""The picture that a sensor stores: noise by the photon transfer law, tone curve, JPEG, exposure; equal for twins."""

import msgspec
import numpy as np
import pytest
import yaml
from PIL import Image

from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.camera_response import CRUSH, GLARE, CameraResponse, tone_curve
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.export import export_frames, export_sequences, frame_numbers
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.sensor import Sensor
from small_scene import AHEAD, small_scene

CAMERA = Camera(96, 64, 80.0, 80.0, 48.0, 32.0)
NOISY = Sensor(size_px=(256, 256), full_well_e=4000, gain=4, read_noise_e=6)


def flat(level, side=256):
    return np.full((side, side, 3), level, np.uint8)


def taken(image, sensor=NOISY, time_s=0.0, seed=0, gain=1.0, camera=CAMERA):
    return CameraResponse(sensor, camera, time_s, seed, gain).picture(image)


# Noise


@pytest.mark.parametrize(("exposure_gain", "full_well_e", "gain"), [(1.0, 4000, 4), (1.0, 3000, 1), (1.5, 4000, 4)])
def test_variance_grows_with_the_signal_by_one_electron_each(exposure_gain, full_well_e, gain):
    """Photon transfer: in electrons, the variance is the mean plus the square of the read noise."""
    sensor = Sensor(size_px=(256, 256), full_well_e=full_well_e, gain=gain, read_noise_e=6)
    means, variances = [], []
    for level in range(80, 185, 15):
        light = srgb_to_linear(taken(flat(level), sensor, gain=exposure_gain) / 255)
        electrons = light * (full_well_e / gain) / exposure_gain
        means.append(electrons.mean())
        variances.append(electrons.var())
        assert electrons.mean() == pytest.approx(srgb_to_linear(np.array(level / 255)) * full_well_e / gain, rel=5e-3)
    slope, offset = np.polyfit(means, variances, 1)
    assert slope == pytest.approx(1, abs=0.03)
    assert offset == pytest.approx(36, abs=6)


def test_a_smaller_picture_averages_the_noise_of_native_pixels():
    sigma = [taken(flat(128, side)).std() for side in (256, 128, 512)]
    assert sigma[1] == pytest.approx(sigma[0] / 2, rel=0.03)
    assert sigma[2] == pytest.approx(sigma[0], rel=0.03)  # a larger one is not noisier


def test_pixels_channels_times_seeds_and_cameras_have_noise_of_their_own():
    turned = np.eye(4)
    turned[0, 3] = 1.0
    first = taken(flat(128))
    others = [
        taken(flat(128), time_s=1 / 30), taken(flat(128), seed=1),
        taken(flat(128), camera=Camera(96, 64, 80.0, 80.0, 48.0, 32.0, turned)),
    ]  # fmt: skip
    pairs = [(first, each) for each in others]
    pairs += [(first[..., 0], first[..., 1]), (first[1:], first[:-1]), (first[:, 1:], first[:, :-1])]
    for one, other in pairs:
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02
    assert np.array_equal(first, taken(flat(128)))


def test_without_noise_tone_and_jpeg_the_picture_is_unchanged():
    image = np.random.default_rng(3).integers(0, 256, (40, 30, 3)).astype(np.uint8)
    assert np.array_equal(taken(image, Sensor()), image)


# Tone curve, JPEG


def test_crushed_blacks():
    light = np.linspace(0, 1, 1001)
    display = linear_to_srgb(light)
    crushed = tone_curve(light, "crushed")
    black = float(linear_to_srgb(np.array([GLARE]))[0])
    above = (linear_to_srgb(light + GLARE * (1 - light)) - black) / (1 - black)
    np.testing.assert_allclose(crushed, above**2 * (1 + CRUSH) / (above + CRUSH))
    assert crushed[0] == 0 and crushed[-1] == pytest.approx(1) and np.all(np.diff(crushed) > 0)
    image = np.arange(256, dtype=np.uint8)[None, :, None].repeat(3, axis=2)
    made = taken(image, Sensor(tone_curve="crushed"))[0, :, 0].astype(float)
    np.testing.assert_allclose(made, 255 * np.interp(image[0, :, 0] / 255, display, crushed), atol=0.6)
    rises = np.diff(made[[24, 32]])
    assert rises / 8 < 0.75


def test_jpeg_is_that_of_opencv():
    image = np.random.default_rng(3).integers(0, 256, (64, 48, 3)).astype(np.uint8)
    coarse, fine = (taken(image, Sensor(jpeg_quality=quality)) for quality in (30, 95))
    errors = [np.abs(each.astype(int) - image).mean() for each in (coarse, fine)]
    assert errors[0] > 1.15 * errors[1] > 0
    smooth = flat(90)
    assert np.abs(taken(smooth, Sensor(jpeg_quality=95)).astype(int) - smooth).max() <= 1


# Sequences


@pytest.fixture
def sensor_file(tmp_path):
    def write(**fields):
        file = tmp_path / f"{len(list(tmp_path.iterdir()))}.yaml"
        file.write_text(yaml.safe_dump(fields))
        return str(file)

    return write


NOISE = {"size_px": [160, 96], "full_well_e": 4000, "gain": 4, "read_noise_e": 6}


def front(width=160, height=96):
    pose = np.eye(4)
    pose[:3, :3] = AHEAD.T
    pose[:3, 3] = -AHEAD.T @ np.array([1.0, 0.0, 1.5])
    return Camera(width, height, 130.0, 130.0, width / 2, height / 2, pose)


def sequence(rain, **fields):
    return FrameSequence(small_scene(), RainSimulation.start(rain), front(), 160, 96, fps=10.0, **fields)


def test_any_frame_alone_is_the_same(sensor_file):
    rain = RainSettings(intensity_mm_h=30.0, sensor=sensor_file(mean_gray=90, jpeg_quality=90, **NOISE))
    renderer, several = CpuRenderer(), sequence(rain)
    sky = several.sky(renderer)
    images = [several.image(renderer, number, sky) for number in range(3)]
    assert np.array_equal(sequence(rain).image(renderer, 2, sky), images[2])
    assert np.array_equal(sequence(rain).frame(renderer, 2, sky).to_uint8(), images[2])
    assert not np.array_equal(images[1], images[2])


@pytest.mark.parametrize("fields", [{}, {"mean_gray": 60.0}, {"tone_curve": "crushed"}])
def test_a_twin_without_rain_has_the_same_noise_and_gain(sensor_file, fields):
    """Pixels that rain leaves alone in the plain pictures are equal in those of the sensor."""
    renderer = CpuRenderer()
    rain = RainSettings(intensity_mm_h=40.0, haze="none", sensor=sensor_file(**NOISE, **fields))
    plain = sequence(msgspec.structs.replace(rain, sensor=sensor_file()))
    sky = plain.sky(renderer)
    clear, rainy = (plain.image(renderer, 1, each).astype(int) for each in (None, sky))
    seen = sequence(rain)
    twin, own = (seen.image(renderer, 1, each).astype(int) for each in (None, sky))
    is_rain = clear != rainy
    assert 0.002 < is_rain.mean() < 0.9
    assert np.array_equal(twin[~is_rain], own[~is_rain])
    assert np.abs(twin - clear).mean() > 1 and np.abs(twin - own)[is_rain].max() > 0


def test_floats_are_without_the_sensor_and_bytes_with_it(tmp_path, sensor_file):
    rain, renderer = RainSettings(intensity_mm_h=9.0, sensor=sensor_file(**NOISE)), CpuRenderer()
    plain = sequence(msgspec.structs.replace(rain, sensor=sensor_file()))
    sky = plain.sky(renderer)
    own, other = (each.frame(renderer, 0, sky, with_depth=True) for each in (sequence(rain), plain))
    assert np.array_equal(own.rgba, other.rgba) and np.array_equal(own.depth, other.depth)
    assert not np.array_equal(own.to_uint8(), other.to_uint8())
    looks = [each.image(renderer, 0, None, mode="depth") for each in (sequence(rain), plain)]
    assert np.array_equal(*looks)


def test_pictures_without_a_named_sensor_are_as_rendered():
    renderer = CpuRenderer()
    plain, pinhole = (sequence(RainSettings(sensor=name)) for name in (None, "pinhole"))
    assert plain.rainfall.sensor.changes_picture and plain.rainfall.picture_sensor is None
    clear = plain.image(renderer, 0, None)
    assert np.array_equal(clear, pinhole.image(renderer, 0, None))
    assert not np.array_equal(clear, sequence(RainSettings(sensor="automotive")).image(renderer, 0, None))


def test_automatic_exposure_leads_the_clear_picture_to_its_mean_gray(sensor_file):
    renderer = CpuRenderer()
    for target in (60.0, 110.0):
        seen = sequence(RainSettings(sensor=sensor_file(mean_gray=target)))
        light = srgb_to_linear(seen.image(renderer, 0, None) / 255) @ [0.2126, 0.7152, 0.0722]
        assert 255 * linear_to_srgb(light.mean(keepdims=True)).item() == pytest.approx(target, abs=4)


def test_back_ends_add_the_same_noise(any_renderer, sensor_file):
    cpu, rain = CpuRenderer(), RainSettings(intensity_mm_h=9.0, sensor=sensor_file(**NOISE))
    sky = sequence(rain).sky(cpu)
    images = [sequence(rain).image(each, 0, sky).astype(int) for each in (cpu, any_renderer)]
    assert np.abs(images[0] - images[1]).mean() < 0.2  # noise of their own would differ by 5 levels
    assert np.std(images[0] - sequence(RainSettings()).image(cpu, 0, None)) > 2


def test_exported_files_of_a_twin(tmp_path, sensor_file):
    """Frames and their rain-free twins at 0 mm/h are the same files."""
    rain = RainSettings(sensor=sensor_file(jpeg_quality=80, **NOISE))
    export = ExportSettings(output=str(tmp_path / "clip"), twin="sunny", size_px=(96, 64), last_s=0.2, fps=10.0)
    rainfall = RainSimulation.start(rain)
    sequences = export_sequences(export, small_scene(), rainfall, front(96, 64), in_scene_time=True)
    assert list(export_frames(CpuRenderer(), export, sequences, frame_numbers(export, sequences)))
    folders = [tmp_path / "clip", tmp_path / "clip.clear"]
    files = [sorted(each.glob("*.png")) for each in folders]
    assert len(files[0]) == 2
    for own, twin in zip(*files, strict=True):
        assert own.read_bytes() == twin.read_bytes()
    frames = [np.asarray(Image.open(file)).astype(int) for file in files[0]]
    assert np.std(frames[0] - frames[1]) > 2
