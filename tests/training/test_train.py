"""Training as a whole: it learns, is repeatable to the byte, and goes on from a checkpoint as if never stopped."""

import hashlib
import pickle
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, get_type_hints

import msgspec
import numpy as np
import pytest
from PIL import Image

pytest.importorskip("torch")

from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.progress import Progress, run_to_end
from gsrain_engine.training.data import ReconstructionTask
from gsrain_engine.training.evaluation import score, validation_indices
from gsrain_engine.training.model import recorded_path
from gsrain_engine.training.settings import (
    TrainingSchedule,
    TrainingSettings,
    camera_extent,
    load_settings,
    settings_names,
    view_order,
)
from gsrain_engine.training.train import TrainingReport, reconstruct
from gsrain_engine.training_run import CheckpointError
from small_capture import small_capture

QUICK = {"steps": 40, "gaussians": 3000, "held_out": 4, "measured_every": 20, "saved_every": 15}


def task_of(folder: Path, resume: bool = False, snapshot: Path | None = None, **changes: object) -> ReconstructionTask:
    settings = load_settings(None, **(QUICK | changes))
    return ReconstructionTask(
        capture=folder, output=folder / "scene", settings=settings, resume=resume, report=folder / "report.html",
        snapshot=snapshot,
    )  # fmt: skip


def finished(task: ReconstructionTask, capture: Capture | None = None) -> TrainingReport:
    return run_to_end(reconstruct(task, capture or small_capture()))


def stopped(task: ReconstructionTask, message: str) -> None:
    """Train up to a step whose message begins so."""
    work = reconstruct(task, small_capture())
    next(step for step in work if step.message.startswith(message))
    work.close()


def bytes_of(folder: Path) -> dict[str, str]:
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


class Whole(NamedTuple):
    folder: Path
    report: TrainingReport
    steps: list[Progress]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    folder, steps = tmp_path_factory.mktemp("whole"), list[Progress]()
    report = run_to_end(reconstruct(task_of(folder), small_capture()), steps.append)
    return Whole(folder, report, steps)


def test_views_that_it_never_saw_become_more_alike(whole: Whole) -> None:
    numbers = whole.report.numbers
    assert numbers["psnr_held_out_db"] > max(numbers["psnr_before_db"] + 1, 22)
    assert [each["name"] for each in numbers["held_out"]] == ["2.00m"]
    page = (whole.folder / "report.html").read_text()
    assert "Reconstruction of small street" in page and "held-out PSNR" in page


def test_progress_never_falls_and_carries_pictures_and_measurements(whole: Whole) -> None:
    fractions = [step.fraction for step in whole.steps]
    assert all(b >= a for a, b in pairwise(fractions)) and fractions[-1] == 1.0
    previews = [step.preview for step in whole.steps if step.preview is not None]
    assert previews and previews[0].dtype == np.uint8 and previews[0].shape[2] == 3
    losses = [step.metrics["loss"] for step in whole.steps if "loss" in step.metrics]
    assert len(losses) == QUICK["steps"] and losses[-1] < losses[0]
    assert [step.metrics["psnr_held_out_db"] > 15 for step in whole.steps if "psnr_held_out_db" in step.metrics] == [
        True
    ]


def test_the_scene_has_what_the_capture_had(whole: Whole) -> None:
    scene = read_scene(whole.folder / "scene")
    assert [layer.kind for layer in scene.layers] == ["background", "sky"]
    assert 500 < len(scene.member("layers/background").gaussians) <= 3000
    assert [camera.name for camera in scene.rigs["capture"]] == ["FRONT"]
    assert scene.ego is not None
    assert scene.ground_m == pytest.approx(0.0, abs=1e-6)
    assert not (whole.folder / "scene.checkpoint.npz").exists()


def test_the_seed_alone_decides_the_bytes(whole: Whole, tmp_path: Path) -> None:
    for name, seed in (("same", 0), ("other", 1)):
        finished(task_of(tmp_path / name, seed=seed))
        assert (bytes_of(tmp_path / name / "scene") == bytes_of(whole.folder / "scene")) == (seed == 0)


def test_a_stopped_training_goes_on_as_if_it_never_was(whole: Whole, tmp_path: Path) -> None:
    stopped(task_of(tmp_path, snapshot=tmp_path / "snapshot"), "Step 37")
    assert (tmp_path / "scene.checkpoint.npz").is_file() and not (tmp_path / "scene").exists()
    assert len(read_scene(tmp_path / "snapshot").layers) == 2  # can be looked at meanwhile
    resumed = finished(task_of(tmp_path, resume=True))
    assert bytes_of(tmp_path / "scene") == bytes_of(whole.folder / "scene")
    assert resumed.curves.losses == whole.report.curves.losses
    for name in ("psnr_held_out_db", "psnr_before_db"):
        assert resumed.numbers[name] == whole.report.numbers[name]


def test_checkpoints_of_other_trainings_and_damaged_ones_are_refused(tmp_path: Path) -> None:
    stopped(task_of(tmp_path), "Saved")
    with pytest.raises(CheckpointError, match=r"scene\.checkpoint\.npz: made with d_ssim 0\.2"):
        finished(task_of(tmp_path, resume=True, d_ssim=0.5))
    with pytest.raises(CheckpointError, match="capture"):
        finished(task_of(tmp_path, resume=True), small_capture(moments=5))
    file = tmp_path / "scene.checkpoint.npz"
    with np.load(file) as archive:
        arrays = dict(archive)
    for name in ("background:means", "before"):
        np.savez(file, **{each: array for each, array in arrays.items() if each != name})
        with pytest.raises(CheckpointError, match=name.rpartition(":")[2]):
            finished(task_of(tmp_path, resume=True))
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="damaged"):
        finished(task_of(tmp_path, resume=True))
    file.unlink()
    with pytest.raises(CheckpointError, match="no checkpoint"):
        finished(task_of(tmp_path, resume=True))


def test_monte_carlo_density_learns_too(tmp_path: Path) -> None:
    numbers = finished(task_of(tmp_path, density="mcmc")).numbers
    assert numbers["psnr_held_out_db"] > numbers["psnr_before_db"] + 1


def test_a_task_travels_to_a_worker_and_needs_poses(tmp_path: Path) -> None:
    task = task_of(tmp_path, density="mcmc")
    assert pickle.loads(pickle.dumps(task)) == task
    for k in range(3):
        Image.fromarray(np.full((64, 96, 3), 40 * k, np.uint8)).save(tmp_path / f"{k}.png")
    with pytest.raises(CaptureError, match="COLMAP"):
        run_to_end(reconstruct(task))


def test_a_picture_that_only_decoding_finds_broken_is_named_and_left_out(tmp_path: Path) -> None:
    for _ in write_views(tmp_path, small_capture()):
        pass
    first = sorted(tmp_path.glob("*m.png"))[0]
    content = bytearray(first.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 200] = bytes(200)
    first.write_bytes(content)
    capture = task_of(tmp_path).read()
    assert len(capture) == 3
    assert any(first.stem in problem for problem in capture.problems)


# Held-out views, their scores, and the recorded path


def test_held_out_views_lie_inside_every_stretch_or_are_named():
    names = [f"v{k}" for k in range(18)]
    assert validation_indices(names, 8) == [4, 12]
    assert validation_indices(names, 0) == []
    assert validation_indices(names, 8, ("v3", "v1")) == [1, 3]
    with pytest.raises(ValueError, match="no view is named 'nobody'; the first is 'v0'"):
        validation_indices(names, 8, ("nobody",))
    with pytest.raises(ValueError, match="none is left"):
        validation_indices(names, 1)


def test_an_exposure_counts_in_the_raw_score_and_not_in_the_exposed_one() -> None:
    truth = np.random.default_rng(0).integers(0, 256, (40, 60, 3)).astype(np.uint8)
    darker = truth.astype(np.float32) / 255 * np.float32(0.8)
    found = score("v", darker, truth, None)
    assert found.psnr_db < 21 and found.psnr_exposed_db > 35
    mask = np.zeros((40, 60), bool)
    mask[5:35, 5:55] = True
    spoiled = np.where(mask[..., None], darker, 1).astype(np.float32)
    assert score("v", spoiled, truth, mask).psnr_db == pytest.approx(score("v", darker, truth, mask).psnr_db)


def test_the_recorded_way_goes_through_the_cameras_of_one_sensor():
    capture = small_capture()
    way = recorded_path(capture.views)
    assert way is not None
    assert way.positions[:, 0] == pytest.approx([0, 1, 2, 3])
    assert np.allclose(way.camera(0.0, 96, 64).world_to_camera, capture[0].camera.world_to_camera, atol=1e-9)
    still = tuple(replace(view, time_s=0.0) for view in capture)
    again = recorded_path(still)
    assert again is not None and not again.is_timed and way.is_timed
    assert again.times_s == pytest.approx(np.arange(4) / 1.4), "a walk: nobody knows how fast it was"
    assert recorded_path(still[:1]) is None


# Schedule and settings


def test_the_means_slow_down_exponentially_from_the_papers_first_rate_to_its_last():
    schedule = TrainingSchedule(TrainingSettings(steps=101, haste=1.0), extent=3.0)
    means = [schedule.rates(step)["means"] for step in (0, 50, 100)]
    assert means == pytest.approx([1.6e-4 * 3, 1.6e-5 * 3, 1.6e-6 * 3])
    assert schedule.rates(0)["opacity_logits"] == 5e-2
    assert schedule.rates(0)["sh_dc"] == 20 * schedule.rates(0)["sh_rest"]


def test_pictures_grow_harmonics_join_in_and_transients_go_late() -> None:
    schedule = TrainingSchedule(TrainingSettings(steps=100, coarse=0.4, sh_degree=3, transients=0.1, haste=1.0), 1.0)
    assert [schedule.level(step) for step in (0, 19, 20, 39, 40, 99)] == [2, 2, 1, 1, 0, 0]
    assert [schedule.sh_degree(step) for step in (0, 19, 20, 40, 60, 99)] == [0, 0, 1, 2, 3, 3]
    assert [schedule.leaves_out(step) for step in (0, 24, 25, 99)] == [False, False, True, True]
    short = TrainingSchedule(TrainingSettings(steps=100, coarse=0.0, sh_degree=1, transients=0.0, haste=3.0), 1.0)
    assert (short.level(0), short.sh_degree(99), short.leaves_out(99)) == (0, 1, False)
    assert short.rates(7) == pytest.approx({name: 3 * rate for name, rate in schedule.rates(7).items()})


def test_every_view_comes_once_an_epoch_in_changing_order():
    order = view_order(7, 30, seed=5)
    assert len(order) == 30
    epochs = [order[k : k + 7] for k in range(0, 28, 7)]
    assert all(sorted(epoch) == list(range(7)) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) > 1
    assert order == view_order(7, 30, seed=5) != view_order(7, 30, seed=6)
    assert view_order(7, 10, seed=5) == order[:10]


def test_the_extent_is_that_of_the_cameras():
    views = []
    for x in (0.0, 20.0):
        pose = np.eye(4)
        pose[0, 3] = -x
        views.append(CaptureFrame(str(x), Camera(8, 8, 8, 8, 4, 4, pose), np.zeros((8, 8, 3), np.uint8)))
    assert camera_extent(views) == pytest.approx(11)
    assert camera_extent(views[:1]) == 1


def test_shipped_settings_are_valid_and_the_defaults_are_the_laptop_ones() -> None:
    assert settings_names() == ["draft", "full", "laptop"]
    assert load_settings("laptop") == TrainingSettings() == load_settings()
    assert load_settings("draft").steps < load_settings("full").steps
    for name in set(TrainingSettings.__struct_fields__) - {"rates"}:
        assert len(get_type_hints(TrainingSettings, include_extras=True)[name].__metadata__[-1].description) > 15


@pytest.mark.parametrize(
    ("text", "field"),
    [("stps: 5\n", "stps"), ("d_ssim: 2\n", r"\$\.d_ssim"), ("- 5\n", "mapping"), ("steps: [\n", "YAML")],
)
def test_a_bad_file_is_named_with_its_field(tmp_path: Path, text: str, field: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("steps: 77\nrates: {means: 0.001}\n")
    settings = load_settings(file, width_px=99, seed=None)
    assert (settings.steps, settings.width_px, settings.seed, settings.rates.means) == (77, 99, 0, 0.001)
    file.write_text(text)
    with pytest.raises(ValueError, match=rf"(?s)mine\.yaml.*{field}|{field}.*mine\.yaml"):
        load_settings(file)
    with pytest.raises(msgspec.ValidationError, match=r"\$\.steps"):
        load_settings(None, steps=0)
