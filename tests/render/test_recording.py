"""Recordings: their settings, file names and equivalent command lines."""

import shlex

import msgspec
import pytest
from cyclopts import App

from app.render import RecordingOptions, export_settings
from gsrain_engine.render.export import export_command
from gsrain_engine.render.export_settings import ExportSettings, export_files, export_outputs
from gsrain_engine.safe_io.errors import convert_checked


@pytest.mark.parametrize(
    ("field", "fields"),
    [
        ("supersampling", {"supersampling": 5}), ("motion_blur", {"motion_blur": 0}),
        ("size_px[0]", {"size_px": (0, 64)}), ("passes[0]", {"passes": ("colr",)}), ("passes", {"passes": ()}),
        ("last_s", {"first_s": 2.0, "last_s": 2.0}), ("quality", {"quality": 52}),
        ("quality", {"output": "a.jpg", "quality": 0}), ("`quality`?", {"qualitee": 1}),
    ],
)  # fmt: skip
def test_what_is_out_of_bounds_is_named(field, fields):
    with pytest.raises(msgspec.ValidationError) as error:
        convert_checked({"output": "a.mp4", **fields}, ExportSettings)
    assert field in str(error.value)


@pytest.mark.parametrize(
    ("words", "fields"),
    [
        ("a.gif", {"output": "a.gif"}), (".mp4", {"output": "a.webm", "codec": "h264"}),
        (".webm", {"output": "frames", "codec": "vp9"}), (".exr or nothing", {"output": "a.mp4", "codec": "exr"}),
        ("output is empty", {"output": " "}), ("depth", {"output": "a.jpg", "passes": ("color", "depth")}),
        ("alpha", {"output": "a", "codec": "jpeg", "passes": ("alpha",)}),
        (".jpg or .jpeg or nothing", {"output": "a.png", "codec": "jpeg"}),
        ("64x63", {"output": "a.webm", "size_px": (64, 63)}),
    ],
)  # fmt: skip
def test_what_contradicts_itself_is_refused(words, fields):
    with pytest.raises(ValueError) as error:
        ExportSettings(**fields).check()
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("fields", "cameras", "expected"),
    [
        ({"output": "a.mp4"}, [""], ["a.mp4"]),
        ({"output": "a.mp4", "twin": "sunny"}, [""], ["a.mp4", "a.clear.mp4"]),
        ({"output": "a.mp4", "passes": ("color", "depth")}, [""], ["a.mp4", "a.depth"]),
        ({"output": "a.mp4", "passes": ("labels",), "twin": "sunny"}, [""], ["a.labels"]),
        ({"output": "a.png", "passes": ("color", "alpha", "labels")}, [""], ["a.png", "a.alpha.png", "a.labels.png"]),
        ({"output": "a.npy", "passes": ("color", "depth")}, [""], ["a.npy", "a.depth.npy"]),
        ({"output": "a.exr", "passes": ("color", "depth", "labels")}, [""], ["a.exr", "a.labels.png"]),
        ({"output": "a", "passes": ("color", "depth")}, [""], ["a"]),
        ({"output": "a.mp4"}, ["FRONT", "REAR"], ["a/FRONT.mp4", "a/REAR.mp4"]),
        ({"output": "a", "codec": "av1", "twin": "sunny"}, ["L/R", "B"],
         ["a/L_R.webm", "a/L_R.clear.webm", "a/B.webm", "a/B.clear.webm"]),
        ({"output": "a"}, ["FRONT", "REAR"], ["a/FRONT", "a/REAR"]),
    ],
)  # fmt: skip
def test_files_are_called(fields, cameras, expected):
    assert [path.as_posix() for path in export_outputs(ExportSettings(**fields), cameras)] == expected


def test_long_names_of_cameras_are_shortened_and_stay_apart():
    paths = export_outputs(ExportSettings(output="a", codec="jpeg", twin="sunny"), ["F" * 300, "F" * 301])
    assert len(set(paths)) == 4
    assert all(len(path.name) < 200 for path in paths)


@pytest.mark.parametrize(
    ("fields", "color", "depth", "legend"),
    [
        ({"output": "run"}, "run/000007.png", "run/000007.depth.png", "run/labels.json"),
        ({"output": "run", "codec": "jpeg"}, "run/000007.jpg", "run/000007.depth.png", "run/labels.json"),
        ({"output": "run.mp4"}, "run.mp4", "run.depth/000007.png", "run.labels/labels.json"),
        ({"output": "still.npy"}, "still.npy", "still.depth.npy", "still.labels.json"),
    ],
)
def test_passes_are_stored_next_to_their_frames(fields, color, depth, legend):
    files = export_files(ExportSettings(**fields), None)
    assert [str(each) for each in (files.color(7), files.pass_file(7, "depth"), files.legend)] == [color, depth, legend]


@pytest.mark.parametrize(
    "fields",
    [
        {"output": "a b.mp4"},
        {"output": "frames", "size_px": (640, 360), "fps": 23.976, "first_s": -0.1, "last_s": 1.1, "codec": "exr"},
        {"output": "a.webm", "codec": "av1", "quality": 40, "supersampling": 2, "motion_blur": 8, "twin": "sunny"},
        {"output": "rig.mp4", "cameras": ("one/FRONT", "two"), "passes": ("color", "labels")},
    ],
)
def test_the_command_line_says_the_same(fields):
    recording, said = ExportSettings(**fields), []

    def render(scene: str, /, *, recording: RecordingOptions):
        said.append((scene, export_settings(recording, with_depth=False)))

    program, *words = shlex.split(export_command(recording, "my scene"))
    assert (program, words[0]) == ("gsrain", "render")
    app = App()
    app.default(render)
    app(words[1:], result_action="return_value")
    project, understood = said[0]
    assert project == "my scene"
    assert msgspec.structs.replace(understood, codec="auto") == msgspec.structs.replace(recording, codec="auto")
    assert understood.format == recording.format
