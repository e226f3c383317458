"""Choice of the renderer by timed frames."""

import pytest

from gsrain_engine import backends
from gsrain_engine.backends import DeviceSpeed, measure_device, open_renderer, rasterizer_for
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl.context import is_software, open_context


@pytest.fixture
def context(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    opened = open_context("egl")
    with opened:
        yield opened
    opened.release()


@pytest.mark.parametrize(
    ("frame_ms", "rasterizer", "is_cpu_fastest"),
    [
        ({}, "quads", True),
        ({"opengl-tiles": 2.0, "opengl-quads": 35.0}, "tiles", False),
        ({"opengl-tiles": 9.0, "opengl-quads": 7.0, "cpu": 40.0}, "quads", False),
        ({"opengl-tiles": 60.0, "opengl-quads": 70.0, "cpu": 40.0}, "tiles", True),
    ],
)
def test_the_fastest_is_chosen(frame_ms, rasterizer, is_cpu_fastest):
    speed = DeviceSpeed(frame_ms=frame_ms)
    assert (speed.rasterizer, speed.is_cpu_fastest) == (rasterizer, is_cpu_fastest)
    assert [rasterizer_for(each, speed) for each in ("opengl", "opengl-tiles", "opengl-quads")] == [
        rasterizer,
        "tiles",
        "quads",
    ]
    assert all(name in speed.reason for name in frame_ms)


def test_nothing_is_timed_on_a_software_rasterizer(context, monkeypatch):
    if not is_software(context):
        pytest.skip("a GPU executes OpenGL here")
    monkeypatch.setattr(backends, "time_frame_ms", lambda renderer: pytest.fail("timed"))
    assert measure_device(context) == DeviceSpeed()
    for backend, way in (("opengl", "quads"), ("opengl-tiles", "tiles"), ("opengl-quads", "quads")):
        with open_renderer(backend) as renderer:
            assert (renderer.name, renderer.rasterizer) == ("opengl", way)
    with open_renderer("auto") as renderer:
        assert isinstance(renderer, CpuRenderer)


def test_a_device_is_timed_once_and_a_damaged_file_once_more(context, monkeypatch, tmp_path):
    timed = []

    def frame_ms(renderer):
        timed.append(getattr(renderer, "rasterizer", renderer.name))
        return {"tiles": 20.0, "quads": 30.0, "cpu": 25.0}[timed[-1]]

    monkeypatch.setattr(backends, "time_frame_ms", frame_ms)
    monkeypatch.setattr(backends, "is_software", lambda context: False)
    first = measure_device(context)
    assert (first.rasterizer, first.is_cpu_fastest, timed) == ("tiles", False, ["tiles", "quads", "cpu"])
    assert measure_device(context) == first
    assert len(timed) == 3
    (file,) = tmp_path.rglob("devices/*.json")
    file.write_text("{")
    assert measure_device(context) == first
    assert len(timed) == 6


def test_a_frame_is_timed_with_its_read_back(monkeypatch):
    monkeypatch.setattr(backends, "_TIMED_SCENE", "random-100")
    assert 0 < backends.time_frame_ms(CpuRenderer()) < 1000
