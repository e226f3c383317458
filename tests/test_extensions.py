"""Extensions that can't be used: an error names their package, and the program continues without them."""

import logging
import re
import sys
from contextlib import closing

import numpy as np
import pytest
from PIL import Image

import gsrain as gr
from app.main import BAD_INPUT, run
from extension_package import installed
from gsrain_engine import plugins
from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.registry import find_method, method_names, open_transfer, usable_methods
from gsrain_engine.appearance.wet_look.environment import ImageEnvironment
from gsrain_engine.datasets.open_capture import capture_format
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.scene_edits import SceneEdit
from gsrain_engine.evaluation.detection.decoders import DecoderInput, decode_outputs
from gsrain_engine.evaluation.detection.description import DetectorDescription
from gsrain_engine.plugins import ExtensionError
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats.registry import lost_in_file, writable_suffixes
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.drive_exports import FinishedDrive, find_drive_export
from gsrain_engine.simulation.scenario_io import load_scenario
from small_rollout import approach
from small_scene import small_scene
from ui.commands.table import all_commands

MODULE = """
import numpy as np
from gsrain_engine.appearance.registry import TransferMethod
from gsrain_engine.datasets.open_capture import CaptureFormat
from gsrain_engine.disdrometer.open import LogFormat
from gsrain_engine.editor.scene_edits import SceneEdit
from gsrain_engine.evaluation.detection.decoders import BoxCandidates, Decoder
from gsrain_engine.scene.formats._common import Format
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.simulation.drive_exports import DriveExport

def fails(*anything):
    raise RuntimeError("the magic smoke has left")

def gaussians(path, mean=0.0):
    means, ones = np.full((3, 2), mean, np.float32).T, np.ones(2, np.float32)
    return Gaussians(means, np.ones((2, 3), np.float32), np.full((2, 4), 2, np.float32), ones, means[:, None])

def hollow(path):
    return gaussians(path, np.nan)

LONG = Format(".long", gaussians, None, "quaternions of length 4, in the order of Fortran")
HOLLOW = Format(".hollow", hollow, None, "NaN")
SMOKE = Format(".smoke", fails, fails, "fails")
NUMBER = Format(".number", lambda path: 3, None, "reads no Gaussians")
MISNAMED = Format(".other", gaussians, None, "of another suffix")

def layers(path):
    return Scene("layers", (Layer("first", gaussians(path)), Layer("second", gaussians(path))))

def far(path):
    return Scene("far", (Layer("far", gaussians(path), to_scene=np.full((4, 4), np.inf)),))

def written(scene, path):
    path.write_text(",".join(layer.name for layer in scene.layers))

SCENES = Format(".layers", gaussians, fails, "scenes", 3, layers, written, lambda lost: lost[:0])
SCENE_SMOKE = Format(".fumes", gaussians, fails, "fails", 3, fails, fails, fails)
FAR = Format(".far", gaussians, None, "is nowhere", 3, far)
GAUSSIANS = Format(".flat", gaussians, None, "reads no scene", 3, gaussians)
PACKAGED = Format(".packed", fails, fails, "needs torch", packages=("torch",))
WET = TransferMethod("wet", "Not ours", "", fails)
STRANGER = TransferMethod("somebody", "Of another name", "", fails)
UNSET = TransferMethod("unset", "Asks for what is not there", "", fails, uses=("strength",))
OPENS_NUMBER = TransferMethod("opens-number", "Opens no transfer", "", lambda settings, surroundings: 3)
OPENS_NOT = TransferMethod("opens-not", "Fails", "", fails)
LISTS = Decoder(lambda outputs, layout: [])
BOX, SURE = np.zeros((1, 4), np.float32), np.ones(1, np.float32)
CLASS_9 = Decoder(lambda outputs, layout: BoxCandidates(BOX, SURE, np.array([9])))
HALF = DriveExport((".half",), fails)
ENDLESS = DriveExport((), fails)
DOUBTS = LogFormat(lambda lines: lines[0] == "doubt", fails)
NOTHING = LogFormat(lambda lines: lines[0] == "nothing", lambda path, lines: 3)

def faults(scene, kind: str = "error"):
    yield Progress(0.0, "Starting")
    if kind == "refusal":
        raise ValueError("this scene is too clean")
    if kind == "error":
        fails()
    return 3

def doubts(scene):
    return fails()

FAULTS = SceneEdit("Go wrong", "Goes wrong in several ways.", faults, doubts)
UNDO = SceneEdit("Undo", "Has the name of another command.", faults)
FOLDERS = CaptureFormat("anything", fails, fails)
"""
ENTRIES = {
    "gsrain.scene_formats": {
        "long": "bad_lab:LONG", "hollow": "bad_lab:HOLLOW", "smoke": "bad_lab:SMOKE", "number": "bad_lab:NUMBER",
        "misnamed": "bad_lab:MISNAMED", "function": "bad_lab:gaussians", "absent": "no_such_module_of_bad_lab:X",
        "ply": "bad_lab:SMOKE", "layers": "bad_lab:SCENES", "fumes": "bad_lab:SCENE_SMOKE", "far": "bad_lab:FAR",
        "flat": "bad_lab:GAUSSIANS", "packed": "bad_lab:PACKAGED",
    },
    "gsrain.transfers": {
        "wet": "bad_lab:WET", "stranger": "bad_lab:STRANGER", "unset": "bad_lab:UNSET", "lost": "bad_lab:LOST",
        "opens-number": "bad_lab:OPENS_NUMBER", "opens-not": "bad_lab:OPENS_NOT",
    },
    "gsrain.decoders": {
        "lists": "bad_lab:LISTS", "class-9": "bad_lab:CLASS_9", "text": "bad_lab:__doc__",
    },
    "gsrain.drive_exports": {"half": "bad_lab:HALF", "endless": "bad_lab:ENDLESS", "parquet": "bad_lab:HALF"},
    "gsrain.scenario_formats": {"fumes": "bad_lab:fails", "flat": "bad_lab:gaussians", "yaml": "bad_lab:fails"},
    "gsrain.disdrometers": {"doubts": "bad_lab:DOUBTS", "nothing": "bad_lab:NOTHING", "broken": "bad_lab:fails"},
    "gsrain.evaluations": {
        "lidar": "bad_lab:fails", "smoke": "bad_lab:fails", "number": "bad_lab:MISNAMED", "gone": "gone:x",
    },
    "gsrain.panels": {"smoke": "bad_lab:fails"},
    "gsrain.scene_edits": {"go_wrong": "bad_lab:FAULTS", "undo": "bad_lab:UNDO", "rename": "bad_lab:FAULTS"},
}  # fmt: skip
SETTINGS = TransferSettings()


@pytest.fixture
def bad_lab(tmp_path_factory):
    """A package with one usable extension."""
    with installed(tmp_path_factory.mktemp("site"), "bad-lab", {"bad_lab.py": MODULE}, ENTRIES):
        plugins.warn_once.cache_clear()
        yield


def written(path, text=""):
    path.write_text(text)
    return path


def decoded(name):
    layout = DecoderInput(DetectorDescription(decode=name), 2, 64, 64)
    return decode_outputs([np.zeros((1, 1, 6), np.float32)], layout)


def log(text):
    return lambda folder: read_disdrometer(written(folder / "log.txt", f"{text}\nmore\n"))


def exported(name, folder):
    export = find_drive_export(name, f"--export {name}")
    export.write(FinishedDrive(export, approach(), small_scene()), folder / "a")


def scene(suffix):
    return lambda folder: read_scene(written(folder / f"scene.{suffix}"))


@pytest.mark.parametrize(
    ("use", "kind", "names"),
    [
        (scene("smoke"), SceneFormatError, r"smoke \(bad_lab:SMOKE of bad-lab\): line 15 of bad_lab.py: the magic"),
        (scene("number"), SceneFormatError, "number .*Gaussians"),
        (scene("misnamed"), SceneFormatError, "'.other', .* '.misnamed'"),
        (scene("function"), SceneFormatError, "function .*Format"),
        (scene("absent"), SceneFormatError, "no_such_module_of_bad_lab"),
        (scene("hollow"), SceneFormatError, "2 of 2 Gaussians"),
        (scene("fumes"), SceneFormatError, "fumes .*magic smoke"),
        (scene("far"), SceneFormatError, "far: its transform"),
        (scene("flat"), SceneFormatError, "flat .*Scene"),
        (lambda folder: write_scene(small_scene(), folder / "a.fumes"), SceneFormatError, "fumes .*magic smoke"),
        (lambda folder: lost_in_file(small_scene(), folder / "a.fumes"), SceneFormatError, "fumes .*magic smoke"),
        (lambda folder: write_scene(small_scene(), folder / "scene.smoke"), SceneFormatError, "magic smoke"),
        (lambda folder: exported("half", folder), ExtensionError, "half .*magic smoke"),
        (lambda folder: exported("endless", folder), ExtensionError, "endless .*suffixes"),
        (lambda folder: load_scenario(written(folder / "a.fumes")), ValueError, r"a\.fumes: .*fumes .*magic smoke"),
        (lambda folder: load_scenario(written(folder / "a.flat")), ValueError, r"a\.flat: .*flat .*Scenario"),
        (lambda folder: load_scenario(written(folder / "a.yaml", "a: 1")), ValueError, r"a\.yaml: .*unknown field"),
        (
            lambda folder: load_scenario(written(folder / "a.lost", "<")),
            ValueError,
            r"package reads \.lost",
        ),
        (lambda _: open_transfer("opens-not", SETTINGS, ImageEnvironment()), ExtensionError, "opens-not .*magic smoke"),
        (lambda _: open_transfer("opens-number", SETTINGS, ImageEnvironment()), ExtensionError, "opens-number .*name"),
        (lambda _: decoded("lists"), ValueError, "lists .*BoxCandidates"),
        (lambda _: decoded("class-9"), ValueError, r"class-9 .*0\.\.1"),
        (lambda _: decoded("text"), ValueError, "text .*Decoder"),
        (log("doubt"), DisdrometerFileError, "log.txt: .*doubts .*magic smoke"),
        (log("nothing"), DisdrometerFileError, "log.txt: .*nothing .*DisdrometerReading"),
        (log("whatever"), DisdrometerFileError, "log.txt: .*kind"),
    ],
)
def test_failing_extensions_are_named_with_their_package(bad_lab, use, kind, names, tmp_path):
    with pytest.raises(kind, match=names):
        use(tmp_path)


def test_gaussians_of_a_format_are_made_drawable(bad_lab, tmp_path):
    found = read_scene(written(tmp_path / "a.long")).layers[0].gaussians
    assert found.means.flags.c_contiguous and found.quaternions.tolist() == [[0.5] * 4] * 2
    with pytest.raises(SceneFormatError):
        write_scene(small_scene(), tmp_path / "scene.smoke")
    write_scene(small_scene(), tmp_path / "scene.ply")  # ours is not replaced
    assert read_scene(tmp_path / "scene.ply").gaussian_count > 0
    assert {each.name for each in tmp_path.iterdir()} == {"a.long", "scene.ply"}
    assert {".ply", ".splat", ".spz"} < {*writable_suffixes()} and ".smoke" in writable_suffixes()


def test_scenes_of_a_format_keep_their_layers(bad_lab, tmp_path):
    found = read_scene(written(tmp_path / "a.layers"))
    assert [layer.name for layer in found.layers] == ["first", "second"]
    assert found.layers[1].gaussians.quaternions.tolist() == [[0.5] * 4] * 2
    write_scene(small_scene(), tmp_path / "b.layers")
    assert (tmp_path / "b.layers").read_text() == "road,wall,sky"
    assert lost_in_file(small_scene(), tmp_path / "b.layers") == []


def test_formats_name_the_package_that_they_need(bad_lab, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    for use in (scene("packed"), lambda folder: write_scene(small_scene(), folder / "scene.packed")):
        with pytest.raises(SceneFormatError, match=r"scene\.packed: a \.packed file needs torch, "):
            use(tmp_path)


def test_unusable_methods_and_logs_are_reported_once(bad_lab, tmp_path, caplog):
    assert method_names()[:3] == ("wet", "cyclegan-turbo", "images") and find_method("wet").title == "Wet look"
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert [each.name for each in usable_methods()[3:]] == ["opens-not", "opens-number"]
        with pytest.raises(DisdrometerFileError):
            log("whatever")(tmp_path)
    names = sorted(re.sub(r" \(.*", "", message) for message in caplog.messages)
    assert names == ["disdrometer format broken", "transfer lost", "transfer stranger", "transfer unset"]


def test_unusable_evaluations_and_panels_are_named(bad_lab, capsys):
    assert run(["evaluate", "--help"]) == 0
    listed = capsys.readouterr().out
    assert "smoke" in listed and "A lidar in rain" in listed  # ours is not replaced
    for name in ("number", "gone"):
        assert run(["evaluate", name]) == BAD_INPUT
        assert f"evaluation {name} (" in capsys.readouterr().err
    run(["doctor"])
    printed = capsys.readouterr().out
    assert "broken  scene format absent: " in printed and "panel smoke (bad_lab:fails of bad-lab)" in printed
    assert "ok      scene format long: bad_lab:LONG of bad-lab 0.1.0" in printed


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("error", r"go_wrong \(bad_lab:FAULTS of bad-lab\): line \d+ of bad_lab.py: the magic"),
        ("refusal", "^step 1, go-wrong: this scene is too clean$"),
        ("number", "go_wrong .*returns a int, not a Scene"),
    ],
)
def test_faults_of_edits_name_their_package_and_refusals_do_not(bad_lab, kind, words):
    with pytest.raises(ValueError, match=words):
        gr.edit(small_scene(), "go-wrong", kind=kind)


def test_edits_take_no_name_of_our_own_and_are_off_where_their_condition_fails(bad_lab, caplog):
    assert gr.edit(small_scene(), "rename", key="layers/road", name="asphalt").layers[0].name == "asphalt"
    with closing(Editor(small_scene())) as editor, caplog.at_level(logging.WARNING):
        (command,) = [each for each in all_commands() if each.edit == "go-wrong"]
        assert not command.can_run(editor) and not command.can_run(editor)
        assert [each.edit for each in all_commands() if each.name == "Undo"] == [""]
    assert sorted(re.sub(r" \(.*: ", ": ", message) for message in caplog.messages) == [
        "scene edit go_wrong: the magic smoke has left; it is left out",
        "scene edit undo: there is a command 'Undo'; it is left out",
    ]


def test_edits_that_the_window_could_not_run_are_refused():
    def clean(scene: Scene, strength: float) -> Scene:
        return scene

    def sweep(scene: Scene, strength=1.0) -> Scene:
        return scene

    for work in (clean, sweep):
        with pytest.raises(ValueError, match="'Clean': its parameter strength needs a type and a default"):
            SceneEdit("Clean", "Clean the scene.", work)


def test_captures_are_recognized_without_a_failing_extension(tmp_path, tmp_path_factory, caplog):
    entries = {"gsrain.capture_formats": {"any": "worse_lab:FOLDERS"}}
    site = tmp_path_factory.mktemp("site")
    with installed(site, "worse-lab", {"worse_lab.py": MODULE}, entries), caplog.at_level(logging.WARNING):
        assert capture_format(tmp_path) is None
        Image.new("RGB", (8, 8)).save(tmp_path / "one.png")
        assert capture_format(tmp_path).name == "image folder"
    assert any("capture format any (worse_lab:FOLDERS of worse-lab)" in each for each in caplog.messages)
