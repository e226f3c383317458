"""Files of weights in every layout: what they compute, and what is refused by name."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("peft")

from gsrain_engine.appearance.cyclegan_turbo.model import CycleGanTurbo  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.weights import (  # noqa: E402
    apply_adapter_weights,
    open_weights,
    save_weights,
)

from .published_checkpoints import (  # noqa: E402
    load_weights,
    pristine,
    published,
    to_train,
    trained_first_convolutions,
    trained_model,
    untrained,
    weatheredit,
    with_mask_channel,
)

PICTURES = torch.rand(1, 3, 32, 40, generator=torch.Generator().manual_seed(5)) * 2 - 1
GUIDES = torch.rand(1, 1, 32, 40, generator=torch.Generator().manual_seed(6)) * 2 - 1


def _out(model: CycleGanTurbo, guides: Any = None, direction: str = "a2b") -> Any:
    with torch.no_grad():
        return model.translate(PICTURES, guides, direction)


def _saved(state: Any, path: Path) -> Path:
    torch.save(state, path)
    return path


def test_a_published_checkpoint_computes_what_peft_computes(tmp_path: Path) -> None:
    trained = trained_model()
    file = _saved(published(trained), tmp_path / "clear2rainy.pkl")
    merged = untrained()
    plain = _out(merged)
    load_weights(merged, file)
    for direction in ("a2b", "b2a"):
        torch.testing.assert_close(_out(merged, None, direction), _out(trained, None, direction), atol=2e-4, rtol=0)
    assert (_out(merged) - plain).abs().mean() > 0.05


def test_a_published_checkpoint_goes_into_adapters_to_be_trained_on(tmp_path: Path) -> None:
    trained = trained_model()
    model = to_train()
    load_weights(model, _saved(published(trained), tmp_path / "clear2rainy.pkl"))
    assert torch.equal(_out(model), _out(trained))


def test_a_published_checkpoint_does_the_same_with_a_fourth_channel_that_it_lacks(tmp_path: Path) -> None:
    file = _saved(published(trained_model()), tmp_path / "clear2rainy.pkl")
    narrow, wide = untrained(), untrained(normals=True)
    load_weights(narrow, file)
    load_weights(wide, file)
    assert torch.equal(_out(narrow), _out(wide, GUIDES))


@pytest.mark.parametrize(
    ("part", "key"),
    [
        ("sd_encoder", "conv_in.lora_A.weight"),
        ("sd_other", "mid_block.resnets.0.conv1.lora_B.weight"),
        ("sd_vae_enc", "vae.encoder.conv_in.base_layer.weight"),
        ("sd_vae_dec", "vae_b2a.decoder.skip_conv_1.lora_A.vae_skip.weight"),
    ],
)
def test_one_changed_key_is_refused_by_name(tmp_path: Path, part: str, key: str) -> None:
    state = published(trained_model())
    state[part][f"{key}x"] = state[part].pop(key)
    model = untrained()
    before = _out(model)
    with pytest.raises(ValueError, match=rf"changed\.pkl: {part}: '{key}' is missing, and '{key}x' is unknown"):
        load_weights(model, _saved(state, tmp_path / "changed.pkl"))
    assert torch.equal(_out(model), before)


def test_missing_parts_and_other_shapes_are_refused_by_name(tmp_path: Path) -> None:
    model = untrained()
    state = published(trained_model())
    del state["sd_other"]
    with pytest.raises(ValueError, match="'sd_other' is missing"):
        load_weights(model, _saved(state, tmp_path / "a.pkl"))
    state = published(trained_model()) | {"sd_more": {"weight": torch.zeros(2)}}
    with pytest.raises(ValueError, match="'sd_more' is unknown"):
        load_weights(model, _saved(state, tmp_path / "b.pkl"))
    state = published(trained_model())
    state["sd_decoder"] = {name: each[..., :1] for name, each in state["sd_decoder"].items()}
    with pytest.raises(ValueError, match="'unet.up_blocks"):
        load_weights(model, _saved(state, tmp_path / "c.pkl"))
    state = published(trained_model())
    state["l_modules_others"] = [*state["l_modules_others"], "mid_block.none"]
    state["sd_other"] |= {f"mid_block.none.lora_{f}.weight": torch.zeros(6, 6) for f in "AB"}
    with pytest.raises(ValueError, match="'unet.mid_block.none' is no layer"):
        load_weights(model, _saved(state, tmp_path / "d.pkl"))
    load_weights(model, _saved(published(trained_model()), tmp_path / "e.pkl"))
    with pytest.raises(ValueError, match="the model has weights from .*e.pkl already"):
        load_weights(model, tmp_path / "e.pkl")


def test_files_that_are_no_weights(tmp_path: Path) -> None:
    model = untrained()
    with pytest.raises(FileNotFoundError, match="none.pkl"):
        load_weights(model, tmp_path / "none.pkl")
    (tmp_path / "text.pkl").write_text("hello")
    with pytest.raises(ValueError, match="text.pkl: not a readable file of torch weights"):
        load_weights(model, tmp_path / "text.pkl")
    (tmp_path / "text.safetensors").write_text("hello")
    with pytest.raises(ValueError, match="text.safetensors: not a readable"):
        load_weights(model, tmp_path / "text.safetensors")
    with pytest.raises(ValueError, match="list, not weights by name"):
        load_weights(model, _saved([1], tmp_path / "list.pkl"))
    with pytest.raises(ValueError, match="neither img2img-turbo's.*has 'a'"):
        load_weights(model, _saved({"a": torch.zeros(1)}, tmp_path / "other.pkl"))


class _Runs:
    """Makes a file when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.file,)


def test_code_in_a_file_does_not_run(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not a readable file of torch weights"):
        open_weights(_saved({"rank_unet": _Runs(tmp_path / "made")}, tmp_path / "evil.pkl"))
    assert not (tmp_path / "made").exists()


def test_weatheredit_has_several_weathers_and_a_fourth_channel_of_its_own(tmp_path: Path) -> None:
    rainy, snowy = with_mask_channel(), trained_model(normals=True, seed=7)
    file = _saved(weatheredit(rainy, snowy), tmp_path / "with_seg.pkl")
    model = untrained(normals=True)
    load_weights(model, file)
    assert model.guide == "mask"
    assert model.texts[0] == "Picture of a rainy weather scene"
    torch.testing.assert_close(_out(model, GUIDES), _out(rainy, GUIDES), atol=2e-4, rtol=0)
    assert (_out(model, GUIDES) - _out(model)).abs().mean() > 1e-3
    opened, plain = open_weights(file), pristine(normals=True)
    layer = "unet.mid_block.resnets.0.conv1"
    for weather, trained in (("rainy", rainy), ("snowy", snowy)):
        mine = opened.delta(plain, weather).additions[layer]
        theirs = trained.unet.mid_block.resnets[0].conv1.lora_A["default_others"].weight
        assert torch.equal(mine.down, theirs)
    with pytest.raises(ValueError, match="holds rainy, snowy, not 'foggy'"):
        opened.delta(plain, "foggy")
    with pytest.raises(ValueError, match="made with a fourth channel, which this model lacks"):
        apply_adapter_weights(pristine(), opened.delta(pristine()))


def test_our_own_file_gives_the_same_bytes_back(tmp_path: Path) -> None:
    trained = deepcopy(trained_model(normals=True))
    trained_first_convolutions(trained)
    trained.set_captions(torch.ones(1, 77, 16), -torch.ones(1, 77, 16))
    file = tmp_path / "own.safetensors"
    save_weights(trained, file)
    again = to_train(normals=True)
    load_weights(again, file)
    merged = untrained(normals=True)
    load_weights(merged, file)
    for direction in ("a2b", "b2a"):
        assert torch.equal(_out(again, GUIDES, direction), _out(trained, GUIDES, direction))
        torch.testing.assert_close(_out(merged, GUIDES, direction), _out(trained, GUIDES, direction), atol=2e-4, rtol=0)
    assert merged.guide == "normals"
    save_weights(merged, tmp_path / "again.safetensors")
    first, second = open_weights(file).state, open_weights(tmp_path / "again.safetensors").state
    assert all(torch.equal(each, first[name]) for name, each in second.items())
    assert {name for name in first if name not in second} == {
        f"{part}.conv_in.bias" for part in ("unet", "vae.encoder", "vae_b2a.encoder")
    }  # which nothing has moved


def test_a_published_checkpoint_can_be_kept_as_our_own_file(tmp_path: Path) -> None:
    model = untrained()
    load_weights(model, _saved(published(trained_model()), tmp_path / "clear2rainy.pkl"))
    save_weights(model, tmp_path / "own.safetensors")
    assert (tmp_path / "own.safetensors").stat().st_size < (tmp_path / "clear2rainy.pkl").stat().st_size
    again = untrained()
    load_weights(again, tmp_path / "own.safetensors")
    assert torch.equal(_out(again), _out(model))


def test_our_own_file_is_read_strictly(tmp_path: Path) -> None:
    from safetensors import safe_open
    from safetensors.torch import save_file

    save_weights(trained_model(), tmp_path / "own.safetensors")
    with safe_open(tmp_path / "own.safetensors", "pt") as file:
        names, header = list(file.keys()), file.metadata()
        tensors = {name: file.get_tensor(name) for name in names}
    bad = tmp_path / "bad.safetensors"

    def refused(match: str, changed: dict[str, Any], **fields: str) -> None:
        save_file(changed, bad, metadata=header | fields)
        with pytest.raises(ValueError, match=match):
            load_weights(pristine(), bad)

    some = "vae.decoder.skip_conv_2.weight"
    refused(f"'{some}' is missing", {name: each for name, each in tensors.items() if name != some})
    refused("'more' is unknown", tensors | {"more": torch.zeros(1)})
    refused("version 9", tensors, version="9")
    refused("unknown architecture 'huge'", tensors, architecture="huge")
    refused("made for sd-turbo, not for tiny", tensors, architecture="sd-turbo")
    refused("another base", tensors | {"base.unet.conv_out.bias": torch.ones(4)})
    save_file(tensors, bad, metadata={"format": header["format"]})
    with pytest.raises(ValueError, match="'version' is missing from its header"):
        open_weights(bad)


def test_there_must_be_something_to_save(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nothing to save"):
        save_weights(untrained(normals=True), tmp_path / "own.safetensors")
    with pytest.raises(ValueError, match="written as .safetensors"):
        save_weights(untrained(normals=True), tmp_path / "own.pkl")
    assert list(tmp_path.iterdir()) == []


def _lora_tensors() -> dict[str, Any]:
    random = torch.Generator().manual_seed(3)
    unet = pristine().unet
    tensors: dict[str, Any] = {}
    for name in ("mid_block.attentions.0.transformer_blocks.0.attn1.to_q", "up_blocks.3.resnets.0.conv1"):
        weight = unet.get_parameter(f"{name}.weight")
        up_shape = (weight.shape[0], 2) + ((1, 1) if weight.ndim == 4 else ())
        tensors[f"unet.{name}.lora_A.weight"] = torch.randn((2, *weight.shape[1:]), generator=random)
        tensors[f"unet.{name}.lora_B.weight"] = torch.randn(up_shape, generator=random)
    return tensors


def test_a_diffusers_lora_is_merged_as_diffusers_does(tmp_path: Path) -> None:
    from safetensors.torch import save_file

    tensors = _lora_tensors()
    save_file(tensors, tmp_path / "pytorch_lora_weights.safetensors")
    model, theirs = untrained(), untrained()
    load_weights(model, tmp_path / "pytorch_lora_weights.safetensors")
    theirs.unet.load_lora_adapter(tensors, prefix="unet")
    torch.testing.assert_close(_out(model), _out(theirs), atol=2e-4, rtol=0)
    assert (_out(model) - _out(pristine())).abs().mean() > 1e-3


def test_names_and_scales_of_lora_files(tmp_path: Path) -> None:
    from safetensors.torch import save_file

    tensors = _lora_tensors()

    def loaded(changed: dict[str, Any], metadata: dict[str, str] | None = None) -> Any:
        save_file(changed, tmp_path / "lora.safetensors", metadata=metadata)
        model = untrained()
        load_weights(model, tmp_path / "lora.safetensors")
        return _out(model)

    plain = loaded(tensors)
    older = {n.replace("lora_A", "lora.down").replace("lora_B", "lora.up"): each for n, each in tensors.items()}
    assert torch.equal(loaded(older), plain)

    def kohya(name: str) -> str:
        layer, factor = name.removeprefix("unet.").split(".lora_")
        kind = "lora_down" if factor.startswith("A") else "lora_up"
        return f"lora_unet_{layer.replace('.', '_')}.{kind}.weight"

    flat = {kohya(name): each[..., None, None] if each.ndim == 2 else each for name, each in tensors.items()}
    assert torch.equal(loaded(flat), plain)
    layers = {name.split(".lora_")[0] for name in flat}
    half = loaded(flat | {f"{layer}.alpha": torch.tensor(1.0) for layer in layers})
    assert not torch.equal(half, plain)
    settings = '{"unet.r": 2, "unet.lora_alpha": 1}'
    assert torch.equal(loaded(tensors, {"lora_adapter_metadata": settings}), half)
    with pytest.raises(ValueError, match="'text_encoder.a.lora_A.weight' is no addition"):
        loaded(tensors | {"text_encoder.a.lora_A.weight": torch.zeros(1)})
    one = next(name for name in tensors if "lora_B" in name)
    with pytest.raises(ValueError, match="lacks its factor 'up'"):
        loaded({name: each for name, each in tensors.items() if name != one})
