"""Training as a whole: it learns, is repeatable to the byte on the CPU, and goes on from a checkpoint as if never
stopped. On CUDA: test_cuda_training.py, within tolerances."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("torch")

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.progress import Progress, run_to_end
from gsrain_engine.training.data import ReconstructionTask
from gsrain_engine.training.evaluation import validation_indices
from gsrain_engine.training.schedule import TrainingSchedule, view_order
from gsrain_engine.training.settings import TrainingSettings, load_settings
from gsrain_engine.training.train import TrainingReport, reconstruct
from gsrain_engine.training_run import CheckpointError
from small_capture import small_capture

QUICK = {
    "steps": 40, "gaussians": 3000, "held_out": 4, "measured_every": 20, "saved_every": 15, "device": "cpu",
}  # fmt: skip


def task_of(folder: Path, resume: bool = False, snapshot: Path | None = None, **changes: object) -> ReconstructionTask:
    return ReconstructionTask(
        capture=folder, output=folder / "scene", settings=load_settings(None, **(QUICK | changes)), resume=resume,
        report=folder / "report.html", snapshot=snapshot,
    )  # fmt: skip


def finished(task: ReconstructionTask, capture: Capture | None = None) -> TrainingReport:
    return run_to_end(reconstruct(task, capture or small_capture()))


def stopped(task: ReconstructionTask, message: str) -> None:
    """Train up to a step whose message begins so."""
    work = reconstruct(task, small_capture())
    next(step for step in work if step.message.startswith(message))
    work.close()


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


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
    """By as much as in earlier versions: any change of initial Gaussians, losses or rates moves these figures."""
    numbers = whole.report.numbers
    assert numbers["psnr_before_db"] == pytest.approx(29.49, abs=0.05)
    assert numbers["psnr_held_out_db"] == pytest.approx(43.35, abs=0.1)
    assert numbers["psnr_held_out_exposed_db"] == pytest.approx(43.55, abs=0.1)
    assert numbers["ssim_held_out"] == pytest.approx(0.9871, abs=1e-3)
    assert whole.report.curves.losses[-1] == pytest.approx(0.01125, rel=0.01)
    assert [each["name"] for each in numbers["held_out"]] == ["2.00m"]
    page = (whole.folder / "report.html").read_text()
    assert "Reconstruction of small street" in page and "held-out PSNR" in page


def test_progress_never_falls_and_has_pictures_and_measurements(whole: Whole) -> None:
    fractions = [step.fraction for step in whole.steps]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    assert any(step.preview is not None for step in whole.steps)
    losses = [step.metrics["loss"] for step in whole.steps if "loss" in step.metrics]
    assert len(losses) == QUICK["steps"] and losses[-1] < losses[0]
    assert sum("psnr_held_out_db" in step.metrics for step in whole.steps) == 1


def test_the_scene_has_what_the_capture_had(whole: Whole) -> None:
    scene = read_scene(whole.folder / "scene")
    assert [layer.kind for layer in scene.layers] == ["background", "sky"]
    assert 500 < len(scene.member("layers/background").gaussians) <= 3000
    assert [camera.name for camera in scene.rigs["capture"]] == ["FRONT"]
    assert scene.ego is not None
    assert scene.ground_m == pytest.approx(0.0, abs=1e-6)
    assert not (whole.folder / "scene.checkpoint.npz").exists()


def test_a_stopped_training_goes_on_to_the_byte_on_the_cpu(whole: Whole, tmp_path: Path) -> None:
    stopped(task_of(tmp_path, snapshot=tmp_path / "snapshot"), "Step 37")
    assert (tmp_path / "scene.checkpoint.npz").is_file() and not (tmp_path / "scene").exists()
    assert len(read_scene(tmp_path / "snapshot").layers) == 2  # can be looked at meanwhile
    resumed = finished(task_of(tmp_path, resume=True))
    assert bytes_of(tmp_path / "scene") == bytes_of(whole.folder / "scene")
    assert resumed.curves.losses == whole.report.curves.losses
    for name in ("psnr_held_out_db", "psnr_before_db"):
        assert resumed.numbers[name] == whole.report.numbers[name]


def test_checkpoints_of_other_trainings_and_damaged_ones_are_refused(tmp_path: Path) -> None:
    def refused(name: str, capture: Capture | None = None, **changes: object) -> None:
        with pytest.raises(CheckpointError, match=rf"scene\.checkpoint\.npz.*{name}"):
            finished(task_of(tmp_path, resume=True, **changes), capture)

    refused("no checkpoint")
    stopped(task_of(tmp_path), "Saved")
    refused("d_ssim", d_ssim=0.5)
    refused("capture", small_capture(moments=5))
    file = tmp_path / "scene.checkpoint.npz"
    with np.load(file) as archive:
        arrays = dict(archive)
    for name in ("background:means", "before"):
        np.savez(file, **{each: array for each, array in arrays.items() if each != name})
        refused(name.rpartition(":")[2])
    file.write_bytes(file.read_bytes()[:1000])
    refused("damaged")


def test_monte_carlo_density_learns_too(tmp_path: Path) -> None:
    assert finished(task_of(tmp_path, density="mcmc")).numbers["psnr_held_out_db"] == pytest.approx(43.06, abs=0.1)


def test_held_out_views_lie_inside_every_stretch_or_are_named():
    names = [f"v{k}" for k in range(18)]
    for every, named, expected in ((8, (), [4, 12]), (0, (), []), (8, ("v3", "v1"), [1, 3])):
        assert validation_indices(names, every, named) == expected
    for every, named, fault in ((8, ("nobody",), "held_out_views: .*'nobody'"), (1, (), "held_out: ")):
        with pytest.raises(ValueError, match=fault):
            validation_indices(names, every, named)


# Schedule


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
    epochs = {tuple(order[k : k + 7]) for k in range(0, 28, 7)}
    assert len(order) == 30 and len(epochs) > 1 and all(sorted(epoch) == list(range(7)) for epoch in epochs)
    assert order != view_order(7, 30, seed=6) and view_order(7, 10, seed=5) == order[:10]
