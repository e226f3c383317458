"""LPIPS as a loss: the mean of the distances, with gradients; none where there are no weights."""

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.evaluation.lpips import (  # noqa: E402
    Lpips,
    lpips_loss,
)
from gsrain_engine.evaluation.lpips_weights import PLACE  # noqa: E402

from .random_lpips import random_weights  # noqa: E402


def test_it_is_the_mean_distance_of_a_batch(tmp_path: Path) -> None:
    weights = random_weights("vgg", seed=2)
    weights.write(tmp_path / "vgg.npz")
    loss = lpips_loss(tmp_path / "vgg.npz", "cpu")
    assert loss is not None
    random = torch.Generator().manual_seed(1)
    shown, truth = (torch.rand(2, 3, 32, 32, generator=random) * 2 - 1 for _ in range(2))
    lpips = Lpips(weights)
    pictures = [((each + 1) / 2).permute(0, 2, 3, 1).numpy().astype(np.float32) for each in (shown, truth)]
    expected = np.mean([lpips.distance(a, b) for a, b in zip(*pictures, strict=True)])
    shown.requires_grad_(True)
    found = loss(shown, truth)
    assert found.item() == pytest.approx(float(expected), rel=1e-4)
    found.backward()
    assert shown.grad.abs().sum() > 0


def test_alexnet_is_refused_and_nothing_is_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    random_weights("alex", seed=2).write(tmp_path / "alex.npz")
    with pytest.raises(ValueError, match="VGG16"):
        lpips_loss(tmp_path / "alex.npz", "cpu")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        lpips_loss(tmp_path / "nowhere.npz", "cpu")
    monkeypatch.setenv(PLACE, str(tmp_path / "empty"))
    assert lpips_loss(None, "cpu") is None
