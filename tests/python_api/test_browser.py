"""The window in a browser: `gr.BrowserViewer`, asked as viser's page does, over its WebSocket."""

import io
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from http.client import HTTPConnection
from importlib import import_module
from types import SimpleNamespace
from typing import ClassVar
from urllib.parse import urlsplit

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
ConnectionClosed, InvalidStatus = (
    getattr(pytest.importorskip("websockets.exceptions"), name) for name in ("ConnectionClosed", "InvalidStatus")
)
zstandard = pytest.importorskip("zstandard")
WAIT_S = 120.0  # the machine may be busy


def connected(url, **options):
    """A WebSocket as viser's page opens it."""
    protocol = f"viser-v{viser.__version__}"
    address = url.replace("http", "ws")
    return client.connect(address, subprotocols=[protocol], max_size=None, ping_interval=None, **options)


class Browser:
    """A connection that looks through a camera, and keeps what it is sent."""

    def __init__(self, url, camera):
        self.connection = connected(url)
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

    def pictures(self):
        """Pictures at rest."""
        while True:
            for message in self.messages():
                if message["type"] == "BackgroundImageMessage" and message["format"] == "png" and message["rgb_data"]:
                    with Image.open(io.BytesIO(message["rgb_data"])) as image:
                        yield np.asarray(image).astype(int)

    def shows(self, expected):
        """Wait until a picture at rest is the expected one; its camera has passed through a quaternion."""
        for found in self.pictures():
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
            gr.BrowserViewer(scene, port=urlsplit(page.url).port)
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


@pytest.fixture(scope="module")
def page():
    with gr.BrowserViewer(small_scene(), gr.Rain(3), backend="cpu", port=0, browsers=2, token="a-token") as page:
        yield page


SOUND = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0, 0, 0], "position": [0.0, 0, 2], "look_at": [1.0, 0, 2],
    "up_direction": [0.0, 0, 1], "fov": 1.0, "near": 0.01, "far": 100.0, "image_height": 32, "image_width": 48,
}  # fmt: skip


def update(control, **updates):
    return {"type": "GuiUpdateMessage", "uuid": control, "updates": updates}


def refused(url, message):
    """Return whether the sender of a message is disconnected, with a reason."""
    with connected(url) as connection:
        connection.send(msgspec.msgpack.encode(message) if isinstance(message, dict) else message)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                connection.recv(10)
    return closed.value.rcvd is not None and closed.value.rcvd.code in (1008, 1009)


def test_a_browser_sends_cameras_and_values_and_nothing_else(page, monkeypatch):
    opened = []
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda *_, **__: opened.append("a public tunnel"))
    camera, other = views(small_scene())
    person = Browser(page.url, camera)
    assert person.shows(gr.render(small_scene(), gr.Rain(3), camera, backend="cpu").rgb.astype(int))
    kinds = {each.__name__ for each in import_module("viser._messages").Message.get_subclasses()} - {
        "GuiUpdateMessage",
        SOUND["type"],
    }
    assert {"ShareUrlRequest", "FileTransferStartUpload", "FileTransferPart"} <= kinds
    slider = person.controls["Time (s)"]
    for kind in sorted(kinds)[:: len(kinds) // 12] + ["ShareUrlRequest", "FileTransferStartUpload"]:
        assert refused(page.url, {"type": kind, "source_component_uuid": slider, "part_count": 0}), kind
    wrong = [{**SOUND, name: [1.0] * count} for name in ("wxyz", "position", "look_at") for count in (0, 2, 5)]
    wrong += [{**SOUND, "fov": None}, {**SOUND, "image_width": "wide"}, {**SOUND, "more": 1}]
    wrong += [update(slider, value=each) for each in (None, "1", True, [1.0], float("nan"), float("inf"), 1e308)]
    wrong += [update(person.controls["Streak region, from (m)"], value=[1.0] * count) for count in (0, 2, 4)]
    wrong += [update(person.controls["Preset"], value="/etc/passwd"), update(person.controls["Play"], value="x")]
    wrong += [update(slider, update_cb=[]), update(slider, value=1.0, removed=True), "text", b"", b"\xc1" * 9]
    wrong += [b"\x91" * 10_000, bytes(17 << 10)]
    for message in wrong:
        assert refused(page.url, message), message
    for endless in (float("nan"), float("inf"), 1e308):
        person.connection.send(msgspec.msgpack.encode({**SOUND, "fov": endless}))  # as of a page without a size
    person.look(other)
    assert person.shows(gr.render(small_scene(), page.rain, other, backend="cpu").rgb.astype(int))
    assert page.rain == gr.Rain(3) and page.is_open and opened == []
    person.connection.close()


def status_of(page, path, **headers):
    connection = HTTPConnection("127.0.0.1", urlsplit(page.url).port, timeout=WAIT_S)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    status = connection.getresponse().status
    connection.close()
    return status


def test_the_page_is_for_those_who_have_its_address(page):
    host, path = f"localhost:{urlsplit(page.url).port}", urlsplit(page.url).path
    assert path == "/a-token"
    for mine in (host, "localhost:9000", "127.0.0.1", "[::1]:80"):  # a forwarded port has another number
        assert status_of(page, f"{path}/", Host=mine) == 200
    for strange in (
        "example.org",
        "localhost.example.org",
        "127.0.0.1.example.org:8080",
        "me@localhost",
        "10.0.0.1",
        "",
    ):
        assert status_of(page, path, Host=strange) == 403, strange
    assert status_of(page, path) == 403
    for other in ("/", "/a-toke", "/a-token-", "/b-token/index.html", "/%61-token/../x"):
        assert status_of(page, other, Host=host) == 404, other
    for origin in ("http://example.org", "null", "https://" + host, "http://localhost:1"):
        assert status_of(page, path, Host=host, Origin=origin) == 403, origin
        with pytest.raises(InvalidStatus) as answer:
            connected(page.url, origin=origin)
        assert answer.value.response.status_code == 403, origin
    connected(page.url, origin=f"http://{host}").close()
    with pytest.raises(InvalidStatus):
        connected(page.url.replace(path, ""))
    with pytest.raises(ValueError, match="--token"):
        gr.BrowserViewer(small_scene(), port=0, token="pässword")
    with ExitStack() as stack, pytest.raises(InvalidStatus) as answer:
        for _ in range(30):
            stack.enter_context(connected(page.url))
    assert answer.value.response.status_code == 503
