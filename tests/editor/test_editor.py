import gc
import platform
import subprocess
import sys
import weakref
from concurrent.futures import ThreadPoolExecutor, wait
from threading import Event

import msgspec
import numpy as np
import psutil
import pytest

from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import set_visible
from gsrain_engine.editor.edits.transform import pivot
from gsrain_engine.editor.rain_regions import project_edges, region_outlines
from gsrain_engine.editor.viewport.camera import OrbitCamera
from gsrain_engine.malloc_tuning import MemoryTrimmer, trim_memory
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.shelter_map import shelter_map_of
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import SceneCore
from gsrain_engine.simulation.ground import road_surface_of
from gsrain_engine.simulation.obstacles import occupied_space_of
from oracles.drop_phases import displacement
from small_scene import small_scene


@pytest.fixture
def editor():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def settle(editor):
    """Let background work end and take it in, without a live view that would upload it first."""
    wait(editor.pending_files, timeout=60)
    editor.tick(0.0)
    editor.apply(DrawResult(is_pending_ready=True))


def test_rain_changes_are_undone_and_the_rainfall_follows(editor):
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=4.0)
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=5.0)
    editor.document.end_gesture()
    assert editor.live_rain.simulation.state.intensity_mm_h == 5
    editor.document.undo()
    assert editor.document.rain.intensity_mm_h == 0
    assert editor.live_rain.simulation.state.drops == 0
    editor.document.redo()
    assert editor.live_rain.simulation.state.intensity_mm_h == 5


def test_moving_the_slider_moves_no_drop(editor):
    editor.document.change_rain("Intensity", intensity_mm_h=4.0)
    editor.tick(10.0)
    before = displacement(editor.live_rain.simulation.motion, editor.playback.clock.time_s)
    editor.document.change_rain("Intensity", intensity_mm_h=4.5)
    assert np.allclose(displacement(editor.live_rain.simulation.motion, editor.playback.clock.time_s), before)


def test_time_goes_on_in_real_seconds_while_it_plays(editor):
    editor.tick(0.5)
    editor.playback.clock.toggle()
    editor.tick(0.5)
    assert editor.playback.clock.time_s == 0.5
    editor.playback.clock.toggle()
    editor.playback.clock.speed = 2.0
    editor.tick(0.25)
    assert editor.playback.clock.time_s == 1.0


def test_open_and_save(editor, tmp_path):
    write_scene(small_scene("other"), tmp_path / "other")
    editor.files.open(str(tmp_path / "other"))
    assert editor.busy == f"Opening {tmp_path / 'other'}"
    settle(editor)
    assert editor.document.scene.name == "other"
    assert editor.document.history.undo_label is None
    editor.document.change_rain("Intensity", intensity_mm_h=7.0)
    editor.files.save_to(tmp_path / "saved")
    settle(editor)
    saved = read_scene(tmp_path / "saved")
    assert saved.rain["intensity_mm_h"] == 7.0
    editor.files.open(str(tmp_path / "saved"))
    settle(editor)
    assert editor.document.rain.intensity_mm_h == 7.0


@pytest.mark.parametrize("content", [None, b"not a scene"])
def test_what_cannot_be_opened_is_told_and_nothing_is_lost(editor, tmp_path, content):
    path = tmp_path / "bad.ply"
    if content is not None:
        path.write_bytes(content)
    before = editor.document.scene
    editor.files.open(str(path))
    settle(editor)
    assert editor.document.scene is before
    assert "bad.ply" in editor.status.log.lines[-1].text


def test_a_scene_with_unusable_rain_opens_all_the_same(editor, tmp_path):
    from dataclasses import replace

    write_scene(replace(small_scene(), rain={"intensity_mm_h": 1000.0}), tmp_path / "wild")
    editor.files.open(str(tmp_path / "wild"))
    settle(editor)
    assert editor.document.scene.name == "small"
    assert editor.document.rain.intensity_mm_h == 0
    assert any("rain can't be used" in line.text for line in editor.status.log.lines)


def test_riding_along_follows_the_ego(editor):
    editor.viewport.options.follow_path = True
    editor.tick(2.0)
    shot = editor.viewport.shot(96, 64)
    assert shot.camera.position == pytest.approx([4.0, 0, 1.5])
    assert shot.velocity_m_s == pytest.approx([2.0, 0, 0])


def test_screenshots_never_overwrite(editor, tmp_path):
    editor.take_screenshot(tmp_path)
    first = editor.viewport.screenshot
    first.write_text("taken")
    editor.take_screenshot(tmp_path)
    assert editor.viewport.screenshot != first


def test_rain_saved_with_a_scene_is_plain_values(editor):
    assert msgspec.json.decode(msgspec.json.encode(msgspec.to_builtins(editor.document.rain)))["intensity_mm_h"] == 0


def test_orbit_keeps_its_target_and_its_distance():
    eye = OrbitCamera()
    target = eye.target.copy()
    eye.orbit(0.3, 0.2)
    assert eye.target == pytest.approx(target)
    assert np.linalg.norm(eye.position - target) == pytest.approx(eye.distance_m)
    eye.orbit(0.0, 10.0)
    assert abs(eye.pitch) < np.pi / 2


def test_frame_shows_the_whole_box():
    eye = OrbitCamera()
    low, high = np.array([-3.0, 1, 0]), np.array([5.0, 9, 4])
    eye.frame(SceneCore(low, high))
    camera = eye.camera(600, 400)
    corners = np.array([[x, y, z] for x in (-3, 5) for y in (1, 9) for z in (0, 4)], float)
    seen = corners @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    pixels = seen[:, :2] / seen[:, 2:] * camera.fy + [camera.cx, camera.cy]
    assert (seen[:, 2] > 0).all()
    assert (pixels >= 0).all() and (pixels <= [600, 400]).all()


def test_flying_moves_along_the_sight_and_stops():
    eye = OrbitCamera(heading=np.pi / 2, speed_m_s=4.0)
    start = eye.position.copy()
    eye.fly(1.0, 0.0, 0.0, 0.5)
    assert eye.position - start == pytest.approx([0, 2, 0], abs=1e-12)
    assert eye.velocity_m_s == pytest.approx([0, 4, 0], abs=1e-12)
    eye.stop()
    assert np.all(eye.velocity_m_s == 0)


def test_region_edges_are_cut_at_the_camera(editor):
    editor.viewport.options.show_streak_region = editor.viewport.options.show_haze_region = True
    outlines = region_outlines(editor, 300, 200)
    assert list(outlines) == ["streak region", "haze region"]
    for outline in outlines.values():
        assert np.isfinite(outline).all()
        assert 0 < len(outline) <= 12
    anchor = np.eye(4)
    anchor[0, 3] = 20.0  # all in front
    lines = project_edges(editor.document.rain.streak_region, anchor, editor.viewport.shot(300, 200).camera)
    assert len(lines) == 12


def test_roofs_are_found_behind_the_window_and_rain_falls_through_them_until_then():
    editor = Editor(small_scene(), RainSettings(intensity_mm_h=8.5, roofs=True))
    assert editor.busy == "Finding roofs"
    assert not editor.split_panes[0].rainfall.rain.roofs
    editor.tick(0.0)
    wait(editor.pending_files, timeout=60)
    assert editor.busy is None
    assert editor.split_panes[0].rainfall is editor.live_rain.simulation
    editor.document.edit(
        "Show or hide", set_visible, editor.document.scene.layers[0].key, False
    )  # another scene, as seen from above
    assert editor.busy == "Finding roofs"
    editor.close()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries give memory back by themselves")
def test_freed_memory_goes_back_to_the_system():
    """Small blocks between blocks in use: 160 MB that glibc would keep."""
    blocks = [bytearray(4000) for _ in range(40_000)]
    kept = blocks[::200]
    del blocks
    full = psutil.Process().memory_info().rss
    trim_memory()
    assert psutil.Process().memory_info().rss < full - 100e6
    assert len(kept) == 200


LEFT_BY_THREADS = """
import sys, threading
import psutil
from gsrain_engine.malloc_tuning import tune_malloc
from gsrain_engine.malloc_tuning import trim_memory, use_one_arena

if sys.argv[1] == "one":
    use_one_arena()
tune_malloc()
before = psutil.Process().memory_info().rss
together = threading.Barrier(4)

def work():
    blocks = [bytearray(1_000_000) for _ in range(40)]
    together.wait(60)
    blocks.clear()
    together.wait(60)

threads = [threading.Thread(target=work) for _ in range(4)]
for each in threads:
    each.start()
for each in threads:
    each.join()
trim_memory()
print(psutil.Process().memory_info().rss - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no arenas")
def test_memory_that_threads_free_goes_back_only_from_one_arena():
    def left_behind(arenas: str) -> float:
        """Bytes of 160 MB."""
        command = [sys.executable, "-c", LEFT_BY_THREADS, arenas]
        return float(subprocess.run(command, capture_output=True, check=True, text=True).stdout)

    assert left_behind("one") < 20e6 < 100e6 < left_behind("many")


def test_memory_is_returned_a_second_after_work(monkeypatch):
    asked = []
    monkeypatch.setattr("gsrain_engine.malloc_tuning.trim_memory", lambda: asked.append(now[0]))
    now = [10.0]
    monkeypatch.setattr("gsrain_engine.malloc_tuning.time.monotonic", lambda: now[0])
    with ThreadPoolExecutor(1) as thread:
        memory = MemoryTrimmer(thread)
        memory.poll()
        for now[0] in (10.0, 10.9):  # goes on
            memory.note_work()
            memory.poll()
        for now[0] in (11.5, 12.0, 15.0):
            memory.poll()
    assert len(asked) == 1


def test_nothing_holds_on_to_a_closed_scene():
    editor = Editor(small_scene())
    occupied_space_of(editor.document.scene, road_surface_of(editor.document.scene))
    shelter_map_of(editor.document.scene)
    pivot(editor.document.scene, editor.document.scene.members[0].key)
    means = [weakref.ref(each.gaussians.means) for each in editor.document.scene.members]
    editor.files.close_scene()
    editor.tick(0.1)
    wait(editor.pending_files, timeout=60)
    gc.collect()
    assert means
    assert [each() for each in means] == [None] * len(means)
    editor.close()


def test_a_closed_scene_gives_its_memory_back(monkeypatch):
    returned = Event()
    monkeypatch.setattr("gsrain_engine.malloc_tuning.trim_memory", returned.set)
    monkeypatch.setattr("gsrain_engine.malloc_tuning._REST_S", 0.0)
    editor = Editor(small_scene())
    editor.files.close_scene()
    editor.tick(0.1)
    assert returned.wait(10)
    editor.close()
