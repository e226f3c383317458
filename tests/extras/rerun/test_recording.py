"""Roll-outs as Rerun recordings: what stands in the file, and when."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from app.main import BAD_INPUT, run
from gsrain_engine.scene.camera import Camera
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.rollout import CameraImage
from gsrain_extras.rerun.recording import MOST_POINTS, scene_points, write_rollout_rerun
from small_rollout import approach
from small_scene import small_scene


def test_points_stand_for_the_background_in_the_world():
    scene = small_scene()
    everywhere = np.mgrid[-250:250:50, -250:250:50].reshape(2, -1).T.astype(np.float64)
    points, colors, radii = scene_points(scene, 0.0, everywhere)
    background = [layer.gaussians for layer in scene.layers if layer.kind != "sky"]
    assert len(points) == len(colors) == len(radii) == sum(map(len, background)) <= MOST_POINTS
    np.testing.assert_allclose(points, np.concatenate([each.means for each in background]), atol=1e-6)
    assert np.abs(colors[0].astype(int) - np.rint(255 * np.array([0.35, 0.33, 0.30, 1]))).max() <= 1
    moved = replace(scene, metres_per_unit=2.0)
    farther, _, larger = scene_points(moved, 0.0, everywhere)
    np.testing.assert_allclose(farther, 2 * points, atol=1e-5)
    np.testing.assert_allclose(larger, np.minimum(2 * radii, 0.25), rtol=1e-5)
    assert len(scene_points(scene, 0.0, everywhere + 1e3)[0]) == 0


def test_files_of_another_kind_are_refused(tmp_path, capsys):
    assert run(["drive", "stationary-lead", "--rerun", str(tmp_path / "run.mcap"), "-o", str(tmp_path / "out")]) == 2
    assert "expected the name of a Rerun recording (.rrd)" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_recording(tmp_path):
    rerun = pytest.importorskip("rerun")
    pytest.importorskip("rerun.chunk")
    rollout = approach(moments=6, intensity_mm_h=8.5)
    camera = Camera.from_fov(64, 48, 60.0, np.eye(4))
    pictures = [CameraImage(step.step, "FRONT", np.full((48, 64, 3), 90, np.uint8), camera) for step in rollout.steps]
    route = Route(np.array([[0.0, 0], [50, 0]]))
    write_rollout_rerun(tmp_path / "run.rrd", rollout, small_scene(), route, pictures)
    stored = rerun.chunk.RrdReader(tmp_path / "run.rrd")
    chunks = list(stored.stream())
    entities = {chunk.entity_path for chunk in chunks}
    for name in ("/world/scene", "/world/route", "/world/ego", "/world/road_users", "/world/plan", "/world/camera",
                 "/motion/speed_m_s", "/log"):  # fmt: skip
        assert name in entities
    speeds = [chunk for chunk in chunks if chunk.entity_path == "/motion/speed_m_s"]
    assert sum(chunk.num_rows for chunk in speeds) == len(rollout.steps)
    with pytest.raises(ValueError, match="picture of step"):
        write_rollout_rerun(tmp_path / "bad.rrd", rollout, pictures=[pictures[1], pictures[0]])
    assert [each.name for each in tmp_path.iterdir()] == ["run.rrd"]


@pytest.mark.parametrize("asked", [["--rerun", "{folder}/a.rrd"], ["--export", "rerun"]])
def test_without_its_package_nothing_is_driven(asked, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    words = [each.format(folder=tmp_path) for each in asked]
    assert run(["drive", *words, "-o", str(tmp_path / "out")]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"gsrain: {asked[0]}") and "needs rerun-sdk, which is not installed: " in line
    assert line.endswith("'gsrain[rerun]'") and not list(tmp_path.iterdir())
