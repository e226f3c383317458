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

from gsrain_engine.editor.editor import Editor
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
def session():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def settle(session):
    """Let background work end and take it in, without a live view that would upload it first."""
    wait(session.pending_files, timeout=60)
    session.update(0.0)
    session.swap_in()


def test_rain_changes_are_undone_and_the_rainfall_follows(session):
    session.change_rain("Intensity", "drag", intensity_mm_h=4.0)
    session.change_rain("Intensity", "drag", intensity_mm_h=5.0)
    session.end_gesture()
    assert session.rainfall.state.intensity_mm_h == 5
    session.undo()
    assert session.rain.intensity_mm_h == 0
    assert session.rainfall.state.drops == 0
    session.redo()
    assert session.rainfall.state.intensity_mm_h == 5


def test_moving_the_slider_moves_no_drop(session):
    session.change_rain("Intensity", intensity_mm_h=4.0)
    session.update(10.0)
    before = displacement(session.rainfall.motion, session.clock.time_s)
    session.change_rain("Intensity", intensity_mm_h=4.5)
    assert np.allclose(displacement(session.rainfall.motion, session.clock.time_s), before)


def test_time_goes_on_in_real_seconds_while_it_plays(session):
    session.update(0.5)
    session.clock.toggle()
    session.update(0.5)
    assert session.clock.time_s == 0.5
    session.clock.toggle()
    session.clock.speed = 2.0
    session.update(0.25)
    assert session.clock.time_s == 1.0


def test_open_and_save(session, tmp_path):
    write_scene(small_scene("other"), tmp_path / "other")
    session.open(str(tmp_path / "other"))
    assert session.busy == f"Opening {tmp_path / 'other'}"
    settle(session)
    assert session.scene.name == "other"
    assert session.history.undo_label is None
    session.change_rain("Intensity", intensity_mm_h=7.0)
    session.save(tmp_path / "saved")
    settle(session)
    saved = read_scene(tmp_path / "saved")
    assert saved.rain["intensity_mm_h"] == 7.0
    session.open(str(tmp_path / "saved"))
    settle(session)
    assert session.rain.intensity_mm_h == 7.0


@pytest.mark.parametrize("content", [None, b"not a scene"])
def test_what_cannot_be_opened_is_told_and_nothing_is_lost(session, tmp_path, content):
    path = tmp_path / "bad.ply"
    if content is not None:
        path.write_bytes(content)
    before = session.scene
    session.open(str(path))
    settle(session)
    assert session.scene is before
    assert "bad.ply" in session.log.lines[-1].text


def test_a_scene_with_unusable_rain_opens_all_the_same(session, tmp_path):
    from dataclasses import replace

    write_scene(replace(small_scene(), rain={"intensity_mm_h": 1000.0}), tmp_path / "wild")
    session.open(str(tmp_path / "wild"))
    settle(session)
    assert session.scene.name == "small"
    assert session.rain.intensity_mm_h == 0
    assert any("rain can't be used" in line.text for line in session.log.lines)


def test_riding_along_follows_the_ego(session):
    session.view.follow_path = True
    session.update(2.0)
    shot = session.shot(96, 64)
    assert shot.camera.position == pytest.approx([4.0, 0, 1.5])
    assert shot.velocity_m_s == pytest.approx([2.0, 0, 0])


def test_screenshots_never_overwrite(session, tmp_path):
    session.take_screenshot(tmp_path)
    first = session.screenshot
    first.write_text("taken")
    session.take_screenshot(tmp_path)
    assert session.screenshot != first


def test_rain_saved_with_a_scene_is_plain_values(session):
    assert msgspec.json.decode(msgspec.json.encode(msgspec.to_builtins(session.rain)))["intensity_mm_h"] == 0


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


def test_region_edges_are_cut_at_the_camera(session):
    session.view.show_streak_region = session.view.show_haze_region = True
    outlines = region_outlines(session, 300, 200)
    assert [outline.name for outline in outlines] == ["streak region", "haze region"]
    for outline in outlines:
        assert np.isfinite(outline.lines_px).all()
        assert 0 < len(outline.lines_px) <= 12
    anchor = np.eye(4)
    anchor[0, 3] = 20.0  # all in front
    lines = project_edges(session.rain.streak_region, anchor, session.shot(300, 200).camera)
    assert len(lines) == 12


def test_roofs_are_found_behind_the_window_and_rain_falls_through_them_until_then():
    session = Editor(small_scene(), RainSettings(intensity_mm_h=8.5, roofs=True))
    assert session.busy == "Finding roofs"
    assert not session.split_panes[0].rainfall.rain.roofs
    session.update(0.0)
    wait(session.pending_files, timeout=60)
    assert session.busy is None
    assert session.split_panes[0].rainfall is session.rainfall
    session.show_member(session.scene.layers[0].key, visible=False)  # another scene, as seen from above
    assert session.busy == "Finding roofs"
    session.close()


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
    session = Editor(small_scene())
    occupied_space_of(session.scene, road_surface_of(session.scene))
    shelter_map_of(session.scene)
    pivot(session.scene, session.scene.members[0].key)
    means = [weakref.ref(each.gaussians.means) for each in session.scene.members]
    session.files.close_scene()
    session.update(0.1)
    wait(session.pending_files, timeout=60)
    gc.collect()
    assert means
    assert [each() for each in means] == [None] * len(means)
    session.close()


def test_a_closed_scene_gives_its_memory_back(monkeypatch):
    returned = Event()
    monkeypatch.setattr("gsrain_engine.malloc_tuning.trim_memory", returned.set)
    monkeypatch.setattr("gsrain_engine.malloc_tuning._REST_S", 0.0)
    session = Editor(small_scene())
    session.files.close_scene()
    session.update(0.1)
    assert returned.wait(10)
    session.close()
