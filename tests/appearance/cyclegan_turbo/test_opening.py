"""From what a user chooses to a transfer that runs: SD-Turbo's folder, captions, weights, normals, device."""

import json
import shutil
from copy import deepcopy
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")
pytest.importorskip("peft")

from safetensors.torch import load_file, save_file  # noqa: E402

from gsrain_engine.appearance.base import ClearView, TransferSettings  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo import weight_paths  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import ARCHITECTURES, CAPTIONS, tiny  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.pretrained import (  # noqa: E402
    caption_embeddings,
    encoded_captions,
    open_model,
    read_base,
)
from gsrain_engine.appearance.cyclegan_turbo.translator import (  # noqa: E402
    chosen_device,
    estimated_seconds,
    open_cyclegan_turbo,
)
from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights  # noqa: E402
from gsrain_engine.scene.camera import Camera  # noqa: E402

from .published_checkpoints import published, trained_model  # noqa: E402

_KEPT = TemporaryDirectory(prefix="gsrain-tiny-turbo-")


PICTURES = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(5)) * 2 - 1


@cache
def _written_base() -> Path:
    """A small SD-Turbo in the layout in which diffusers saves the real one, with a tokenizer of letters."""
    folder = Path(_KEPT.name) / "sd-turbo"
    torch.manual_seed(4)
    diffusers.UNet2DConditionModel(**tiny().unet).save_pretrained(folder / "unet")
    diffusers.AutoencoderKL(**tiny().vae).save_pretrained(folder / "vae")
    first, last = tiny().betas
    schedule = diffusers.EulerDiscreteScheduler(
        beta_start=first, beta_end=last, beta_schedule="scaled_linear", timestep_spacing="trailing"
    )
    schedule.save_pretrained(folder / "scheduler")
    config = transformers.CLIPTextConfig(**tiny().text, bos_token_id=0, eos_token_id=1, pad_token_id=2)
    transformers.CLIPTextModel(config).save_pretrained(folder / "text_encoder")
    letters = "abcdefghijklmnopqrstuvwxyz"
    tokens = ["<|startoftext|>", "<|endoftext|>", "!", *letters, *(f"{letter}</w>" for letter in letters)]
    words = Path(_KEPT.name) / "words"
    words.mkdir()
    (words / "vocab.json").write_text(json.dumps({token: i for i, token in enumerate(tokens)}))
    (words / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer(
        str(words / "vocab.json"), str(words / "merges.txt"), pad_token="!", model_max_length=77
    )
    tokenizer.save_pretrained(folder / "tokenizer")
    return folder


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it that may be damaged; nothing of the machine's own is found."""
    folder = tmp_path / "sd-turbo"
    shutil.copytree(_written_base(), folder)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    for name in (weight_paths.BASE_VARIABLE, weight_paths.WEIGHTS_VARIABLE, "HF_HUB_CACHE"):
        monkeypatch.delenv(name, raising=False)
    return folder


def _out(model: Any) -> Any:
    with torch.no_grad():
        return model.translate(PICTURES)


def test_a_base_in_diffusers_layout_is_read_whole(base: Path) -> None:
    model = read_base(base, tiny(), normals=False)
    theirs = diffusers.UNet2DConditionModel.from_pretrained(base / "unet")
    assert torch.equal(model.unet.conv_out.weight, theirs.conv_out.weight)
    assert model.texts == CAPTIONS
    assert not torch.equal(model.captions["a2b"], model.captions["b2a"])
    assert not any(each.requires_grad for each in model.parameters())
    assert torch.equal(_out(model), _out(read_base(base, tiny(), normals=True)))


def test_captions_are_what_the_text_encoder_says_and_are_cached(base: Path) -> None:
    tokenizer = transformers.AutoTokenizer.from_pretrained(base / "tokenizer")
    encoder = transformers.CLIPTextModel.from_pretrained(base / "text_encoder").eval()
    tokens = tokenizer("driving in heavy rain", max_length=77, padding="max_length", return_tensors="pt")
    assert tokens.input_ids.shape == (1, 77)
    with torch.no_grad():
        theirs = encoder(tokens.input_ids)[0]
    (ours,) = encoded_captions(["driving in heavy rain"], base)
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)
    cached = caption_embeddings(CAPTIONS, base, tiny())
    shutil.rmtree(base / "text_encoder")
    swapped = caption_embeddings(CAPTIONS[::-1], base, tiny())
    assert torch.equal(cached[0], swapped[1]) and torch.equal(cached[1], swapped[0])
    with pytest.raises(FileNotFoundError, match="text encoder.*'fog'"):
        caption_embeddings(["fog"], base, tiny())
    weight_paths.captions_file().write_text("damaged")
    with pytest.raises(ValueError, match="captions"):
        caption_embeddings(CAPTIONS, base, tiny())


def _halved(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def _without_a_weight(file: Path) -> None:
    weights = load_file(file)
    del weights["mid_block.resnets.0.conv1.weight"]
    save_file(weights, file, metadata={"format": "pt"})


def _with(**fields: Any):
    def change(file: Path) -> None:
        file.write_text(json.dumps(json.loads(file.read_text()) | fields))

    return change


@pytest.mark.parametrize(
    ("file", "damage", "error", "name"),
    [
        ("unet/diffusion_pytorch_model.safetensors", _without_a_weight, ValueError, "mid_block.resnets.0.conv1.weight"),
        ("unet/diffusion_pytorch_model.safetensors", Path.unlink, FileNotFoundError, "unet"),
        ("vae/diffusion_pytorch_model.safetensors", _halved, ValueError, "vae"),
        ("text_encoder/model.safetensors", _halved, ValueError, "text encoder"),
        ("unet/config.json", _with(cross_attention_dim=768), ValueError, r"config\.json: cross_attention_dim is 768"),
        ("scheduler/scheduler_config.json", _with(prediction_type="v_prediction"), ValueError, "prediction_type"),
        ("scheduler/scheduler_config.json", Path.unlink, FileNotFoundError, r"scheduler_config\.json"),
    ],
)
def test_a_damaged_base_is_refused_by_file_and_field(base: Path, file: str, damage, error: type, name: str) -> None:
    damage(base / file)
    with pytest.raises(error, match=name):
        read_base(base, tiny())


def test_places_are_tried_in_order(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        FileNotFoundError,
        match=r"no SD-Turbo .*models--stabilityai--sd-turbo: hf download stabilityai/sd-turbo .*GSRAIN_SD_TURBO",
    ):
        weight_paths.find_base_model()
    snapshots = Path(base.parent) / "hub" / "hub" / "models--stabilityai--sd-turbo"
    for name in ("aaa", "bbb"):
        shutil.copytree(base, snapshots / "snapshots" / name)
    (snapshots / "refs").mkdir()
    (snapshots / "refs" / "main").write_text("bbb")
    assert weight_paths.find_base_model() == snapshots / "snapshots" / "bbb"
    shutil.copytree(base, weight_paths.data_folder() / "sd-turbo")
    assert weight_paths.find_base_model() == weight_paths.data_folder() / "sd-turbo"
    monkeypatch.setenv(weight_paths.BASE_VARIABLE, str(base))
    assert weight_paths.find_base_model() == base
    with pytest.raises(FileNotFoundError, match="elsewhere"):
        weight_paths.find_base_model(base.parent / "elsewhere")


def test_a_published_checkpoint_upon_a_base(base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gsrain_engine.appearance.cyclegan_turbo.pretrained.sd_turbo", tiny)
    monkeypatch.setitem(ARCHITECTURES, "sd-turbo", tiny)
    torch.save(published(trained_model()), tmp_path / "clear2rainy.pkl")
    model = open_model(tmp_path / "clear2rainy.pkl", base)
    assert model.takes_guides and model.guide == ""
    assert torch.equal(model.captions["a2b"], caption_embeddings(CAPTIONS, base, tiny())[0])
    assert not torch.equal(_out(open_model(None, base)), _out(model))
    save_weights(model, tmp_path / "own.safetensors")
    shutil.rmtree(base / "text_encoder")  # our own file brings its captions along
    weight_paths.captions_file().unlink()
    copy = open_model(tmp_path / "own.safetensors", base)
    assert torch.equal(_out(copy), _out(model)) and copy.texts == CAPTIONS


def test_weights_trained_upon_random_ones_say_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("peft")
    save_weights(trained_model(normals=True), tmp_path / "own.safetensors")
    model = open_model(tmp_path / "own.safetensors", normals=False)
    assert "upon random weights" in caplog.text
    assert model.takes_guides  # it was trained with one
    with torch.no_grad():
        theirs = trained_model(normals=True).translate(PICTURES)
    torch.testing.assert_close(_out(model), theirs, atol=2e-4, rtol=0)


# Transfers


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


def test_normals_count_where_the_weights_know_them(weights, caplog):
    file = weights()
    with_normals = image(TransferSettings(weights=file))
    assert with_normals.shape == (40, 48, 3) and np.array_equal(with_normals, image(TransferSettings(weights=file)))
    assert not np.array_equal(with_normals, image(TransferSettings(weights=file, guide="luma")))
    caplog.set_level("INFO")
    assert open_cyclegan_turbo(TransferSettings(weights=weights(""))).settings.normals == "none"
    assert "trained without normals" in caplog.text


def test_weights_normals_and_devices_that_do_not_fit_are_refused(weights, tmp_path, monkeypatch):
    for error, match, settings in (
        (ValueError, "mask", TransferSettings(weights=weights("mask"))),
        (ValueError, "dsine", TransferSettings(weights=weights(), normals="dsine")),
        (FileNotFoundError, r"none\.pkl", TransferSettings(weights=tmp_path / "none.pkl")),
    ):
        with pytest.raises(error, match=match):
            open_cyclegan_turbo(settings)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert [chosen_device(name) for name in ("auto", "cpu")] == ["cpu", "cpu"]
    with pytest.raises(ValueError, match="GPU"):
        chosen_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [chosen_device(name) for name in ("auto", "cpu", "cuda")] == ["cuda", "cpu", "cuda"]
    assert 0 < 8 * estimated_seconds(256, 256) < estimated_seconds(1024, 1024)
