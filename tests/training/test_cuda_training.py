"""Training on CUDA, on a pretend device: no step waits for the GPU, and its numbers are the CPU's to a tolerance.

Byte-equality is promised on the CPU only: on a GPU, atomic additions of gsplat come in another order in each run.
"""

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.render.gsplat_build import ANNOUNCEMENT  # noqa: E402
from gsrain_engine.scene.progress import Progress, run_to_end  # noqa: E402
from gsrain_engine.training.data import ReconstructionTask  # noqa: E402
from gsrain_engine.training.free_space import DeviceFreeSpace, FreeSpaceCarving  # noqa: E402
from gsrain_engine.training.mcmc import MCMCSettings, MCMCStrategy  # noqa: E402
from gsrain_engine.training.parameters import SplatParameters, indices_of  # noqa: E402
from gsrain_engine.training.settings import load_settings  # noqa: E402
from gsrain_engine.training.targets import TargetCache  # noqa: E402
from gsrain_engine.training.train import reconstruct  # noqa: E402
from small_capture import small_capture  # noqa: E402

from .drive_capture import drive_capture, world_depth  # noqa: E402
from .pretend_device import pretend_device  # noqa: E402
from .random_splats import random_splats  # noqa: E402
from .tiny_training import tiny_training  # noqa: E402


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch):
    with pretend_device(monkeypatch) as found:
        yield found


@pytest.mark.parametrize("density", ["adaptive", "mcmc"])
def test_no_step_waits_for_the_gpu(device, density: str) -> None:
    """With masks, depth, sky, an actor, exposures, transients: whatever a step may use."""
    training = tiny_training("cuda", density)
    for number in (10, 121, 122):  # before and after transients are left out; a view's first use and a later one
        with device.recording():
            training.step(number)
    assert device.synchronizations == []
    assert device.kernels < 2100  # of which the stand-in's backward pass starts some 1,500


@pytest.mark.parametrize(("density", "change", "reads"), [("adaptive", "split", 2), ("mcmc", "added", 3)])
def test_a_change_of_the_number_of_gaussians_reads_counts_alone(device, density, change: str, reads: int) -> None:
    training = tiny_training("cuda", density)
    training.step(149)
    with device.recording():
        assert change in training.step(150).change  # density control and free space
    assert len(device.synchronizations) <= reads
    assert all("for mask in masks]).tolist()" in each for each in device.synchronizations)


def test_the_record_notices_each_kind_of_synchronization(device) -> None:
    values = torch.arange(6, device="cuda")
    plain = torch.zeros(3)
    for waits in (
        lambda: bool((values > 2).any()), lambda: float(values.sum()), values.cpu, lambda: values[values > 2],
        lambda: torch.nonzero(values), lambda: plain.to("cuda"), lambda: torch.tensor([1.0], device="cuda"),
        lambda: torch.as_tensor(np.zeros(3), device="cuda"), lambda: torch.bincount(values),
        lambda: plain.pin_memory().to("cuda"), values.tolist, lambda: plain.copy_(values[:3]),
    ):  # fmt: skip
        device.synchronizations.clear()
        with device.recording():
            waits()
        assert device.synchronizations
    device.synchronizations.clear()
    with device.recording():
        plain.pin_memory().to("cuda", non_blocking=True)
        torch.where(values > 2, values, 0).sum().add_(1)
        values[torch.arange(2, device="cuda")] = 0
    assert device.synchronizations == []


def test_steps_and_their_changes_are_those_of_the_cpu_within_a_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = [*range(97, 102), *range(148, 152)]
    here, expected = tiny_training("cpu"), []
    for number in numbers:
        done = here.step(number)
        expected.append((done.change, *here.losses([done.loss])))
    with pretend_device(monkeypatch):
        there = tiny_training("cuda")
        results = [there.step(number) for number in numbers]
        losses = there.losses([each.loss for each in results])
        state = there.state()
    assert [each.change for each in results] == [change for change, _ in expected] and any(expected[-2])
    assert losses == pytest.approx([loss for _, loss in expected], rel=2e-3)
    for name, array in here.state().items():
        assert array.shape == state[name].shape, name
        if name.endswith((":means", ":log_scales", ":opacity_logits", ":sh_dc", ":changes")):
            close = np.isclose(state[name], array, rtol=2e-3, atol=2e-3)
            assert close.mean() > 0.97, name  # Adam moves by the sign of gradients near 0


def test_noise_moves_faint_gaussians_alone(device) -> None:
    many = random_splats(40)
    many.opacities[:] = np.where(np.arange(40) < 20, 0.004, 0.9)
    splats = SplatParameters.from_gaussians(many, 0, "cuda")
    control = MCMCStrategy(MCMCSettings(max_count=0, means_rate=lambda step: 1.0, noise=1e3))
    with device.recording():
        control.adapt(3, splats, torch.Generator("cuda").manual_seed(1))
    moved = np.abs(splats.to_means() - many.means).max(axis=1)
    assert (moved[:20] > 0).all() and (moved[20:] == 0).all() and device.synchronizations == []


def test_indices_of_masks_rise_and_are_counted_at_once(device) -> None:
    masks = torch.rand(3, 50, generator=torch.Generator().manual_seed(0)) < torch.tensor([[0.3], [0.0], [1.0]])
    with device.recording():
        found = indices_of(*(each.to("cuda:0") for each in masks.pin_memory().to("cuda", non_blocking=True)))
    for mask, indices in zip(masks, found, strict=True):
        assert indices.tolist() == torch.nonzero(mask)[:, 0].tolist()
    assert len(device.synchronizations) == 1


def test_free_space_is_that_of_the_cpu(device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gsrain_engine.training.free_space._CHUNK", 5000)  # several pieces
    views = drive_capture(3).views
    depths = [np.where(np.isfinite(d := world_depth(v.camera)), d, 0).astype(np.float32) for v in views]
    trajectory = np.array([view.camera.position for view in views])
    space = FreeSpaceCarving.of([view.camera for view in views], depths, trajectory, 0.4)
    points = np.random.default_rng(0).uniform((-5, -8, -3), (40, 8, 8), (4000, 3)).astype(np.float32)
    there = DeviceFreeSpace(space, "cuda")
    on_device = torch.tensor(points, device="cuda")
    inside, expected = np.array(there.holds(on_device).tolist()), space.holds(points)
    assert expected.mean() > 0.02 and (inside == expected).mean() > 0.999
    np.testing.assert_allclose(there.distances(on_device).tolist(), space.distances(points), rtol=1e-5, atol=1e-5)


def test_targets_stay_on_the_device_up_to_a_bound_on_memory(device) -> None:
    views = tiny_training("cpu").views
    one = TargetCache(views, "cpu").target(0, 0)
    size = TargetCache(views, "cuda")
    size.target(0, 0)
    assert len(size) == 1
    cache = TargetCache(views, "cuda", max_bytes=8000)  # of 4,000 each, the indices of depth in 64 bits
    for _ in range(2):
        for view in (0, 1):
            for level in (0, 1):
                found = cache.target(view, level)
                expected = TargetCache(views, "cpu").target(view, level)
                for mine, theirs in zip(found[:-1], expected[:-1], strict=True):
                    assert mine.tolist() == theirs.tolist()
                assert found.pixels == expected.pixels == 32 * 22
    assert 0 < len(cache) < 4 and one.image.max() <= 1


def test_stages_are_timed_by_events_of_the_device(device) -> None:
    training = tiny_training("cuda")
    results = [training.step(number) for number in (10, 11, 12)]
    assert not any(training.seconds_by_stage.values())
    assert len(training.losses([each.loss for each in results])) == 3
    assert training.seconds_by_stage == pytest.approx(dict.fromkeys(training.seconds_by_stage, 3 * 0.002))


def test_a_reconstruction_announces_the_build_and_reads_losses_when_a_line_is_due(
    device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setenv("TORCH_EXTENSIONS_DIR", str(tmp_path / "extensions"))
    monkeypatch.setattr("gsrain_engine.training_run._FIGURES_INTERVAL_S", 1e9)
    values = {"steps": 4, "gaussians": 200, "width_px": 32, "held_out": 4, "measured_every": 0, "device": "cuda"}
    task = ReconstructionTask(capture=tmp_path, output=tmp_path / "scene", settings=load_settings(None, **values))
    steps: list[Progress] = []
    report = run_to_end(reconstruct(task, small_capture(width=32)), steps.append)
    fractions = [step.fraction for step in steps]
    assert any(step.message == ANNOUNCEMENT for step in steps) and fractions == sorted(fractions)
    assert sum("loss" in step.metrics for step in steps) == 1  # of four steps only the first line was due
    assert len(report.curves.losses) == 4 and np.isfinite(report.curves.losses).all()
