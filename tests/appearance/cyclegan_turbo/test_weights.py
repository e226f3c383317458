"""Files of weights in every layout: what they compute, and what is refused by name."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("peft")

from safetensors import safe_open  # noqa: E402
from safetensors.torch import save_file  # noqa: E402

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


def test_a_published_checkpoint_computes_what_peft_computes_merged_in_adapters_and_as_our_own_file(
    tmp_path: Path,
) -> None:
    trained = trained_model()
    file, own = _saved(published(trained), tmp_path / "clear2rainy.pkl"), tmp_path / "own.safetensors"
    merged, wide, adapted, copied = untrained(), untrained(normals=True), to_train(), untrained()
    plain = _out(merged)
    for model in (merged, wide, adapted):
        load_weights(model, file)
    for direction in ("a2b", "b2a"):
        torch.testing.assert_close(_out(merged, None, direction), _out(trained, None, direction), atol=2e-4, rtol=0)
    assert (_out(merged) - plain).abs().mean() > 0.05
    assert torch.equal(_out(merged), _out(wide, GUIDES))  # a fourth channel that it lacks changes nothing
    assert torch.equal(_out(adapted), _out(trained))
    save_weights(merged, own)
    load_weights(copied, own)
    assert own.stat().st_size < file.stat().st_size and torch.equal(_out(copied), _out(merged))
    with pytest.raises(ValueError, match=r"clear2rainy\.pkl already"):
        load_weights(merged, file)


def _renamed(part: str, key: str):
    def change(state: dict[str, Any]) -> None:
        state[part][f"{key}x"] = state[part].pop(key)

    return change


def _cut(state: dict[str, Any]) -> None:
    state["sd_decoder"] = {name: each[..., :1] for name, each in state["sd_decoder"].items()}


def _one_more_layer(state: dict[str, Any]) -> None:
    state["l_modules_others"] = [*state["l_modules_others"], "mid_block.none"]
    state["sd_other"] |= {f"mid_block.none.lora_{f}.weight": torch.zeros(6, 6) for f in "AB"}


_KEYS = {
    "sd_encoder": "conv_in.lora_A.weight",
    "sd_other": "mid_block.resnets.0.conv1.lora_B.weight",
    "sd_vae_enc": "vae.encoder.conv_in.base_layer.weight",
    "sd_vae_dec": "vae_b2a.decoder.skip_conv_1.lora_A.vae_skip.weight",
}


@pytest.mark.parametrize(
    ("change", "name"),
    [
        *((_renamed(part, key), f"{part}: '{key}' is missing, and '{key}x'") for part, key in _KEYS.items()),
        (lambda state: state.pop("sd_other"), "'sd_other'"),
        (lambda state: state.update(sd_more={"weight": torch.zeros(2)}), "'sd_more'"),
        (_cut, "'unet.up_blocks"),
        (_one_more_layer, "'unet.mid_block.none'"),
    ],
)
def test_a_changed_checkpoint_is_refused_by_name_and_changes_nothing(tmp_path: Path, change: Any, name: str) -> None:
    state, model = published(trained_model()), untrained()
    before = _out(model)
    change(state)
    with pytest.raises(ValueError, match=rf"changed\.pkl.*{name}"):
        load_weights(model, _saved(state, tmp_path / "changed.pkl"))
    assert torch.equal(_out(model), before)


class _Runs:
    """Makes a file when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.file,)


def test_files_that_are_no_weights_are_refused_and_their_code_does_not_run(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="none.pkl"):
        open_weights(tmp_path / "none.pkl")
    for name in ("text.pkl", "text.safetensors"):
        (tmp_path / name).write_text("hello")
    _saved([1], tmp_path / "list.pkl")
    _saved({"a": torch.zeros(1)}, tmp_path / "other.pkl")
    _saved({"rank_unet": _Runs(tmp_path / "made")}, tmp_path / "evil.pkl")
    for name in ("text.pkl", "text.safetensors", "list.pkl", "other.pkl", "evil.pkl"):
        with pytest.raises(ValueError, match=name):
            open_weights(tmp_path / name).delta(pristine())
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


def test_our_own_file_is_read_strictly(tmp_path: Path) -> None:
    save_weights(trained_model(), tmp_path / "own.safetensors")
    with safe_open(tmp_path / "own.safetensors", "pt") as file:
        header, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    bad, some = tmp_path / "bad.safetensors", "vae.decoder.skip_conv_2.weight"
    for match, changed, fields in (
        (some, {name: each for name, each in tensors.items() if name != some}, {}),
        ("more", tensors | {"more": torch.zeros(1)}, {}),
        ("version 9", tensors, {"version": "9"}),
        ("architecture 'huge'", tensors, {"architecture": "huge"}),
        ("sd-turbo, not for tiny", tensors, {"architecture": "sd-turbo"}),
        ("another base", tensors | {"base.unet.conv_out.bias": torch.ones(4)}, {}),
    ):
        save_file(changed, bad, metadata=header | fields)
        with pytest.raises(ValueError, match=match):
            load_weights(pristine(), bad)
    save_file(tensors, bad, metadata={"format": header["format"]})
    with pytest.raises(ValueError, match="'version'"):
        open_weights(bad)
    for name, match in (("empty.safetensors", "nothing to save"), ("own.pkl", "safetensors")):
        with pytest.raises(ValueError, match=match):
            save_weights(untrained(normals=True), tmp_path / name)
        assert not (tmp_path / name).exists()


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


def test_loras_of_diffusers_peft_and_kohya_are_merged_as_diffusers_does(tmp_path: Path) -> None:
    tensors, theirs = _lora_tensors(), untrained()
    theirs.unet.load_lora_adapter(dict(tensors), prefix="unet")

    def loaded(changed: dict[str, Any], metadata: dict[str, str] | None = None) -> Any:
        save_file(changed, tmp_path / "lora.safetensors", metadata=metadata)
        model = untrained()
        load_weights(model, tmp_path / "lora.safetensors")
        return _out(model)

    def kohya(name: str) -> str:
        layer, factor = name.removeprefix("unet.").split(".lora_")
        kind = "lora_down" if factor.startswith("A") else "lora_up"
        return f"lora_unet_{layer.replace('.', '_')}.{kind}.weight"

    plain = loaded(tensors)
    torch.testing.assert_close(plain, _out(theirs), atol=2e-4, rtol=0)
    assert (plain - _out(pristine())).abs().mean() > 1e-3
    older = {n.replace("lora_A", "lora.down").replace("lora_B", "lora.up"): each for n, each in tensors.items()}
    flat = {kohya(name): each[..., None, None] if each.ndim == 2 else each for name, each in tensors.items()}
    assert torch.equal(loaded(older), plain) and torch.equal(loaded(flat), plain)
    layers = {name.split(".lora_")[0] for name in flat}
    half = loaded(flat | {f"{layer}.alpha": torch.tensor(1.0) for layer in layers})
    assert not torch.equal(half, plain)
    assert torch.equal(loaded(tensors, {"lora_adapter_metadata": '{"unet.r": 2, "unet.lora_alpha": 1}'}), half)
    with pytest.raises(ValueError, match=r"text_encoder\.a"):
        loaded(tensors | {"text_encoder.a.lora_A.weight": torch.zeros(1)})
    one = next(name for name in tensors if "lora_B" in name)
    with pytest.raises(ValueError, match="'up'"):
        loaded({name: each for name, each in tensors.items() if name != one})
