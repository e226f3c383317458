"""Making a scene rainy behind the window: the work on a small scene, previews, and trainings."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.scene_views import chosen_cameras
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.editor import finetune
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.jobs.make_rainy import (
    PreviewImages,
    TransferRequest,
    make_rainy,
    make_rainy_job,
    preview_view,
)
from gsrain_engine.editor.jobs.training import COLORS_FILE
from gsrain_engine.recolor import cached_colors
from gsrain_engine.recolor.result import read_recolored
from gsrain_engine.scene.formats.scene_folder import FileCache, write_scene_folder
from gsrain_engine.scene.progress import Progress
from gsrain_engine.trusted_code import answers_file
from small_scene import small_scene

CHOICE = ViewChoice(source="rig", count=2, width_px=64)


@pytest.fixture
def saved(tmp_path):
    write_scene_folder(small_scene(), tmp_path / "scene")
    return tmp_path / "scene"


def test_the_work_writes_wet_colors_of_every_member_and_a_report(saved, tmp_path):
    order = TransferRequest("wet", TransferSettings(), CHOICE)
    steps = list(make_rainy(saved, order, tmp_path / "colors.npz", tmp_path / "report.html"))
    assert [each.fraction for each in steps] == sorted(each.fraction for each in steps)
    assert sum(each.preview is not None for each in steps) == 2
    colors = read_recolored(tmp_path / "colors.npz")
    assert set(colors) == {"layers/road", "layers/wall", "layers/sky"}
    road = small_scene().member("layers/road").gaussians.sh
    assert (colors["layers/road"][:, 0] < road[:, 0]).mean() > 0.8  # wet, it is darker
    assert (tmp_path / "report.html").read_text().count("data:image") >= 2


def test_the_work_reads_the_colors_that_the_command_keeps_and_keeps_its_own(saved, tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    monkeypatch.setattr(cached_colors, "wet_color_folder", lambda: cache)
    scene = small_scene()
    known = {each.key: each.gaussians.sh * np.float32(0.5) for each in scene.members}
    cached_colors.write_recolored(cache / f"{cached_colors.wet_color_key(scene)}.npz", known)
    for seed, count in ((0, 1), (1, 2)):
        order = TransferRequest("wet", TransferSettings(seed=seed), CHOICE)
        copy = tmp_path / f"copy_{count}"
        copy.mkdir()
        list(make_rainy(*make_rainy_job(scene, FileCache(), order).inputs(copy)))
        colors = read_recolored(copy / COLORS_FILE)
        assert np.array_equal(colors["layers/road"], known["layers/road"]) == (seed == 0)
        assert len(list(cache.iterdir())) == count


def test_a_preview_is_the_view_that_the_job_would_make(saved):
    placed = chosen_cameras(small_scene(), CHOICE)[0]
    file = saved.parent / "images.npz"
    *_, clear, rainy = list(preview_view(saved, "wet", TransferSettings(), placed, file))
    assert rainy.preview.shape == (placed.camera.height, 64, 3)
    assert np.abs(rainy.preview.astype(int) - clear.preview).mean() > 3
    images = PreviewImages.read(file)
    assert (list(images.pictures), images.note) == (["clear", "rainy"], "")  # there is no network
    assert np.array_equal(images.pictures["clear"], clear.preview)
    assert np.array_equal(images.pictures["rainy"], rainy.preview)
    *_, dry = preview_view(saved, "wet", TransferSettings(wetness=0.0), placed, file)
    assert np.array_equal(dry.preview, clear.preview)


@pytest.mark.parametrize(
    ("source", "method", "images", "missing"),
    [
        ("auto", "images", None, "Pictures"),
        ("auto", "images", Path("/nowhere"), "/nowhere"),
        ("recorded", "wet", None, "capture"),
        ("path", "wet", None, "camera path"),
        ("rig", "wet", None, "drive"),
    ],
)
def test_a_transfer_that_lacks_something_names_it_once_the_scene_is_there(editor, source, method, images, missing):
    editor.document.edit("Without a drive", replace_scene, replace(editor.document.scene, ego=None))
    rainy = editor.wet_look
    rainy.method, rainy.settings, rainy.choice = method, TransferSettings(images=images), ViewChoice(source=source)
    rainy.make_soon()
    editor.tick(0.0)
    assert missing in editor.status.problem
    assert not editor.jobs.all


# Trainings


def learning(task):
    """Stand in for a training: writes its task; reports losses, a picture and a warning."""
    task.output.mkdir(exist_ok=True)
    clear = [each.path for each in task.settings.pictures.clear]
    (task.output / "task.json").write_bytes(msgspec.json.encode((task.settings.steps, clear, task.resume, task.code)))
    for k in range(1, 4):
        losses = {"step": k, "cycle_clear": 2 / k}
        yield Progress(k / 4, f"{k} of 3", np.full((8, 8, 3), 90, np.uint8), losses, "the model only reconstructs")


@pytest.fixture
def studio(editor, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(finetune, "has_package", lambda _: True)
    monkeypatch.setattr(finetune, "train_transfer", learning)
    folders = {name: tmp_path / name for name in ("clear", "rainy", "output")}
    for name in ("clear", "rainy"):
        folders[name].mkdir()
    editor.finetune.choice = msgspec.structs.replace(editor.finetune.choice, **folders, steps=1000)
    return editor.finetune


def test_a_training_reports_losses_and_warnings_and_goes_on_from_its_checkpoint(editor, studio):
    clear, output = str(studio.choice.clear), studio.choice.output
    assert not studio.can_resume
    for resume in (False, True):
        studio.start(resume=resume)
        assert studio.why_not.startswith("Train transfer works in this folder")
        assert studio.job.wait(60) == output / "weights.safetensors"
        assert msgspec.json.decode((output / "task.json").read_bytes()) == [1000, [clear], resume, {}]
        (output / "checkpoint.safetensors").touch()
        assert studio.can_resume
    job = studio.job
    assert (str(job.result) in job.progress.message, job.progress.warning) == (True, "the model only reconstructs")
    assert job.progress.preview.shape == (8, 8, 3)
    assert job.curves.curve("cycle_clear").tolist() == [[1, 2, 3], [2, 1, 2 / 3]]
    assert {"cycle_clear", "gan_rainy"} <= {name for names in job.plots.values() for name in names}
    editor.jobs.leave_scene()
    assert job.result is not None  # it does not belong to the scene


@pytest.mark.parametrize(
    ("change", "missing"),
    [({"output": None}, "folder"), ({"clear": Path("/nowhere")}, "/nowhere"), ({"config": "own.yaml"}, "own.yaml")],
)
def test_a_training_with_wrong_settings_does_not_start(editor, studio, change, missing):
    studio.choice = msgspec.structs.replace(studio.choice, **change)
    studio.start()
    assert missing in (studio.why_not or editor.status.problem)
    assert editor.jobs.all == []


def test_code_that_the_settings_name_runs_only_after_a_question(editor, studio, tmp_path):
    (tmp_path / "DSINE" / "models").mkdir(parents=True)
    (tmp_path / "DSINE" / "models" / "dsine.py").write_text(f"DSINE = {str(tmp_path)!r}\n")
    text = "pictures: {clear: [{path: a}], rainy: [{path: b}], normals: dsine, normals_checkout: DSINE}\n"
    (tmp_path / "own.yaml").write_text(text)
    studio.choice = msgspec.structs.replace(studio.choice, config=str(tmp_path / "own.yaml"))
    checkout = str(tmp_path / "DSINE")
    for label in ("Don't run it", "Cancel", "Run it"):
        assert editor.jobs.all == []
        studio.start()
        question = editor.status.question
        assert "own.yaml" in question.text and checkout in question.text
        assert question.answers[0].label == "Don't run it"  # the answer of Enter
        editor.status.answer(next(each for each in question.answers if each.label == label))
    studio.job.wait(60)
    *_, code = msgspec.json.decode((studio.choice.output / "task.json").read_bytes())
    assert list(code) == [checkout]
    assert code[checkout] in answers_file().read_text()  # of the next window, too
    studio.start()
    assert editor.status.question is None
