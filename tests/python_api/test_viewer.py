"""The window that a program opens: `gr.Viewer` and `gr.show`, in the real window, a process of its own."""

import io
import os
import shutil
import signal

import numpy as np
import psutil
import pytest
from PIL import Image

import gsrain as gr
from extension_package import titled_blocks
from gsrain.viewer_messages import REQUESTS, GetState, Reply, SetRain, receive, send
from gsrain_engine.scene.formats.scene_files import write_scene
from repository import REPOSITORY
from small_scene import small_scene

WINDOW_S = 600.0  # the machine may be busy
needs_display = pytest.mark.skipif(
    not (os.environ.get("DISPLAY") or shutil.which("Xvfb")), reason="no display and no Xvfb (Debian: xvfb)"
)


SMALLER = (
    ("(960, 640)", "(192, 128)"), ("seconds=6)", "seconds=0.2)"), ("fps=30", "fps=10, size=(192, 128)"),
    ("path, fps=10)", "path, fps=10, size=(192, 128))"), ("gr.show(", "v.close(); gr.show("),
)  # fmt: skip


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def window_of_this_process():
    (window,) = [each for each in psutil.Process().children() if "app.viewer_window" in each.cmdline()]
    return window


@needs_display
def test_what_is_set_is_shown_and_what_is_shown_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr("gsrain.viewer._END_S", WINDOW_S)
    (tmp_path / "app").mkdir()
    (tmp_path / "app" / "__init__.py").write_text("raise SystemExit('this is the app of somebody else')")
    monkeypatch.chdir(tmp_path)
    scene = small_scene()
    with gr.Viewer(scene, timeout=WINDOW_S) as viewer:
        assert viewer.is_open and viewer.scene is scene and viewer.rain == gr.Rain()
        clear = pixels(viewer.screenshot("shots/clear.png"))
        viewer.rain = gr.Rain(intensity=12)
        rainy = pixels(viewer.screenshot(tmp_path / "shots" / "rainy.png"))
        assert viewer.rain.intensity_mm_h == 12
        assert rainy.shape == clear.shape and np.abs(rainy - clear).max() > 4
        home = gr.home_camera(scene)
        viewer.rain, viewer.camera = gr.Rain(), gr.Camera.from_fov(
            96, 64, 30.0, gr.look_at(home.position + [5, 1, 1], home.position + [20, 0, 0], np.array([0.0, 0, 1]))
        )  # fmt: skip
        assert viewer.camera.position == pytest.approx(home.position + [5, 1, 1])
        assert viewer.camera.vertical_fov_deg == pytest.approx(30)
        near = pixels(viewer.screenshot("shots/near.png"))
        assert np.abs(near - clear).mean() > 1
        viewer.scene = gr.Scene("half", scene.layers[:1])
        assert np.abs(pixels(viewer.screenshot("shots/half.png")) - near).mean() > 1
        with pytest.raises(gr.ViewerError, match=r"clear\.png/shot\.png: the screenshot can't be saved"):
            viewer.screenshot("shots/clear.png/shot.png")
        assert not viewer.wait(0)
    assert not viewer.is_open and viewer.wait(0) and "closed" in repr(viewer)
    viewer.close()
    with pytest.raises(gr.ViewerError, match="the viewer window is closed"):
        viewer.rain = gr.Rain()


@needs_display
def test_a_program_edits_the_open_window():
    scene = small_scene()
    window = gr.show(scene, gr.Rain(5), block=False, timeout=WINDOW_S)
    with window:
        assert window.steps == ["Opened", "Rain of a program"]
        before = window.picture()
        window.select("all")
        assert all(layer.marks.selected for layer in window.scene.layers) and scene.layers[0].marks.selected is None
        window.edit("rename", key="layers/wall", name="facade")
        window.edit("set-visible", key="layers/facade", visible=False)
        window.edit("change-rain", intensity_mm_h=9.0)
        assert window.rain.intensity_mm_h == 9.0
        assert window.steps[2:] == ["Select all", "Rename", "Set visible", "Change rain"]
        assert np.abs(window.picture().astype(int) - before).max() > 20
        assert [layer.name for layer in window.scene.layers] == ["road", "facade", "sky"]
        window.undo()
        window.undo()
        assert window.rain.intensity_mm_h == 5.0 and window.scene.layers[1].visible
        window.redo()
        assert not window.scene.layers[1].visible and window.steps[-1] == "Set visible"
        for name, arguments, said in (
            ("paint", {}, "paint: no such edit"), ("rename", {"key": "layers/wall"}, "rename: needs name"),
            ("reverse-path", {}, "no camera path"), ("select-color", {"mode": "not"}, "select-color"),
        ):  # fmt: skip
            with pytest.raises(gr.ViewerError, match=said):
                window.edit(name, **arguments)
        assert window.steps[-1] == "Set visible" and window.is_open
        window.scene = scene
        assert window.scene is scene
    assert not window.is_open


@needs_display
def test_a_window_that_dies_gives_one_sentence():
    viewer = gr.Viewer(small_scene(), gr.Rain(5), timeout=WINDOW_S)
    window_of_this_process().send_signal(signal.SIGKILL)
    with pytest.raises(gr.ViewerError, match=r"the viewer window has died \(signal 9\): open another gr\.Viewer"):
        viewer.screenshot("shot.png")
    with pytest.raises(gr.ViewerError, match="died"):
        viewer.wait()
    viewer.close()


@needs_display
def test_a_window_that_does_not_reply_is_not_waited_for_forever():
    with gr.Viewer(small_scene(), timeout=0.2) as viewer:
        window = window_of_this_process()
        window.suspend()
        with pytest.raises(gr.ViewerError, match=r"0\.2 s"):
            viewer.rain  # noqa: B018
        window.kill()


def test_without_a_display_it_says_so(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(gr.ViewerError, match="the viewer window has ended: no display"):
        gr.show(small_scene())


@needs_display
def test_the_whole_example_runs_with_smaller_pictures(tmp_path, monkeypatch):
    write_scene(small_scene(), tmp_path / "street")
    monkeypatch.chdir(tmp_path)
    # Where a person would close the window, the test does.
    monkeypatch.setattr(gr.Viewer, "wait", lambda viewer: viewer.screenshot("last.png") and viewer.close())
    names = {}
    tour = titled_blocks(REPOSITORY / "docs" / "python.md")["tour.py"]
    for whole, small in SMALLER:
        assert whole in tour
        tour = tour.replace(whole, small)
    exec(compile(tour, "tour.py", "exec"), names)
    for name in ("rain.png", "shot.png", "last.png"):
        assert pixels(name).std() > 5
    assert names["run"].rollout == gr.read_rollout("run.jsonl")
    beside = titled_blocks(REPOSITORY / "docs" / "python.md")["beside.py"]
    exec(compile(beside, "beside.py", "exec"), names)
    assert names["picture"].std() > 5 and not names["window"].is_open
    assert (tmp_path / "rain.mp4").stat().st_size and (tmp_path / "rain.clear.mp4").stat().st_size


def test_messages_are_whole_or_none():
    sent = SetRain(number=7, rain=gr.Rain(8.5))
    file = io.BytesIO()
    send(file, sent)
    send(file, GetState(number=8))
    file.seek(0)
    assert receive(file, REQUESTS) == sent and receive(file, REQUESTS) == GetState(number=8)
    assert receive(file, REQUESTS) is None
    assert receive(io.BytesIO(file.getvalue()[:20]), REQUESTS) is None
    with pytest.raises(ValueError, match="number"):
        receive(io.BytesIO(b"{}\n"), Reply)
