"""SD-Turbo from a folder: found, checked to be whole, with captions, and with a transfer's weights in it."""

import json
import shutil
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")

from gsrain_engine.appearance.cyclegan_turbo import weight_paths  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import (  # noqa: E402
    CAPTIONS,
    tiny,
)
from gsrain_engine.appearance.cyclegan_turbo.pretrained import (  # noqa: E402
    caption_embeddings,
    encoded_captions,
    open_model,
    read_base,
)
from gsrain_engine.appearance.cyclegan_turbo.translator import estimated_seconds  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights  # noqa: E402

from .published_checkpoints import pristine, published, trained_model  # noqa: E402

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


def test_captions_are_what_the_text_encoder_says_and_are_kept(base: Path) -> None:
    tokenizer = transformers.AutoTokenizer.from_pretrained(base / "tokenizer")
    encoder = transformers.CLIPTextModel.from_pretrained(base / "text_encoder").eval()
    tokens = tokenizer("driving in heavy rain", max_length=77, padding="max_length", return_tensors="pt")
    assert tokens.input_ids.shape == (1, 77)
    with torch.no_grad():
        theirs = encoder(tokens.input_ids)[0]
    (ours,) = encoded_captions(["driving in heavy rain"], base)
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)
    kept = caption_embeddings(CAPTIONS, base, tiny())
    shutil.rmtree(base / "text_encoder")
    again = caption_embeddings(CAPTIONS[::-1], base, tiny())
    assert torch.equal(kept[0], again[1]) and torch.equal(kept[1], again[0])
    with pytest.raises(FileNotFoundError, match="no text encoder at .*sd-turbo.*no caption 'fog' in .*safetensors"):
        caption_embeddings(["fog"], base, tiny())
    weight_paths.captions_file().write_text("damaged")
    with pytest.raises(ValueError, match="not a readable file of captions"):
        caption_embeddings(CAPTIONS, base, tiny())


def test_a_base_that_lacks_a_weight_is_refused(base: Path) -> None:
    from safetensors.torch import load_file, save_file

    file = base / "unet" / "diffusion_pytorch_model.safetensors"
    weights = load_file(file)
    del weights["mid_block.resnets.0.conv1.weight"]
    save_file(weights, file, metadata={"format": "pt"})
    with pytest.raises(ValueError, match="'mid_block.resnets.0.conv1.weight' is missing"):
        read_base(base, tiny())
    file.unlink()
    with pytest.raises(FileNotFoundError, match="unet: no weights"):
        read_base(base, tiny())


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("vae/diffusion_pytorch_model.safetensors", "vae: weights that can't be read, perhaps not wholly downloaded"),
        ("text_encoder/model.safetensors", "its text encoder can't be read, perhaps not wholly downloaded"),
    ],
)
def test_half_a_download_is_named(base: Path, file: str, words: str) -> None:
    whole = (base / file).read_bytes()
    (base / file).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=words):
        read_base(base, tiny())


def test_another_architecture_is_refused_by_field(base: Path) -> None:
    config = base / "unet" / "config.json"
    fields = json.loads(config.read_text())
    config.write_text(json.dumps(fields | {"cross_attention_dim": 768}))
    with pytest.raises(ValueError, match=r"unet/config.json: cross_attention_dim is 768, .* with 16"):
        read_base(base, tiny())
    config.write_text(json.dumps(fields))
    schedule = base / "scheduler" / "scheduler_config.json"
    schedule.write_text(json.dumps(json.loads(schedule.read_text()) | {"prediction_type": "v_prediction"}))
    with pytest.raises(ValueError, match="prediction_type is 'v_prediction'"):
        read_base(base, tiny())
    schedule.unlink()
    with pytest.raises(FileNotFoundError, match="scheduler_config.json: no such file"):
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


def test_weights_are_found_where_they_are_put(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError, match=r"clear2rainy\.pkl there, or name a file by --weights"):
        weight_paths.find_transfer_weights()
    folder = weight_paths.data_folder() / "transfer"
    folder.mkdir(parents=True)
    for name in ("a.safetensors", "clear2rainy.pkl", "notes.txt"):
        (folder / name).touch()
    assert weight_paths.find_transfer_weights().name == "clear2rainy.pkl"
    (folder / "clear2rainy.pkl").unlink()
    assert weight_paths.find_transfer_weights().name == "a.safetensors"
    monkeypatch.setenv(weight_paths.WEIGHTS_VARIABLE, str(folder / "notes.txt"))
    assert weight_paths.find_transfer_weights().name == "notes.txt"


def test_a_published_checkpoint_upon_a_base(base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("peft")
    monkeypatch.setattr("gsrain_engine.appearance.cyclegan_turbo.pretrained.sd_turbo", tiny)
    monkeypatch.setitem(
        __import__("gsrain_engine.appearance.cyclegan_turbo.model", fromlist=["x"]).ARCHITECTURES,
        "sd-turbo",
        tiny,
    )
    torch.save(published(trained_model()), tmp_path / "clear2rainy.pkl")
    model = open_model(tmp_path / "clear2rainy.pkl", base)
    assert model.takes_guides and model.guide == ""
    assert torch.equal(model.captions["a2b"], caption_embeddings(CAPTIONS, base, tiny())[0])
    plain = open_model(None, base)
    assert not torch.equal(_out(plain), _out(model))
    save_weights(model, tmp_path / "own.safetensors")
    shutil.rmtree(base / "text_encoder")  # our own file brings its captions along
    weight_paths.captions_file().unlink()
    again = open_model(tmp_path / "own.safetensors", base)
    assert torch.equal(_out(again), _out(model))
    assert again.texts == CAPTIONS


def test_weights_trained_upon_random_ones_say_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("peft")
    save_weights(trained_model(normals=True), tmp_path / "own.safetensors")
    model = open_model(tmp_path / "own.safetensors", normals=False)
    assert "upon random weights" in caplog.text
    assert model.takes_guides  # it was trained with one
    with torch.no_grad():
        theirs = trained_model(normals=True).translate(PICTURES)
    torch.testing.assert_close(_out(model), theirs, atol=2e-4, rtol=0)


def test_larger_pictures_take_longer() -> None:
    small, large = estimated_seconds(256, 256), estimated_seconds(1024, 1024)
    assert 0 < 8 * small < large
    assert pristine().architecture.name == "tiny"
