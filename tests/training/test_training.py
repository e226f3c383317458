"""Training as a whole: it learns, is repeatable to the byte, and goes on from a checkpoint as if never stopped."""

import hashlib
import pickle
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.progress import Progress
from gsrain_engine.training.data import ReconstructionTask
from gsrain_engine.training.model import TrainingCheckpointError
from gsrain_engine.training.settings import TrainingSettings, load_settings
from gsrain_engine.training.train import TrainingReport, reconstruct
from small_capture import small_capture

QUICK = {"steps": 40, "gaussians": 3000, "held_out": 4, "measured_every": 20, "saved_every": 15}


def task_of(folder: Path, resume: bool = False, **changes: object) -> ReconstructionTask:
    return ReconstructionTask(
        capture=folder, output=folder / "scene", settings=load_settings(None, **(QUICK | changes)), resume=resume
    )


def finished(task: ReconstructionTask, said: list[Progress] | None = None) -> TrainingReport:
    work = reconstruct(task, small_capture())
    while True:
        try:
            progress = next(work)
        except StopIteration as end:
            return end.value
        if said is not None:
            said.append(progress)


def bytes_of(folder: Path) -> dict[str, str]:
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, TrainingReport, list[Progress]]]:
    folder, said = tmp_path_factory.mktemp("whole"), list[Progress]()
    yield folder, finished(task_of(folder), said), said


def test_views_that_it_never_saw_become_more_alike(whole: tuple[Path, TrainingReport, list[Progress]]) -> None:
    numbers = whole[1].numbers
    assert numbers["psnr_held_out_db"] > numbers["psnr_before_db"] + 1
    assert numbers["psnr_held_out_db"] > 22
    assert [each["name"] for each in numbers["held_out"]] == ["2.00m"]
    assert {"seconds", "gaussians", "views"} <= set(numbers)


def test_progress_never_falls_and_ends_at_one(whole: tuple[Path, TrainingReport, list[Progress]]) -> None:
    fractions = [progress.fraction for progress in whole[2]]
    assert all(b >= a for a, b in pairwise(fractions))
    assert fractions[-1] == 1.0
    assert len(fractions) > 40
    pictures = [progress.preview for progress in whole[2] if progress.preview is not None]
    assert pictures and pictures[0].dtype == np.uint8 and pictures[0].shape[2] == 3


def test_the_scene_has_what_the_capture_had(whole: tuple[Path, TrainingReport, list[Progress]]) -> None:
    scene = read_scene(whole[0] / "scene")
    assert [layer.kind for layer in scene.layers] == ["background", "sky"]
    assert 500 < len(scene.member("layers/background").gaussians) <= 3000
    assert [camera.name for camera in scene.rigs["capture"]] == ["FRONT"]
    assert scene.ego is not None
    assert scene.ground_m == pytest.approx(0.0, abs=1e-6)
    assert not (whole[0] / "scene.checkpoint.npz").exists()


def test_two_runs_give_the_same_bytes(whole: tuple[Path, TrainingReport, list[Progress]], tmp_path: Path) -> None:
    finished(task_of(tmp_path))
    assert bytes_of(tmp_path / "scene") == bytes_of(whole[0] / "scene")


def test_another_seed_gives_another_scene(whole: tuple[Path, TrainingReport, list[Progress]], tmp_path: Path) -> None:
    finished(task_of(tmp_path, seed=1, steps=40))
    assert bytes_of(tmp_path / "scene") != bytes_of(whole[0] / "scene")


def test_a_stopped_training_goes_on_as_if_it_never_was(
    whole: tuple[Path, TrainingReport, list[Progress]], tmp_path: Path
) -> None:
    stopped = reconstruct(task_of(tmp_path), small_capture())
    for progress in stopped:
        if progress.message.startswith("Step 37"):
            break
    stopped.close()
    assert (tmp_path / "scene.checkpoint.npz").is_file()
    assert not (tmp_path / "scene").exists()
    resumed = finished(task_of(tmp_path, resume=True))
    assert bytes_of(tmp_path / "scene") == bytes_of(whole[0] / "scene")
    assert resumed.curves.losses == whole[1].curves.losses
    assert resumed.numbers["psnr_held_out_db"] == whole[1].numbers["psnr_held_out_db"]
    assert resumed.numbers["psnr_before_db"] == whole[1].numbers["psnr_before_db"]


def test_a_checkpoint_of_other_settings_is_refused(tmp_path: Path) -> None:
    stopped = reconstruct(task_of(tmp_path), small_capture())
    for progress in stopped:
        if progress.message.startswith("Saved"):
            break
    with pytest.raises(TrainingCheckpointError, match=r"scene\.checkpoint\.npz: made with d_ssim 0\.2, now it is 0\.5"):
        finished(task_of(tmp_path, resume=True, d_ssim=0.5))
    with pytest.raises(TrainingCheckpointError, match="made from other views"):
        next_one = reconstruct(task_of(tmp_path, resume=True), small_capture(moments=5))
        for _ in next_one:
            pass
    file = tmp_path / "scene.checkpoint.npz"
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(TrainingCheckpointError, match="damaged"):
        finished(task_of(tmp_path, resume=True))
    file.unlink()
    with pytest.raises(TrainingCheckpointError, match="no checkpoint to resume from"):
        finished(task_of(tmp_path, resume=True))


def test_monte_carlo_density_learns_too(tmp_path: Path) -> None:
    numbers = finished(task_of(tmp_path, density="mcmc")).numbers
    assert numbers["psnr_held_out_db"] > numbers["psnr_before_db"] + 1


def test_a_snapshot_can_be_looked_at_meanwhile(tmp_path: Path) -> None:
    settings: TrainingSettings = load_settings(None, **QUICK)
    task = ReconstructionTask(
        capture=tmp_path, output=tmp_path / "scene", settings=settings, snapshot=tmp_path / "snapshot"
    )
    for progress in reconstruct(task, small_capture()):
        if progress.message.startswith("Held-out views"):
            break
    assert len(read_scene(tmp_path / "snapshot").layers) == 2


def test_a_capture_without_poses_is_refused(tmp_path: Path) -> None:
    from PIL import Image

    for k in range(3):
        Image.fromarray(np.full((64, 96, 3), 40 * k, np.uint8)).save(tmp_path / f"{k}.png")
    with pytest.raises(CaptureError, match="COLMAP"):
        next(iter([*reconstruct(task_of(tmp_path))]))


def test_a_task_travels_to_a_worker(tmp_path):
    task = task_of(tmp_path, density="mcmc")
    assert pickle.loads(pickle.dumps(task)) == task


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
