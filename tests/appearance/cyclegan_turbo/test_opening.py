"""From what a user chooses to a transfer that runs: SD-Turbo's folder, captions, weights, normals, device."""

import json
import shutil
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")
pytest.importorskip("peft")

from safetensors.torch import load_file, save_file  # noqa: E402

from gsrain_engine.appearance.base import TrainingRecord, TransferSettings  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo import weight_paths  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.lora import LoraRanks  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import ARCHITECTURES, CAPTIONS, sd_turbo, tiny  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.pretrained import (  # noqa: E402
    caption_embeddings,
    open_model,
    read_base,
)
from gsrain_engine.appearance.cyclegan_turbo.translator import (  # noqa: E402
    chosen_device,
    estimated_seconds,
    open_cyclegan_turbo,
)
from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights  # noqa: E402

from .published_checkpoints import noise, out, published, trained_model  # noqa: E402

PICTURES = noise(5, 1, 3, 16, 16)


@pytest.fixture(scope="module")
def written_base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small SD-Turbo in the layout in which diffusers saves the real one, with a tokenizer of letters."""
    folder, words = (tmp_path_factory.mktemp(name) for name in ("sd-turbo", "words"))
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
    (words / "vocab.json").write_text(json.dumps({token: i for i, token in enumerate(tokens)}))
    (words / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer(
        str(words / "vocab.json"), str(words / "merges.txt"), pad_token="!", model_max_length=77
    )
    tokenizer.save_pretrained(folder / "tokenizer")
    return folder


@pytest.fixture
def base(written_base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it that may be damaged; nothing of the machine's own is found."""
    folder = tmp_path / "sd-turbo"
    shutil.copytree(written_base, folder)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    for name in (weight_paths.BASE_VARIABLE, weight_paths.WEIGHTS_VARIABLE, "HF_HUB_CACHE"):
        monkeypatch.delenv(name, raising=False)
    return folder


def test_captions_are_those_of_the_text_encoder_and_are_cached(base: Path) -> None:
    tokenizer = transformers.AutoTokenizer.from_pretrained(base / "tokenizer")
    encoder = transformers.CLIPTextModel.from_pretrained(base / "text_encoder").eval()
    tokens = tokenizer(CAPTIONS[0], max_length=77, padding="max_length", return_tensors="pt")
    with torch.no_grad():
        theirs = encoder(tokens.input_ids)[0]
    cached = caption_embeddings(CAPTIONS, base, tiny())
    torch.testing.assert_close(cached[0], theirs, rtol=1e-4, atol=1e-5)
    shutil.rmtree(base / "text_encoder")
    swapped = caption_embeddings(CAPTIONS[::-1], base, tiny())
    assert torch.equal(cached[0], swapped[1]) and torch.equal(cached[1], swapped[0])
    with pytest.raises(FileNotFoundError, match="text encoder.*'fog'"):
        caption_embeddings(["fog"], base, tiny())
    with pytest.raises(ValueError, match=r"sd-turbo\.safetensors.*\(1, 77, 16\)"):
        caption_embeddings(CAPTIONS, base, sd_turbo())
    weight_paths.captions_file().write_text("damaged")
    with pytest.raises(ValueError, match=r"sd-turbo\.safetensors"):
        caption_embeddings(CAPTIONS, base, tiny())


def _halved(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def _without(name: str):
    def change(file: Path) -> None:
        save_file(
            {key: each for key, each in load_file(file).items() if not key.endswith(name)},
            file,
            metadata={"format": "pt"},
        )

    return change


def _with(**fields: Any):
    def change(file: Path) -> None:
        file.write_text(json.dumps(json.loads(file.read_text()) | fields))

    return change


_UNET, _TEXT = "unet/diffusion_pytorch_model.safetensors", "text_encoder/model.safetensors"


@pytest.mark.parametrize(
    ("file", "damage", "error", "name"),
    [
        (_UNET, _without("mid_block.resnets.0.conv1.weight"), ValueError, "mid_block.resnets.0.conv1.weight"),
        (_UNET, Path.unlink, FileNotFoundError, "unet"),
        ("vae/diffusion_pytorch_model.safetensors", _halved, ValueError, "vae"),
        (_TEXT, _halved, ValueError, "text encoder"),
        (_TEXT, _without("final_layer_norm.weight"), ValueError, "text_encoder.*final_layer_norm"),
        ("unet/config.json", _with(cross_attention_dim=768), ValueError, r"config\.json: cross_attention_dim is 768"),
        ("unet/config.json", lambda file: file.write_text("[]"), ValueError, r"config\.json"),
        ("unet/config.json", lambda file: file.write_text("{"), ValueError, r"config\.json"),
        ("scheduler/scheduler_config.json", _with(prediction_type="v_prediction"), ValueError, "prediction_type"),
        ("scheduler/scheduler_config.json", Path.unlink, FileNotFoundError, r"scheduler_config\.json"),
    ],
)
def test_a_damaged_base_is_refused_by_file_and_field(base: Path, file: str, damage, error: type, name: str) -> None:
    damage(base / file)
    with pytest.raises(error, match=name):
        read_base(base, tiny())


def test_places_are_tried_in_order(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError, match="stabilityai--sd-turbo: hf download .*GSRAIN_SD_TURBO"):
        weight_paths.find_base_model()
    hub = base.parent / "hub" / "hub" / "models--stabilityai--sd-turbo"
    (hub / "refs").mkdir(parents=True)
    (hub / "refs" / "main").write_text("bbb")
    for place in (hub / "snapshots" / "aaa", hub / "snapshots" / "bbb", weight_paths.data_folder() / "sd-turbo"):
        shutil.copytree(base, place)
        assert weight_paths.find_base_model() == place
    monkeypatch.setenv(weight_paths.BASE_VARIABLE, str(base))
    assert weight_paths.find_base_model() == base
    with pytest.raises(FileNotFoundError, match="elsewhere"):
        weight_paths.find_base_model(base.parent / "elsewhere")


def test_a_published_checkpoint_upon_a_base(base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gsrain_engine.appearance.cyclegan_turbo.pretrained.sd_turbo", tiny)
    monkeypatch.setitem(ARCHITECTURES, "sd-turbo", tiny)
    torch.save(published(trained_model()), tmp_path / "clear2rainy.pkl")
    plain, model = open_model(None, base, normals=False), open_model(tmp_path / "clear2rainy.pkl", base)
    theirs = diffusers.UNet2DConditionModel.from_pretrained(base / "unet")
    assert torch.equal(plain.unet.conv_out.weight, theirs.conv_out.weight) and plain.texts == CAPTIONS
    assert model.takes_guides and model.guide == "" and not any(each.requires_grad for each in model.parameters())
    assert torch.equal(model.captions["a2b"], caption_embeddings(CAPTIONS, base, tiny())[0])
    assert not torch.equal(out(plain, PICTURES), out(model, PICTURES))
    save_weights(model, tmp_path / "own.safetensors")
    shutil.rmtree(base / "text_encoder")  # our own file has the embeddings of its captions
    weight_paths.captions_file().unlink()
    copy = open_model(tmp_path / "own.safetensors", base)
    assert torch.equal(out(copy, PICTURES), out(model, PICTURES)) and copy.texts == CAPTIONS


def _changed(name: str, to: Any):
    def change(file: Path) -> None:
        save_file(
            {key: to(each) if key.endswith(name) else each for key, each in load_file(file).items()},
            file,
            metadata={"format": "pt"},
        )

    return change


def test_another_base_than_that_of_the_training_is_refused(base: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("gsrain_engine.appearance.cyclegan_turbo.pretrained.sd_turbo", tiny)
    trained = open_model(None, base, normals=False, lora=LoraRanks(2, 2))
    record = TrainingRecord(
        conditioning="none", normals="none", framing="stretch", width_px=64, height_px=48, base=trained.base
    )
    file, older = tmp_path / "own.safetensors", tmp_path / "older.safetensors"
    save_weights(trained, file, record)
    save_weights(trained, older, structs.replace(record, base=""))
    _changed("", lambda values: values.half())(base / _UNET)  # a copy in half precision is the same base
    assert open_model(file, base).record == record and open_model(older, base).record is not None
    settings = TransferSettings(weights=file, base=base)
    words = rf"own\.safetensors: trained upon another SD-Turbo \({record.base}\).*--override"
    as_it_was = (base / _UNET).read_bytes()
    for tensor in ("mid_block.resnets.0.conv1.weight", "conv_out.bias"):
        (base / _UNET).write_bytes(as_it_was)
        _changed(tensor, lambda values: values + 0.1)(base / _UNET)
        with pytest.raises(ValueError, match=words):
            open_cyclegan_turbo(settings)
        if tensor != "conv_out.bias":  # all that files without the fingerprint can tell
            assert open_model(older, base).base not in ("", record.base)
    assert open_cyclegan_turbo(structs.replace(settings, override=True)).model.record == record


# Transfers


def test_normals_count_where_the_weights_were_trained_with_them(tmp_path, caplog):
    caplog.set_level("INFO")
    for guide, used in (("normals", "depth"), ("", "none")):
        model = deepcopy(trained_model(normals=bool(guide)))
        model.guide = guide
        save_weights(model, tmp_path / "own.safetensors")
        settings = TransferSettings(weights=tmp_path / "own.safetensors", guide="luma")
        opened = open_cyclegan_turbo(settings)
        assert (opened.settings.normals, opened.settings.guide, opened.model.guide) == (used, "luma", guide)
    assert "upon random weights" in caplog.text and "trained without normals" in caplog.text


def test_weights_normals_and_devices_that_do_not_fit_are_refused(tmp_path, monkeypatch):
    model = deepcopy(trained_model(normals=True))
    for guide, normals in (("mask", "depth"), ("normals", "dsine")):
        model.guide = guide
        save_weights(model, tmp_path / f"{guide}.safetensors")
        with pytest.raises(ValueError, match="mask|dsine"):
            open_cyclegan_turbo(TransferSettings(weights=tmp_path / f"{guide}.safetensors", normals=normals))
    with pytest.raises(FileNotFoundError, match=r"none\.pkl"):
        open_cyclegan_turbo(TransferSettings(weights=tmp_path / "none.pkl"))
    for is_there, devices in ((False, ["cpu", "cpu"]), (True, ["cuda", "cpu"])):
        monkeypatch.setattr(torch.cuda, "is_available", lambda is_there=is_there: is_there)
        assert [chosen_device(name) for name in ("auto", "cpu")] == devices
    assert chosen_device("cuda") == "cuda"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="GPU"):
        chosen_device("cuda")
    monkeypatch.setattr("gsrain_engine.appearance.cyclegan_turbo.translator.measured_speed", lambda *_: 1e11)
    assert 0 < 8 * estimated_seconds(256, 256) < estimated_seconds(1024, 1024)
