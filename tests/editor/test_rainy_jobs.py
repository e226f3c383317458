"""Making a scene rainy behind the window: real workers on a small scene, the preview, and trainings."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine import trusted_code
from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.finetune.settings import FinetuneTask, FinetuningSettings
from gsrain_engine.appearance.scene_views import ViewChoice, chosen_cameras
from gsrain_engine.editor import finetune
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.jobs import training
from gsrain_engine.editor.jobs.make_rainy import (
    MAKE_RAINY_TITLE,
    PreviewedView,
    PreviewSettings,
    TransferRequest,
    make_rainy,
    preview_view,
)
from gsrain_engine.recolor.result import read_recolored
from gsrain_engine.scene.formats.scene_folder import write_scene_folder
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene
from small_scene import small_scene

CHOICE = ViewChoice(source="rig", count=2, width_px=64)


@pytest.fixture
def editor():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def follow(editor, job, until=lambda: False):
    """Poll until the job has ended, or something is so; wait where there is nothing new."""
    while job.state == "running" and not until():
        editor.jobs.wait(60)
        editor.tick(0.0)


def test_the_work_writes_wet_colours_of_every_member_and_a_report(tmp_path):
    write_scene_folder(small_scene(), tmp_path / "scene")
    order = TransferRequest("wet", TransferSettings(), CHOICE)
    said = list(make_rainy(tmp_path / "scene", order, tmp_path / "colors.npz", tmp_path / "report.html"))
    assert [each.fraction for each in said] == sorted(each.fraction for each in said)
    assert sum(each.preview is not None for each in said) >= 2
    colors = read_recolored(tmp_path / "colors.npz")
    assert set(colors) == {"layers/road", "layers/wall", "layers/sky"}
    road = small_scene().member("layers/road").gaussians.sh
    assert (colors["layers/road"][:, 0] < road[:, 0]).mean() > 0.8  # wet, it is darker
    page = (tmp_path / "report.html").read_text()
    assert "made rainy" in page
    assert page.count("data:image") >= 2


def test_a_preview_is_the_view_that_the_job_would_make(tmp_path):
    scene = small_scene()
    write_scene_folder(scene, tmp_path / "scene")
    placed = chosen_cameras(scene, CHOICE)[0]
    *_, clear, rainy = list(preview_view(tmp_path / "scene", "wet", TransferSettings(), placed))
    assert rainy.preview.shape == (placed.camera.height, 64, 3)
    assert np.abs(rainy.preview.astype(int) - clear.preview).mean() > 3
    *_, dry = preview_view(tmp_path / "scene", "wet", TransferSettings(wetness=0.0), placed)
    assert np.array_equal(dry.preview, clear.preview)


def test_a_preview_fits_only_what_it_is_of(editor):
    shot, scene = editor.viewport.shot(96, 64), editor.document.scene
    recipe = PreviewSettings("wet", TransferSettings())
    view = PreviewedView(np.zeros((64, 96, 3), np.uint8), shot.camera, 0.0, scene, recipe)
    assert view.is_of(editor.viewport.shot(960, 640).camera, 0.0, scene)
    assert not view.is_of(editor.viewport.shot(960, 600).camera, 0.0, scene)
    wet = scene.with_member("layers/road", wet_sh=scene.member("layers/road").gaussians.sh)
    assert view.is_of(shot.camera, 1.0, wet)  # views are clear, and nothing moves
    assert not view.is_of(shot.camera, 0.0, scene.with_member("layers/road", visible=False))
    editor.viewport.dolly(1.0)
    assert not view.is_of(editor.viewport.shot(96, 64).camera, 0.0, scene)
    assert view.recipe == PreviewSettings("wet", TransferSettings())
    assert view.recipe != PreviewSettings("wet", TransferSettings(seed=1))


def test_views_that_a_scene_has_not_are_named(editor):
    assert editor.wet_look.why_no_views("rig") is None
    assert "no camera path" in editor.wet_look.why_no_views("path")
    assert "No capture is open" in editor.wet_look.why_no_views("recorded")
    editor.document.edit("Without a drive", replace_scene, replace(editor.document.scene, ego=None))
    assert "no drive" in editor.wet_look.why_no_views("rig")
    assert editor.wet_look.why_no_views("auto") is None


def test_a_scene_is_made_rainy_once_as_soon_as_it_is_there(editor):
    scene = editor.document.scene
    editor.document.edit("Nothing yet", replace_scene, Scene("nothing"))
    editor.wet_look.make_soon()
    editor.tick(0.0)
    assert not editor.jobs.all
    editor.document.edit("Everything", replace_scene, scene)
    editor.tick(0.0)
    (job,) = editor.jobs.all
    assert (job.title, editor.status.problem) == (MAKE_RAINY_TITLE, None)
    job.cancel()
    editor.tick(0.0)
    editor.tick(0.0)
    assert editor.jobs.all == [job]
    assert job.state == "cancelled"


def test_what_a_method_lacks_is_said_once_the_scene_is_there(editor):
    editor.wet_look.method = "images"
    editor.wet_look.make_soon()
    editor.tick(0.0)
    assert editor.status.problem == "Pictures: choose a folder of pictures first."
    assert not editor.jobs.all


def learning(task):
    """Stand in for a training: losses, samples, and a warning."""
    task.output.mkdir(parents=True, exist_ok=True)
    rows = "".join(f"{k},{2 / k}\n" for k in range(1, 1001))
    task.losses.write_text(f"step,cycle_clear\n{rows}")
    yield Progress(0.5, "500 of 1,000: cycle 0.1", np.full((8, 8, 3), 90, np.uint8))
    warning = "the model only reconstructs; raise losses.gan"
    yield Progress(0.6, "600 of 1,000: cycle 0.1", warning=warning)
    while not (task.output / "seen").exists():
        pass  # the test lets it go on
    yield Progress(1.0, "Trained", warning=warning)


def breaking(task):
    yield Progress(0.1, "1 of 1,000: cycle 0.1")
    raise ValueError("clear: holds no pictures")


@pytest.fixture
def studio(editor, tmp_path, monkeypatch):
    for name in ("clear", "rainy"):
        (tmp_path / name).mkdir()
    studio = editor.finetune
    studio.choice = msgspec.structs.replace(
        studio.choice, clear=tmp_path / "clear", rainy=tmp_path / "rainy", output=tmp_path / "out", steps=1000
    )
    monkeypatch.setattr("gsrain_engine.editor.finetune.has_torch", lambda: True)
    monkeypatch.setattr(training, "train_transfer", learning)
    return studio


def test_losses_and_warnings_of_a_training_can_be_watched(editor, studio):
    studio.start()
    (job,) = editor.jobs.all
    assert not job.ends_with_scene
    (task,) = job.inputs(None)
    assert isinstance(task, FinetuneTask)
    assert isinstance(task.settings, FinetuningSettings)
    assert task.settings.steps == 1000
    assert [each.path for each in task.settings.pictures.clear] == [str(studio.choice.clear)]
    assert studio.why_not() == "Wait for Train the transfer, or cancel it."
    follow(editor, job, until=lambda: job.progress.warning is not None)
    assert job.progress.message == "600 of 1,000: cycle 0.1"
    (task.output / "seen").touch()
    follow(editor, job)
    assert (job.state, job.error) == ("finished", None)
    assert job.progress.warning == "the model only reconstructs; raise losses.gan"
    assert job.progress.preview is not None
    assert len(studio.losses["step"]) == 500  # means of two
    assert studio.losses["cycle_clear"][0] == pytest.approx(1.5)


def test_what_ends_a_training_is_told_and_a_checkpoint_is_gone_on_from(editor, studio, monkeypatch):
    monkeypatch.setattr(training, "train_transfer", breaking)
    studio.start()
    follow(editor, editor.jobs.all[0])
    assert editor.status.problem == "Train the transfer failed: clear: holds no pictures"
    assert not studio.can_resume
    studio.choice.output.mkdir()
    (studio.choice.output / "checkpoint.safetensors").write_bytes(b"")
    assert studio.can_resume
    studio.start(resume=True)
    assert editor.jobs.all[1].inputs(None)[0].resume
    editor.jobs.all[1].cancel()
    assert editor.jobs.all[1].state == "cancelled"


def test_settings_that_are_wrong_are_told_and_nothing_starts(editor, studio, tmp_path):
    (tmp_path / "own.yaml").write_text("architecture: tiny\nstepps: 3\n")
    studio.choice = msgspec.structs.replace(studio.choice, config=str(tmp_path / "own.yaml"))
    studio.start()
    assert editor.jobs.all == []
    assert "own.yaml" in editor.status.problem


def test_a_program_that_the_settings_name_is_asked_about(editor, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(trusted_code, "_trusted", set())
    monkeypatch.setattr(finetune, "has_torch", lambda: True)
    started = []
    monkeypatch.setattr(Editor, "start", lambda self, job: started.extend(job.inputs(None)))
    (tmp_path / "DSINE" / "models").mkdir(parents=True)
    (tmp_path / "DSINE" / "models" / "dsine.py").write_text("DSINE = 1\n")
    text = "pictures: {clear: [{path: a}], rainy: [{path: b}], normals: dsine, normals_checkout: DSINE}\n"
    (tmp_path / "own.yaml").write_text(text)
    editor.finetune.choice = msgspec.structs.replace(
        editor.finetune.choice, config=str(tmp_path / "own.yaml"), output=tmp_path / "run"
    )
    for label, count in (("Don't run it", 0), ("Cancel", 0), ("Run it", 1)):
        editor.finetune.start()
        question = editor.status.question
        assert "own.yaml names Python code" in question.text and str(tmp_path / "DSINE") in question.text
        assert question.answers[0].label == "Don't run it"  # what Enter means
        editor.status.answer(next(each for each in question.answers if each.label == label))
        assert len(started) == count
    assert list(started[0].code) == [str(tmp_path / "DSINE")]
    monkeypatch.setattr(trusted_code, "_trusted", set())  # the next window
    editor.finetune.start()
    assert editor.status.question is None and len(started) == 2
