"""Records of training: stored with the weights, followed by transfers, refused where they are contradicted."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("peft")

from gsrain_engine.appearance.base import NetworkInput, TrainingRecord, TransferSettings, follow_training  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.translator import CycleGanTurboTransfer, open_cyclegan_turbo  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.weight_paths import read_record  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.weights import (  # noqa: E402
    PUBLISHED,
    open_weights,
    save_weights,
)
from gsrain_engine.appearance.finetune.dataset import ImageSettings, ImageSource  # noqa: E402
from gsrain_engine.evaluation.compare_translators import held_out_images  # noqa: E402

from .published_checkpoints import published, trained_model  # noqa: E402
from .test_transfer import wall  # noqa: E402

RECORD = TrainingRecord(
    conditioning="luma", normals="dsine", framing="stretch", width_px=64, height_px=48, seed=3, steps=200, held_out="x"
)
RGB = msgspec.structs.replace(RECORD, conditioning="none", normals="none")


def test_a_record_is_stored_in_the_file_of_the_weights(tmp_path: Path) -> None:
    save_weights(trained_model(normals=True), tmp_path / "weights.safetensors", RECORD)
    assert read_record(tmp_path / "weights.safetensors") == RECORD
    assert open_weights(tmp_path / "weights.safetensors").record == RECORD
    save_weights(trained_model(normals=True), tmp_path / "without.safetensors")
    assert read_record(tmp_path / "without.safetensors") is None
    torch.save(published(trained_model()), tmp_path / "clear2rainy.pkl")
    assert open_weights(tmp_path / "clear2rainy.pkl").record == PUBLISHED


@pytest.mark.parametrize(
    ("asked", "record", "expected"),
    [
        ({}, None, ("depth", "up", "proportions")),
        ({}, RECORD, ("dsine", "luma", "stretch")),
        ({}, RGB, ("none", "up", "stretch")),
        ({"guide": "luma", "normals": "dsine"}, RECORD, ("dsine", "luma", "stretch")),
        ({"guide": "up", "framing": "proportions", "override": True}, RECORD, ("dsine", "up", "proportions")),
        ({"guide": "up"}, RECORD, "conditioning"),
        ({"normals": "depth"}, RECORD, "normals"),
        ({"normals": "none"}, RECORD, "normals"),
        ({"normals": "depth"}, RGB, "normals"),
        ({"framing": "proportions"}, RECORD, "framing"),
    ],
)
def test_what_is_not_asked_for_follows_the_training(asked, record, expected) -> None:
    if isinstance(expected, str):
        with pytest.raises(ValueError, match=f"w.safetensors: .*{expected}.*--override"):
            follow_training(TransferSettings(**asked), record, "w.safetensors")
    else:
        found = follow_training(TransferSettings(**asked), record, "w.safetensors")
        assert (found.normals, found.guide, found.framing) == expected


def test_a_contradiction_is_refused_before_anything_large_is_read(tmp_path: Path) -> None:
    save_weights(trained_model(normals=True), tmp_path / "weights.safetensors", RECORD)
    with pytest.raises(ValueError, match="weights.safetensors: trained with conditioning luma, not up"):
        open_cyclegan_turbo(
            TransferSettings(weights=tmp_path / "weights.safetensors", base=tmp_path / "nowhere", guide="up")
        )


@pytest.mark.parametrize(("framing", "size"), [(None, (48, 64)), ("proportions", (64, 96))])
def test_the_network_sees_pictures_as_in_its_training(framing, size) -> None:
    model = build_random_model(tiny(), normals=False, seed=1)
    model.record = RGB
    shapes = []
    translate = model.translate
    model.translate = lambda pictures, *rest: shapes.append(tuple(pictures.shape)) or translate(pictures, *rest)
    transfer = CycleGanTurboTransfer(model, TransferSettings(framing=framing, override=True))
    view = wall("a", 0.0)
    (rainy,) = transfer.transferred([view])
    assert shapes == [(1, 3, *size)] and rainy.image.shape == view.image.shape
    seen = NetworkInput(network_px=size[::-1], framing=framing or "stretch", normals="none", conditioning="none")
    assert transfer.network_input(view) == rainy.framed.input == seen
    assert rainy.framed.image.shape == (*size, 3) and rainy.framed.guide is None
    assert seen.words == f"the network saw {size[1]}x{size[0]} px ({seen.framing}), RGB only"


@pytest.mark.parametrize("tile_px", [None, 64])
def test_the_framed_view_is_the_tensor_that_went_into_the_network(tile_px) -> None:
    model = build_random_model(tiny(), normals=True, seed=1)
    tensors = []
    translate = model.translate
    model.translate = lambda *given: tensors.append(given[:2]) or translate(*given)
    transfer = CycleGanTurboTransfer(model, TransferSettings(guide="luma", tile_px=tile_px))
    (rainy,) = transfer.transferred([wall("a", 0.0)])
    framed, (pictures, guides) = rainy.framed, tensors[0]
    for found, tensor in ((framed.image, pictures[0].permute(1, 2, 0)), (framed.guide, guides[0, 0])):
        expected = (tensor.numpy() + 1) * 127.5
        assert np.abs(found[: tensor.shape[0], : tensor.shape[1]] - expected).max() <= 0.51
    assert np.ptp(framed.image) > 20
    assert framed.input.tiles == len(tensors) and ("tiles" in framed.input.words) == (tile_px is not None)
    assert framed.image.shape[1::-1] == framed.input.network_px


def test_weights_that_may_have_seen_the_compared_pictures_are_refused(tmp_path: Path) -> None:
    for look in ("clear", "rainy"):
        (tmp_path / look).mkdir()
        for number in range(10):
            pixels = np.random.default_rng(number).integers(0, 255, (32, 32, 3), np.uint8)
            Image.fromarray(pixels).save(tmp_path / look / f"{number}.png")
    clear, rainy = ((ImageSource(path=str(tmp_path / look)),) for look in ("clear", "rainy"))
    pictures = ImageSettings(clear=clear, rainy=rainy, width_px=32, height_px=32)
    file = tmp_path / "weights.safetensors"
    save_weights(trained_model(), file, RGB)
    with pytest.raises(ValueError, match="held out"):
        held_out_images(pictures, 32, [file])
    save_weights(trained_model(), file, msgspec.structs.replace(RGB, held_out=""))
    held_out_images(pictures, 32, [file])
