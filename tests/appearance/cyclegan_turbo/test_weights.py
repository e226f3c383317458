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
from gsrain_engine.appearance.cyclegan_turbo.weights import open_weights, save_weights  # noqa: E402

from .published_checkpoints import (  # noqa: E402
    load_weights,
    noise,
    out,
    pristine,
    published,
    to_train,
    trained_model,
    untrained,
    weatheredit,
    with_mask_channel,
)

PICTURES, GUIDES = noise(5, 1, 3, 32, 40), noise(6, 1, 1, 32, 40)


def _saved(state: Any, path: Path) -> Path:
    torch.save(state, path)
    return path


def _loaded(model: CycleGanTurbo, path: Path) -> CycleGanTurbo:
    load_weights(model, path)
    return model


def test_a_published_checkpoint_computes_what_peft_computes_merged_in_adapters_and_as_our_own_file(
    tmp_path: Path,
) -> None:
    trained = trained_model()
    file, own = _saved(published(trained), tmp_path / "clear2rainy.pkl"), tmp_path / "own.safetensors"
    merged, wide, adapted = (_loaded(each, file) for each in (untrained(), untrained(normals=True), to_train()))
    for direction in ("a2b", "b2a"):
        made, expected = (out(each, PICTURES, None, direction) for each in (merged, trained))
        torch.testing.assert_close(made, expected, atol=2e-4, rtol=0)
        assert (made - out(pristine(), PICTURES, None, direction)).abs().mean() > 0.01
    assert torch.equal(out(merged, PICTURES), out(wide, PICTURES, GUIDES))  # a channel that it lacks changes nothing
    assert torch.equal(out(adapted, PICTURES), out(trained, PICTURES))
    save_weights(merged, own)
    assert own.stat().st_size < file.stat().st_size
    assert torch.equal(out(_loaded(untrained(), own), PICTURES), out(merged, PICTURES))
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


def test_a_changed_checkpoint_is_refused_by_name_and_changes_nothing(tmp_path: Path) -> None:
    checkpoint, model = published(trained_model()), untrained()
    for change, name in (
        (_renamed("sd_other", "mid_block.resnets.0.conv1.lora_B.weight"), "sd_other.*conv1"),
        (_renamed("sd_vae_dec", "vae_b2a.decoder.skip_conv_1.lora_A.vae_skip.weight"), "sd_vae_dec.*skip_conv_1"),
        (lambda state: state.pop("sd_other"), "'sd_other'"),
        (lambda state: state.update(sd_more={"weight": torch.zeros(2)}), "'sd_more'"),
        (lambda state: state.update(rank_unet=7), "rank_unet"),
        (_cut, "'unet.up_blocks"),
        (_one_more_layer, "'unet.mid_block.none'"),
    ):
        state = {key: dict(each) if isinstance(each, dict) else each for key, each in checkpoint.items()}
        change(state)
        with pytest.raises(ValueError, match=rf"changed\.pkl.*{name}"):
            load_weights(model, _saved(state, tmp_path / "changed.pkl"))
    assert torch.equal(out(model, PICTURES), out(pristine(), PICTURES))


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
    contents = {"list": [1], "other": {"a": torch.zeros(1)}, "evil": {"rank_unet": _Runs(tmp_path / "made")}}
    contents |= {"number": {"sd_vae_enc": 3, "rank_unet": 4}}
    files = [_saved(content, tmp_path / f"{name}.pkl") for name, content in contents.items()]
    for file in [*files, tmp_path / "text.pkl", tmp_path / "text.safetensors"]:
        with pytest.raises(ValueError, match=file.name):
            open_weights(file).delta(pristine())
    assert not (tmp_path / "made").exists()


def test_weatheredits_rain_and_its_fourth_channel_are_read(tmp_path: Path) -> None:
    rainy, snowy = with_mask_channel(), trained_model(normals=True, seed=7)
    state = weatheredit(rainy, snowy)
    file = _saved(state, tmp_path / "with_seg.pkl")
    model = _loaded(untrained(normals=True), file)
    assert (model.guide, model.texts[0]) == ("mask", "Picture of a rainy weather scene")
    torch.testing.assert_close(out(model, PICTURES, GUIDES), out(rainy, PICTURES, GUIDES), atol=2e-4, rtol=0)
    assert (out(model, PICTURES, GUIDES) - out(model, PICTURES)).abs().mean() > 1e-3
    with pytest.raises(ValueError, match="fourth channel"):
        load_weights(untrained(), file)
    without = {key: each for key, each in state.items() if not key.startswith("sd_rainy")}
    with pytest.raises(ValueError, match="sd_rainy_decoder"):
        load_weights(untrained(normals=True), _saved(without, tmp_path / "snowy.pkl"))


def test_our_own_file_gives_the_same_weights_and_bytes_back(tmp_path: Path) -> None:
    trained, moved = deepcopy(trained_model(normals=True)), torch.Generator().manual_seed(9)
    with torch.no_grad():  # the first convolutions, which img2img-turbo's checkpoints lose
        for part in (trained.unet.conv_in, trained.vae.encoder.conv_in, trained.vae_b2a.encoder.conv_in):
            part.base_layer.weight += 0.1 * torch.randn(part.base_layer.weight.shape, generator=moved)
    trained.set_captions(torch.ones(1, 77, 16), -torch.ones(1, 77, 16))
    file, again = tmp_path / "own.safetensors", tmp_path / "again.safetensors"
    save_weights(trained, file)
    adapted, merged = _loaded(to_train(normals=True), file), _loaded(untrained(normals=True), file)
    for direction in ("a2b", "b2a"):
        expected = out(trained, PICTURES, GUIDES, direction)
        assert torch.equal(out(adapted, PICTURES, GUIDES, direction), expected)
        torch.testing.assert_close(out(merged, PICTURES, GUIDES, direction), expected, atol=2e-4, rtol=0)
    assert merged.guide == "normals"
    save_weights(adapted, again)
    assert again.read_bytes() == file.read_bytes()
    save_weights(merged, again)
    first, second = open_weights(file).state, open_weights(again).state
    assert all(torch.equal(each, first[name]) for name, each in second.items())
    # What nothing has moved is not written from merged weights.
    assert first.keys() - second.keys() == {
        f"{part}.conv_in.bias" for part in ("unet", "vae.encoder", "vae_b2a.encoder")
    }


def test_our_own_file_is_read_strictly(tmp_path: Path) -> None:
    save_weights(trained_model(), tmp_path / "own.safetensors")
    with safe_open(tmp_path / "own.safetensors", "pt") as file:
        header, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    some, bad = "vae.decoder.skip_conv_2.weight", tmp_path / "bad.safetensors"
    for match, changed, fields in (
        (some, {name: each for name, each in tensors.items() if name != some}, {}),
        ("more", tensors | {"more": torch.zeros(1)}, {}),
        ("version 9", tensors, {"version": "9"}),
        ("'huge'", tensors, {"architecture": "huge"}),
        ("random_base_seed", tensors, {"random_base_seed": "x"}),
        ("sd-turbo, not for tiny", tensors, {"architecture": "sd-turbo"}),
        ("another base", tensors | {"base.unet.conv_out.bias": torch.ones(4)}, {}),
        ("unet.conv_out.bias", tensors | {"base.unet.conv_out.bias": torch.ones(5)}, {}),
    ):
        save_file(changed, bad, metadata=header | fields)
        with pytest.raises(ValueError, match=match):
            load_weights(pristine(), bad)
    save_file(tensors, bad, metadata={"format": header["format"]})
    with pytest.raises(ValueError, match="'version'"):
        open_weights(bad)
    for name in ("empty.safetensors", "own.pkl"):
        with pytest.raises(ValueError, match=r"nothing to save|own\.pkl"):
            save_weights(untrained(normals=True), tmp_path / name)
        assert not (tmp_path / name).exists()


def test_loras_of_diffusers_peft_and_kohya_are_merged_as_diffusers_does(tmp_path: Path) -> None:
    tensors: dict[str, Any] = {}
    for name in ("mid_block.attentions.0.transformer_blocks.0.attn1.to_q", "up_blocks.3.resnets.0.conv1"):
        shape = pristine().unet.get_parameter(f"{name}.weight").shape
        tensors[f"unet.{name}.lora_A.weight"] = noise(3, 2, *shape[1:])
        tensors[f"unet.{name}.lora_B.weight"] = noise(4, shape[0], 2, *(1, 1)[: len(shape) - 2])

    def loaded(changed: dict[str, Any], metadata: dict[str, str] | None = None) -> Any:
        save_file(changed, tmp_path / "lora.safetensors", metadata=metadata)
        return out(_loaded(untrained(), tmp_path / "lora.safetensors"), PICTURES)

    def kohya(name: str) -> str:
        layer, factor = name.removeprefix("unet.").split(".lora_")
        return f"lora_unet_{layer.replace('.', '_')}.{'lora_down' if factor[0] == 'A' else 'lora_up'}.weight"

    theirs = untrained()
    theirs.unet.load_lora_adapter(dict(tensors), prefix="unet")
    plain = loaded(tensors)
    torch.testing.assert_close(plain, out(theirs, PICTURES), atol=2e-4, rtol=0)
    assert (plain - out(pristine(), PICTURES)).abs().mean() > 1e-3
    older = {n.replace("lora_A", "lora.down").replace("lora_B", "lora.up"): each for n, each in tensors.items()}
    flat = {kohya(name): each[..., None, None] if each.ndim == 2 else each for name, each in tensors.items()}
    assert all(torch.equal(loaded(each), plain) for each in (older, flat))
    half = loaded(flat | {f"{name.split('.lora_')[0]}.alpha": torch.tensor(1.0) for name in flat})
    assert not torch.equal(half, plain)
    assert torch.equal(loaded(tensors, {"lora_adapter_metadata": '{"unet.r": 2, "unet.lora_alpha": 1}'}), half)
    for changed, metadata, name in (
        (tensors | {"text_encoder.a.lora_A.weight": torch.zeros(1)}, None, r"text_encoder\.a"),
        ({n: each for n, each in tensors.items() if "conv1.lora_B" not in n}, None, "conv1.*'up'"),
        (tensors, {"lora_adapter_metadata": "{"}, "lora_adapter_metadata"),
    ):
        with pytest.raises(ValueError, match=name):
            loaded(changed, metadata)
