"""The window in a browser: `gr.BrowserViewer`, asked as viser's page does, over its WebSocket."""

import io
import threading
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import msgspec
import numpy as np
import pytest
from PIL import Image

import gsrain as gr
from extension_package import titled_blocks
from gsrain.browser_panel import RainPanel
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.geometry import quaternions_from_matrices
from repository import REPOSITORY
from small_scene import small_scene

viser = pytest.importorskip("viser")
client = pytest.importorskip("websockets.sync.client")
zstandard = pytest.importorskip("zstandard")
WAIT_S = 120.0  # the machine may be busy


class Browser:
    """A connection that looks through a camera, and keeps what it is sent."""

    def __init__(self, url, camera):
        protocol = f"viser-v{viser.__version__}"
        self.connection = client.connect(
            url.replace("http", "ws"), subprotocols=[protocol], max_size=None, ping_interval=None
        )
        self.controls = {}
        self.look(camera)

    def send(self, kind, **values):
        self.connection.send(msgspec.msgpack.encode({"type": kind, **values}))

    def look(self, camera):
        pose = camera.camera_to_world
        self.send(
            "ViewerCameraMessage", wxyz=quaternions_from_matrices(pose[:3, :3]).tolist(), position=pose[:3, 3].tolist(),
            fov=float(np.radians(camera.vertical_fov_deg)), near=0.01, far=1000.0,
            look_at=(pose[:3, 3] + pose[:3, 2]).tolist(), up_direction=[0.0, 0.0, 1.0],
            image_width=camera.width, image_height=camera.height,
        )  # fmt: skip

    def set(self, label, value):
        self.send("GuiUpdateMessage", uuid=self.controls[label], updates={"value": value})

    def messages(self):
        window = self.connection.recv(WAIT_S)
        end = 16 + int.from_bytes(window[8:16], "little")
        content = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(window[16:end]))
        for message in content["messages"]:
            if "uuid" in message and "label" in message.get("props", {}):
                self.controls[message["props"]["label"]] = message["uuid"]
            yield message

    def shows(self, expected):
        """Wait until a picture at rest is the expected one; its camera has passed through a quaternion."""
        while True:
            for message in self.messages():
                if message["type"] == "BackgroundImageMessage" and message["format"] == "png" and message["rgb_data"]:
                    with Image.open(io.BytesIO(message["rgb_data"])) as image:
                        found = np.asarray(image).astype(int)
                    if found.shape == expected.shape and np.abs(found - expected).max() <= 2:
                        return True

    def notice(self):
        while True:
            for message in self.messages():
                if message["type"] == "NotificationShowMessage":
                    return message["props"]["body"]


def views(scene):
    camera = gr.home_camera(scene, (96, 64))
    turned = gr.look_at(camera.position, camera.position + [1.0, 0.4, 0.0], np.array([0.0, 0, 1]))
    return camera, gr.Camera.from_fov(80, 48, 40.0, turned)


def test_each_browser_has_its_view_in_the_rain_that_one_of_them_sets(capsys):
    scene, before = small_scene(), set(threading.enumerate())
    first, second = views(scene)

    def expected(rain, camera):
        return gr.render(scene, rain, camera, backend="cpu").rgb.astype(int)

    with gr.BrowserViewer(scene, gr.Rain(3), backend="cpu", port=0, browsers=2) as page:
        ours, other = Browser(page.url, first), Browser(page.url, second)
        assert ours.shows(expected(gr.Rain(3), first)) and other.shows(expected(gr.Rain(3), second))
        ours.set("Intensity (mm/h)", 12.0)
        heavy = expected(gr.Rain(12), first)
        assert np.abs(heavy - expected(gr.Rain(3), first)).max() > 4
        assert ours.shows(heavy) and other.shows(expected(gr.Rain(12), second))
        assert page.rain == gr.Rain(12) and page.browsers == 2
        other.look(replace(first, world_to_camera=np.full((4, 4), np.nan)))  # changes nothing
        page.rain = gr.Rain.preset("8.5")
        assert ours.shows(expected(page.rain, first)) and other.shows(expected(page.rain, second))
        other.look(first)
        assert other.shows(expected(page.rain, first))
        assert "2 show this page already" in Browser(page.url, first).notice()
        with pytest.raises(OSError, match=r"port \d+ can't be opened: .*; choose another one, or 0"):
            gr.BrowserViewer(scene, port=int(page.url.rpartition(":")[2]))
    assert not page.is_open and page.browsers == 0 and capsys.readouterr() == ("", "")
    for thread in set(threading.enumerate()) - before:
        if not thread.name.startswith("ThreadPoolExecutor"):  # viser's, which are idle
            thread.join(WAIT_S)
            assert not thread.is_alive(), thread.name
    with pytest.raises(gr.ViewerError, match="is closed"):
        page.rain = gr.Rain()


class Gui:
    """A panel of viser that nobody sees."""

    def __getattr__(self, name):
        def add(label, *values, initial_value=None, options=(), **rest):
            initial = values[-1] if initial_value is None else initial_value
            return Handle(label, initial, values[0] if name == "add_dropdown" else options, rest)

        return add

    @contextmanager
    def add_folder(self, *_, **__):
        yield


class Handle:
    """A control of that panel."""

    made: ClassVar = {}

    def __init__(self, label, value, options, rest):
        self.value, self.options, self.visible = value, options, rest.get("visible", True)
        self.max = rest.get("max", 1.0)
        self.made[f"{label}, value" if label in self.made else label] = self

    def on_update(self, call):
        self.call = call

    def update(self, value, client):
        self.value = value
        self.call(SimpleNamespace(client=client, target=self))


class Person:
    """A client that notes what it is told."""

    def __init__(self):
        self.notices = []

    def add_notification(self, title, body, **_):
        self.notices.append(body)


def test_the_panel_has_the_settings_of_the_rain_and_refuses_what_is_none():
    changes, person = [], Person()
    panel = RainPanel(Gui(), gr.Rain(3), changes.append)
    controls = Handle.made
    for name in shipped_config_names("rain"):
        panel.display(gr.Rain.preset(name))
        assert changes == []
        for label, value in ((each, controls[each].value) for each in ("Streaks", "Haze model", "Preset")):
            controls[label].update(value, None)  # as viser calls back for a program's change
        assert changes == []
        controls["Seed"].update(7, person)
        assert changes.pop() == msgspec.structs.replace(gr.Rain.preset(name), seed=7), name
    panel.display(gr.Rain(50))
    assert controls["Intensity (mm/h)"].max == 50
    controls["Fog visibility"].update(True, person)
    assert changes.pop().visibility_m == 500 and controls["Fog visibility (m)"].visible
    controls["Fog visibility"].update(False, person)
    assert changes.pop().visibility_m is None and not controls["Fog visibility (m)"].visible
    controls["Streak region, from (m)"].update((9.0, 0.0, 0.0), person)  # beyond its other corner
    assert changes == [] and "minimum < maximum" in person.notices.pop()
    assert controls["Streak region, from (m)"].value == gr.Rain().streak_region.minimum_m
    controls["Light sources"].update(True, person)
    assert changes.pop().lamps == "auto"
    controls["Light sources, value"].update("/etc/passwd", person)  # a browser does not open files of this machine
    controls["Preset"].update("/etc/passwd", person)
    assert changes == []
    controls["Preset"].update("paper", person)
    assert changes.pop() == gr.Rain.preset("paper")


def test_the_program_of_the_page_runs(tmp_path, monkeypatch, capsys):
    write_scene(small_scene(), tmp_path / "street")
    monkeypatch.chdir(tmp_path)
    exec(compile(titled_blocks(REPOSITORY / "docs" / "python.md")["browser.py"], "browser.py", "exec"), {})
    address, rate = capsys.readouterr().out.splitlines()
    assert address.startswith("http://localhost:") and rate == "12.0"
