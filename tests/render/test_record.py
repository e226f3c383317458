"""Recordings of a small scene by the processor, looked at frame by frame."""

import json
import re
import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import av
import msgspec
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.export import export_frames, export_sequences, film_frames, frame_numbers
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.images import to_display, to_linear_light, write_labels, write_still
from gsrain_engine.render.object_labels import draw_labels
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.renderer import Frame
from gsrain_engine.render.sequence import FrameSequence, find_rig_cameras, render_image
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.rig import rig_camera_path
from gsrain_engine.scene.scene import Scene
from gsrain_engine.threads import limited_kernels
from small_scene import small_scene

SIZE = (96, 64)
GRAY = (0.7, 0.7, 0.7)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return small_scene()


@pytest.fixture(scope="module")
def rainfall() -> RainSimulation:
    return RainSimulation.start(RainSettings(intensity_mm_h=12.0, exposure_s=0.02, haze="gaussians", drop_color=GRAY))


@pytest.fixture(scope="module")
def path(scene) -> CameraPath:
    return rig_camera_path(scene, scene.rigs["one"][0], *SIZE)


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


def frames_of(video):
    with av.open(str(video)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def recorded(recording, scene, rainfall, path, numbers=None):
    sequences = export_sequences(recording, scene, rainfall, path, in_scene_time=True)
    steps = list(export_frames(CpuRenderer(), recording, sequences, numbers or frame_numbers(recording, sequences)))
    assert steps[-1].fraction == 1
    return steps


def test_samples_of_a_pixel_are_averaged_and_the_drops_stay_the_same(scene, rainfall, path):
    renderer, fine = CpuRenderer(), CpuRenderer()
    sequence = FrameSequence(scene, rainfall, path, *SIZE, supersampling=2)
    sky = sequence.sky(renderer)
    frame = sequence.frame(renderer, 30, sky)
    shot = sequence.shot(30)
    camera = shot.camera.resized(192, 128)
    draw(fine, FrameInput.of(scene, rainfall, sky.light, replace(shot, camera=camera, focal_px=shot.camera.fx)))
    blocks = fine.read().rgba.reshape(64, 2, 96, 2, 4)
    assert frame.rgba.shape == (64, 96, 4)
    assert np.allclose(frame.rgba, blocks.mean(axis=(1, 3)), atol=1e-6)
    plain = CpuRenderer()
    replace(sequence, supersampling=1).frame(plain, 30, sky)
    # Streaks at the picture's edge may fall outside of it at one size and not at the other.
    assert renderer.statistics.drops_drawn == pytest.approx(plain.statistics.drops_drawn, rel=0.02)
    with_more = CpuRenderer()
    draw(with_more, FrameInput.of(scene, rainfall, sky.light, replace(shot, camera=camera)))
    assert with_more.statistics.drops_drawn > 1.2 * plain.statistics.drops_drawn


def test_sub_frames_share_the_exposure_and_are_averaged_in_linear_light(scene, rainfall, path):
    """Four streaks of a quarter of the exposure are together what one streak of all of it is."""
    renderer = CpuRenderer()
    sequence = FrameSequence(scene, rainfall, path, *SIZE, motion_blur=4)
    sky = sequence.sky(renderer)
    frame, light = sequence.frame(renderer, 30, sky), []
    for t in 1.0 + 0.02 * np.array([-0.375, -0.125, 0.125, 0.375]):
        draw(renderer, FrameInput.of(scene, rainfall, sky.light, replace(sequence.shot_at(t), exposure_share=0.25)))
        light.append(to_linear_light(renderer.read().rgba))
    assert np.allclose(frame.rgba, to_display(np.mean(light, axis=0)), atol=1e-5)
    still, added = replace(sequence, camera=path.camera(1.0, *SIZE)), []
    for k in (1, 4):
        blurred = replace(still, motion_blur=k)
        rainy, clear = (to_linear_light(blurred.frame(renderer, 30, each).rgba) for each in (sky, None))
        added.append(float((rainy - clear)[..., :3].sum()))
    assert added[1] == pytest.approx(added[0], rel=0.05)
    assert abs(added[0]) > 1
    gray = np.array([[[0.25, 0.25, 0.25, 0.5]]], np.float32)  # display gray 0.5 at half cover
    assert to_linear_light(gray)[0, 0, :3] == pytest.approx([0.5 * 0.21404] * 3, abs=1e-5)


def test_labels_name_what_is_in_front(scene, rainfall, path, tmp_path, context):
    recording = ExportSettings(output=str(tmp_path / "a.png"), size_px=SIZE, passes=("labels",))
    recorded(recording, scene, rainfall, path)
    labels, legend = pixels(tmp_path / "a.labels.png"), json.loads((tmp_path / "a.labels.json").read_text())
    assert [legend[str(labels[row, 48])] for row in (4, 24, 60)] == [
        {"name": "sky", "kind": "sky"}, {"name": "wall", "kind": "background"}, {"name": "road", "kind": "background"}
    ]  # fmt: skip
    assert set(np.unique(labels)) <= {0, 1, 2, 3}
    assert not (tmp_path / "a.png").exists()
    by_opengl = draw_labels(SplatRenderer(context), scene, path.camera(0.0, *SIZE), 0.0)
    assert np.mean(labels == by_opengl) > 0.995
    recorded(recording, scene.with_member("layers/wall", visible=False), rainfall, path)
    assert 2 not in pixels(tmp_path / "a.labels.png")
    many = 100 * labels.astype(np.uint16)
    write_labels(tmp_path / "many.png", many, 300)
    assert np.array_equal(pixels(tmp_path / "many.png"), many)


def test_passes_are_the_same_in_every_format_and_depth_is_one_sample_a_pixel(scene, rainfall, path, tmp_path):
    fine = {"supersampling": 2, "motion_blur": 2}
    for name, samples in (("a.npy", {}), ("a.exr", {}), ("plain.png", {}), ("fine.png", fine)):
        passes = ("color", "depth", "alpha") if name.endswith("png") else ("color", "depth")
        output = ExportSettings(output=str(tmp_path / name), size_px=SIZE, first_s=1.0, passes=passes, **samples)
        recorded(output, scene, rainfall, path)
    rgba, depth = np.load(tmp_path / "a.npy"), np.load(tmp_path / "a.depth.npy")
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
    assert (channels["RGBA"].dtype, channels["Z"].dtype) == (np.float16, np.float32)
    assert np.array_equal(channels["RGBA"], to_linear_light(rgba).astype(np.float16))
    assert np.array_equal(channels["Z"], depth)
    assert np.array_equal(pixels(tmp_path / "plain.png"), Frame(rgba).to_uint8())
    assert np.array_equal(pixels(tmp_path / "plain.alpha.png"), np.rint(255 * rgba[..., 3]))
    for name in ("plain", "fine"):
        assert np.array_equal(pixels(tmp_path / f"{name}.depth.png"), np.rint(100 * depth))
    assert depth.max() > 30  # the wall stands 38 m ahead
    assert (tmp_path / "plain.png").read_bytes() != (tmp_path / "fine.png").read_bytes()
    for name in ("plain.png", "a.exr", "a.npy"):
        write_still(tmp_path / f"still/{name}", Frame(rgba, depth))
        assert (tmp_path / f"still/{name}").read_bytes() == (tmp_path / name).read_bytes()
    with pytest.raises(ValueError, match="film.mp4"):
        write_still(tmp_path / "film.mp4", Frame(rgba))


def test_the_twin_is_the_clip_at_0_mm_h(scene, rainfall, path, tmp_path):
    fields = {"size_px": SIZE, "fps": 10.0, "last_s": 0.3}
    passes = ("color", "depth")
    recorded(ExportSettings(output=str(tmp_path / "a"), twin="sunny", passes=passes, **fields), scene, rainfall, path)
    dry = RainSimulation.start(msgspec.structs.replace(rainfall.rain, intensity_mm_h=0.0))
    recorded(ExportSettings(output=str(tmp_path / "b"), **fields), scene, dry, path)
    assert [each.name for each in sorted((tmp_path / "a.clear").iterdir())] == [f"00000{k}.png" for k in range(3)]
    for frame in (tmp_path / "b").iterdir():
        assert (tmp_path / "a.clear" / frame.name).read_bytes() == frame.read_bytes()
        assert (tmp_path / "a" / frame.name).read_bytes() != frame.read_bytes()
    assert len(list((tmp_path / "a").glob("*.depth.png"))) == 3


def test_rig_cameras_are_recorded_together(scene, rainfall, path, tmp_path):
    front = scene.rigs["one"][0]
    scene = replace(scene, rigs={"one": (front, replace(front, name="LEFT", width=960, height=480, cy=240.0))})
    recording = ExportSettings(output=str(tmp_path / "rig.mp4"), cameras=("one",), size_px=SIZE, fps=10.0, last_s=0.2)
    recorded(recording, scene, rainfall, path)
    assert sorted(each.name for each in (tmp_path / "rig").iterdir()) == ["FRONT.mp4", "LEFT.mp4"]
    assert len(frames_of(tmp_path / "rig" / "LEFT.mp4")) == 2
    sequences = export_sequences(
        ExportSettings(output="x", cameras=("LEFT",)), scene, rainfall, path, in_scene_time=True
    )
    (left,) = sequences.values()
    assert (left.width, left.height) == (960, 480)
    assert left.length_s == 5.0
    assert left.shot_at(1.0).velocity_m_s == pytest.approx([2, 0, 0], abs=1e-6)
    assert left.shot_at(9.0).velocity_m_s == pytest.approx([0, 0, 0])
    for names in (("LEFT", "FRONT"), ("FRONT", "one/LEFT"), ("LEFT", "all")):
        found = [each.name for each in find_rig_cameras(scene, names)]
        assert found == [name.rpartition("/")[2].replace("all", "FRONT") for name in names]
    with pytest.raises(ValueError, match="no camera 'TOP', only one/FRONT, one/LEFT"):
        find_rig_cameras(scene, ("TOP",))
    with pytest.raises(ValueError, match="no vehicle with cameras"):
        find_rig_cameras(replace(scene, rigs={}), ("all",))


def test_a_path_of_the_scene_goes_by_the_scene_s_time(scene, rainfall):
    places, turns = np.array([[0.0, 0, 2], [4, 0, 2]]), np.tile([0.5, -0.5, 0.5, -0.5], (2, 1))
    path = CameraPath(np.array([2.0, 4.0]), places, turns, np.full(2, 50.0))
    recording = ExportSettings(output="x", size_px=SIZE, first_s=1.0, fps=10.0)
    (sequence,) = export_sequences(recording, scene, rainfall, path, in_scene_time=True).values()
    assert len(frame_numbers(recording, {"": sequence})) == 30
    for each, time_s in ((sequence, 3.0), (replace(sequence, in_scene_time=False), 1.0)):
        assert each.shot_at(time_s).camera.position == pytest.approx([2, 0, 2])
    speeds = [shot.velocity_m_s for shot in replace(sequence, motion_blur=3).shots(10)]  # at 2 s, where the path begins
    assert np.allclose(speeds, speeds[0])
    assert np.linalg.norm(speeds[0]) > 1


def test_each_frame_is_read_while_the_next_is_drawn_and_the_last_one_too(scene, rainfall, path, tmp_path, context):
    """The files hold the images of single frames, in their order; each is written after the next one was drawn."""
    numbers, events = [4, 0, 9, 2], []
    recording = ExportSettings(output=str(tmp_path / "frames"), size_px=SIZE, fps=10.0)
    for name, renderer in (("opengl", SplatRenderer(context)), ("cpu", CpuRenderer())):
        sequences = export_sequences(recording, scene, rainfall, path, in_scene_time=True)
        (sequence,) = sequences.values()
        sky = sequence.sky(renderer)
        expected = {number: sequence.image(renderer, number, sky) for number in numbers}
        draw = renderer.draw

        def counted(*items, draw=draw, **options):
            events.append(len(list((tmp_path / "frames").glob("*.png"))))
            draw(*items, **options)

        renderer.draw = counted
        progress = list(export_frames(renderer, recording, sequences, numbers))
        assert [each.message[:10] for each in progress[1:]] == [f"Frame {k} of" for k in (1, 2, 3, 4)]
        assert name == "cpu" or events[-4:] == [0, 0, 1, 2]  # the processor draws several at once
        for number, image in expected.items():
            np.testing.assert_array_equal(pixels(tmp_path / "frames" / f"{number:06d}.png"), image)
        shutil.rmtree(tmp_path / "frames")


def test_a_recording_that_is_left_can_be_played(scene, rainfall, path, tmp_path):
    recording = ExportSettings(output=str(tmp_path / "a.mp4"), size_px=SIZE, passes=("color", "depth"))
    sequences = export_sequences(recording, scene, rainfall, path, in_scene_time=True)
    steps = export_frames(CpuRenderer(), recording, sequences, range(100))
    progress = list(islice(steps, 4))  # the sky, then three frames
    steps.close()
    assert len(frames_of(tmp_path / "a.mp4")) == len(list((tmp_path / "a.depth").glob("*.png"))) == 3
    assert progress[1].message == "Frame 1 of 100"
    assert re.fullmatch(r"Frame 3 of 100, \d+:\d\d min left", progress[3].message)
    assert progress[3].fraction == pytest.approx(0.03)
    assert progress[1].preview.shape == (64, 96, 3)
    assert progress[1].preview.std() > 5


@pytest.mark.parametrize("threads", [1, 3])
def test_frames_through_wiped_glass_are_those_drawn_alone_on_any_number_of_threads(scene, path, tmp_path, threads):
    rain = RainSimulation.start(RainSettings(intensity_mm_h=50.0, glass="windshield", wiper="high", glass_wet_s=4.0))
    recording = ExportSettings(output=str(tmp_path / "frames"), size_px=SIZE, fps=5.0, last_s=1.0)
    with limited_kernels(threads):
        recorded(recording, scene, rain, path)
    found = [pixels(tmp_path / "frames" / f"{number:06d}.png") for number in range(5)]
    for number in (1, 3):
        alone = ExportSettings(output=str(tmp_path / f"alone{number}"), size_px=SIZE, fps=5.0, last_s=1.0)
        recorded(alone, scene, rain, path, [number])
        assert pixels(tmp_path / f"alone{number}" / f"{number:06d}.png").tobytes() == found[number].tobytes()
    assert found[1].tobytes() != found[3].tobytes()


def test_a_single_image_is_the_frame_that_a_sequence_has_at_that_moment(scene, rainfall, path):
    renderer, camera = CpuRenderer(), path.camera(0.0, *SIZE)
    sequence = FrameSequence(scene, rainfall, camera, *SIZE, fps=2.0)
    frame = sequence.frame(renderer, 3, sequence.sky(renderer), with_depth=True)
    still = render_image(renderer, scene, rainfall.rain, camera, 1.5, with_depth=True)
    recording = ExportSettings(output="x", size_px=SIZE, first_s=1.5, last_s=2.0, fps=2.0)
    (film,) = film_frames(renderer, recording, scene, rainfall.rain, camera, with_depth=True)
    for each in (still, film):
        assert np.array_equal(each.rgba, frame.rgba)
        assert np.array_equal(each.depth, frame.depth)
    assert not np.array_equal(still.rgba, render_image(renderer, scene, rainfall.rain, camera, 1.6).rgba)
    with pytest.raises(ValueError, match="nowhere"):
        render_image(renderer, scene, RainSettings(intensity_mm_h=1, calibration="nowhere"), camera)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_one_sentence(scene, rainfall, path, tmp_path):
    (tmp_path / "a.mp4").symlink_to("/dev/full")
    recording = ExportSettings(output=str(tmp_path / "a.mp4"), size_px=SIZE, last_s=3.0)
    sequences = export_sequences(recording, scene, rainfall, path, in_scene_time=True)
    with pytest.raises(OSError, match=r"a.mp4 .* after \d+ frames: No space left"):
        list(export_frames(CpuRenderer(), recording, sequences, frame_numbers(recording, sequences)))
