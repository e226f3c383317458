"""From what a person chooses to a transfer that runs: weights from a file, normals, neighbours, device."""

from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("peft")

from gsrain_engine.appearance.base import (  # noqa: E402
    ClearView,
    TransferSettings,
)
from gsrain_engine.appearance.cyclegan_turbo.translator import (  # noqa: E402
    chosen_device,
    open_cyclegan_turbo,
)
from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights  # noqa: E402
from gsrain_engine.appearance.registry import open_transfer  # noqa: E402
from gsrain_engine.scene.camera import Camera  # noqa: E402

from .published_checkpoints import trained_model  # noqa: E402


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Gives the file of a small model's weights, with a fourth channel of this kind."""
    folder = tmp_path_factory.mktemp("weights")

    def written(guide: str = "normals") -> Path:
        file = folder / f"{guide or 'plain'}.safetensors"
        if not file.exists():
            model = deepcopy(trained_model(normals=bool(guide)))
            model.guide = guide
            save_weights(model, file)
        return file

    return written


def view() -> ClearView:
    random = np.random.default_rng(1)
    plane = np.zeros((40, 48), np.float32)
    normals = np.zeros((40, 48, 3), np.float32)
    normals[20:, :, 2] = 1
    image = random.random((40, 48, 3), dtype=np.float32)
    return ClearView("one", Camera.from_fov(48, 40, 60, np.eye(4)), 0, image, plane + 5, normals, plane, plane)


def image(settings: TransferSettings) -> np.ndarray:
    (made,) = open_cyclegan_turbo(settings).transferred([view()])
    return made.image


def test_the_table_opens_it(weights):
    transfer = open_transfer("cyclegan-turbo", TransferSettings(weights=weights(), device="cpu"), surroundings=None)
    assert transfer.name == "cyclegan-turbo"
    (made,) = transfer.transferred([view()])
    assert made.image.shape == (40, 48, 3)


def test_choices_arrive(weights):
    file = weights()
    opened = open_cyclegan_turbo(
        TransferSettings(weights=file, guide="luma", neighbours=3, side_px=256, tile_px=128, device="cpu")
    )
    run = opened.settings
    assert (run.normals, run.guide, run.side_px, run.tile_px) == ("depth", "luma", 256, 128)
    assert run.mutual is not None and run.mutual.neighbours == 3
    assert open_cyclegan_turbo(TransferSettings(weights=file, mutual_attention=False)).settings.mutual is None


def test_normals_count_where_the_weights_know_them(weights):
    file = weights()
    with_normals = image(TransferSettings(weights=file))
    assert np.array_equal(with_normals, image(TransferSettings(weights=file)))
    assert not np.array_equal(with_normals, image(TransferSettings(weights=file, guide="luma")))


def test_weights_without_normals_leave_them_out(weights, caplog):
    caplog.set_level("INFO")
    opened = open_cyclegan_turbo(TransferSettings(weights=weights("")))
    assert opened.settings.normals == "none"
    assert "trained without normals" in caplog.text


def test_what_does_not_fit_is_refused(weights, tmp_path):
    with pytest.raises(ValueError, match="a mask of classes, not normals"):
        open_cyclegan_turbo(TransferSettings(weights=weights("mask")))
    with pytest.raises(ValueError, match="dsine needs weights"):
        open_cyclegan_turbo(TransferSettings(weights=weights(), normals="dsine"))
    with pytest.raises(FileNotFoundError, match="none.pkl"):
        open_cyclegan_turbo(TransferSettings(weights=tmp_path / "none.pkl"))


def test_devices(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert [chosen_device(name) for name in ("auto", "cpu")] == ["cpu", "cpu"]
    with pytest.raises(ValueError, match="torch finds no GPU here"):
        chosen_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [chosen_device(name) for name in ("auto", "cpu", "cuda")] == ["cuda", "cpu", "cuda"]
