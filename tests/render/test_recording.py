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
    ("fields", "words"),
    [
        ({"supersampling": 5}, "<= 4 - at `$.supersampling`"),
        ({"motion_blur": 0}, ">= 1 - at `$.motion_blur`"),
        ({"size_px": (0, 64)}, ">= 1 - at `$.size_px[0]`"),
        ({"passes": ("colr",)}, "'colr', expected alpha, color, depth, labels - at `$.passes[0]`"),
        ({"passes": ()}, "length >= 1 - at `$.passes`"),
        ({"first_s": 2.0, "last_s": 2.0}, "last_s must be above first_s (2 s)"),
        ({"quality": 52}, "quality must be within 0..51 (H.264)"),
        ({"output": "a.jpg", "quality": 0}, "quality must be within 1..100 (JPEG)"),
        ({"qualitee": 1}, "did you mean `quality`? valid: output, size_px, fps, first_s"),
        ({"qualitee": 1}, "unknown field `qualitee`"),
    ],
)
def test_what_is_out_of_bounds_is_named(fields, words):
    with pytest.raises(msgspec.ValidationError) as error:
        convert_checked({"output": "a.mp4", **fields}, ExportSettings)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"output": "a.gif"}, "a.gif: an output ends in .png"),
        ({"output": "a.webm", "codec": "h264"}, "h264 needs an output that ends in .mp4"),
        ({"output": "frames", "codec": "vp9"}, "vp9 needs an output that ends in .webm"),
        ({"output": "a.mp4", "codec": "exr"}, "exr needs an output that ends in .exr or nothing (a folder)"),
        ({"output": " "}, "output is empty"),
        ({"output": "a.jpg", "passes": ("color", "depth")}, "JPEG holds colors alone; for the pass depth take PNG"),
        ({"output": "a", "codec": "jpeg", "passes": ("alpha",)}, "for the pass alpha take PNG"),
        ({"output": "a.png", "codec": "jpeg"}, "jpeg needs an output that ends in .jpg or .jpeg or nothing (a folder)"),
        ({"output": "a.webm", "size_px": (64, 63)}, "even width and height, got 64x63"),
    ],
)
def test_what_contradicts_itself_is_refused(fields, words):
    with pytest.raises(ValueError) as error:
        ExportSettings(**fields).check()
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("fields", "cameras", "expected"),
    [
        ({"output": "a.mp4"}, [""], ["a.mp4"]),
        ({"output": "a.mp4", "twin": True}, [""], ["a.mp4", "a.clear.mp4"]),
        ({"output": "a.mp4", "passes": ("color", "depth")}, [""], ["a.mp4", "a.depth"]),
        ({"output": "a.mp4", "passes": ("labels",), "twin": True}, [""], ["a.labels"]),
        ({"output": "a.png", "passes": ("color", "alpha", "labels")}, [""], ["a.png", "a.alpha.png", "a.labels.png"]),
        ({"output": "a.npy", "passes": ("color", "depth")}, [""], ["a.npy", "a.depth.npy"]),
        ({"output": "a.exr", "passes": ("color", "depth", "labels")}, [""], ["a.exr", "a.labels.png"]),
        ({"output": "a", "passes": ("color", "depth")}, [""], ["a"]),
        ({"output": "a.mp4"}, ["FRONT", "REAR"], ["a/FRONT.mp4", "a/REAR.mp4"]),
        ({"output": "a", "codec": "av1", "twin": True}, ["L/R", "B"],
         ["a/L_R.webm", "a/L_R.clear.webm", "a/B.webm", "a/B.clear.webm"]),
        ({"output": "a"}, ["FRONT", "REAR"], ["a/FRONT", "a/REAR"]),
    ],
)  # fmt: skip
def test_files_are_called(fields, cameras, expected):
    assert [path.as_posix() for path in export_outputs(ExportSettings(**fields), cameras)] == expected


def test_long_names_of_cameras_are_shortened_and_stay_apart():
    paths = export_outputs(ExportSettings(output="a", codec="jpeg", twin=True), ["F" * 300, "F" * 301])
    assert len(set(paths)) == 4
    assert all(len(path.name) < 200 for path in paths)
    assert export_files(ExportSettings(output="a", codec="jpeg"), None).color(3).as_posix() == "a/000003.jpg"


def test_passes_lie_beside_their_frames():
    passes = ("color", "depth", "labels")
    folder = export_files(ExportSettings(output="run", passes=passes), None)
    assert [folder.color(7).as_posix(), folder.pass_file(7, "depth").as_posix()] == [
        "run/000007.png",
        "run/000007.depth.png",
    ]
    assert folder.legend.as_posix() == "run/labels.json"
    video = export_files(ExportSettings(output="run.mp4", passes=passes), None)
    assert video.pass_file(7, "labels").as_posix() == "run.labels/000007.png"
    assert video.legend.as_posix() == "run.labels/labels.json"
    twin = export_files(ExportSettings(output="run"), None, is_clear=True)
    assert twin.color(7).as_posix() == "run.clear/000007.png"
    still = export_files(ExportSettings(output="still.png", passes=passes), None)
    assert still.legend.as_posix() == "still.labels.json"


@pytest.mark.parametrize(
    "fields",
    [
        {"output": "a b.mp4"},
        {"output": "frames", "size_px": (640, 360), "fps": 23.976, "first_s": -0.1, "last_s": 1.1, "codec": "exr"},
        {"output": "a.webm", "codec": "av1", "quality": 40, "supersampling": 2, "motion_blur": 8, "twin": True},
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
