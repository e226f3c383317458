"""An iteration of fine-tuning: the order of images, losses, what learns from what, optimizer and discriminators."""

from dataclasses import replace
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

from gsrain_engine.appearance.finetune.dataset import open_images  # noqa: E402
from gsrain_engine.appearance.finetune.discriminator import ClipFeatures, area_resized  # noqa: E402
from gsrain_engine.appearance.finetune.settings import PLACE, OptimizerSettings  # noqa: E402
from gsrain_engine.appearance.finetune.step import (  # noqa: E402
    DivergedError,
    NamedOptimizer,
    PairSampler,
    adversarial,
    difference,
    fingerprint,
    trained_parameters,
)

from .small_training import small_settings, small_start  # noqa: E402


def test_each_epoch_has_all_pictures_in_a_new_order(tmp_path: Path) -> None:
    pictures = open_images(small_settings(tmp_path).pictures).train
    order, count = PairSampler(pictures, seed=3, guided=True, device="cpu"), len(pictures.source)
    means = [float(order.pair(i).clear.mean()) for i in range(3 * count)]
    turns = {tuple(means[i : i + count]) for i in range(0, len(means), count)}
    assert len(turns) > 1 and {frozenset(turn) for turn in turns} == {frozenset(means)} and len(set(means)) == count
    repeated = PairSampler(pictures, seed=3, guided=False, device="cpu").pair(count + 1)
    assert float(repeated.clear.mean()) == means[count + 1] and repeated.clear_guide is None

    pair = order.pair(0)
    assert pair.clear.shape == (1, 3, 16, 16) and -1 <= float(pair.clear.min()) < float(pair.clear.max()) <= 1
    assert pair.clear_guide is not None and not pair.clear_guide.any()
    assert fingerprint(replace(pictures, source=pictures.source[:-1])) != fingerprint(pictures)


_FIRST_LOSSES = {
    "cycle_clear": 0.4996, "cycle_rainy": 0.4361, "gan_rainy": 1.2336, "gan_clear": 0.9885, "identity_rainy": 0.3944,
    "identity_clear": 0.4785, "judge_rainy_made": 0.4498, "judge_clear_made": 0.6129, "judge_rainy_real": 0.6616,
    "judge_clear_real": 0.4216, "change": 0.2529,
}  # fmt: skip
"""Losses of earlier versions, augmentation and discriminators included."""


def _changed(before: dict[str, object], after: dict[str, object]) -> set[str]:
    return {name for name in before if not torch.equal(before[name], after[name])}


def _weights(model: object) -> dict[str, object]:
    return {name: each.detach().clone() for name, each in model.named_parameters()}


@pytest.mark.usefixtures("small_networks")
def test_only_what_is_learned_moves_and_checkpointing_changes_no_number(tmp_path: Path) -> None:
    training = small_start(small_settings(tmp_path))
    before, judged = _weights(training.model), _weights(training.rainy_judge)
    clip = training.rainy_judge.shared_features[0]
    frozen = {name: each.clone() for name, each in clip.state_dict().items()}
    losses = training.iterate(0).losses
    assert losses == pytest.approx(_FIRST_LOSSES, abs=2e-3)
    moved = _changed(before, _weights(training.model))
    learned = {name for group in trained_parameters(training.model) for name in group}
    assert moved <= learned
    assert {name for name in learned if "lora_" not in name} - moved == {
        # No picture has a guide here, so nothing comes through its columns.
        f"{vae}.encoder.conv_in.base_layer.weight"
        for vae in ("vae", "vae_b2a")
    }
    assert "unet.conv_in.base_layer.weight" in moved and any("skip_conv_1.base_layer" in name for name in moved)
    assert _changed(judged, _weights(training.rainy_judge)) == set(judged)
    assert not _changed(frozen, clip.state_dict())
    assert small_start(small_settings(tmp_path, gradient_checkpointing=True)).iterate(0).losses == losses


@pytest.mark.usefixtures("small_networks")
def test_the_guides_columns_are_learned_and_those_of_the_colors_keep_every_bit(tmp_path: Path) -> None:
    training = small_start(small_settings(tmp_path))
    model = training.model
    optimizer = NamedOptimizer(OptimizerSettings(weight_decay=0.5), 1e-2, *trained_parameters(model))
    weight = model.vae.encoder.conv_in.base_layer.weight
    before = weight.detach().clone()
    clear, _ = training.order.read(training.order.pictures.source[0])
    model.translate(clear, torch.ones_like(clear[:, :1]), "a2b").square().mean().backward()
    optimizer.step(0)
    assert torch.equal(weight[:, :3], before[:, :3])
    assert not before[:, 3].any() and weight[:, 3].all()
    with pytest.raises(ValueError, match="LoRA"):
        trained_parameters(torch.nn.Linear(2, 2))


@pytest.mark.usefixtures("small_networks")
def test_a_state_brings_everything_back(tmp_path: Path) -> None:
    first, second = small_start(small_settings(tmp_path)), small_start(small_settings(tmp_path, seed=5))
    first.iterate(0)
    own = first.state()
    second.restore(own)
    theirs = second.state()
    assert set(own) == set(theirs) and not _changed(own, theirs)
    with pytest.raises(KeyError, match="conv_in"):
        second.restore({name: each for name, each in own.items() if not name.endswith("conv_in.base_layer.weight")})


# Optimizer and losses


def test_the_rate_follows_from_the_iteration() -> None:
    """However many steps an iteration takes; the first step of Adam is as long as the rate."""
    for iteration, share in ((0, 0.25), (2, 0.75), (9, 1.0)):
        number = torch.nn.Parameter(torch.zeros(1))
        optimizer = NamedOptimizer(OptimizerSettings(warmup_steps=4, weight_decay=0), 0.1, {"number": number})
        number.grad = torch.ones(1)
        optimizer.step(iteration)
        assert number.item() == pytest.approx(-0.1 * share, rel=1e-5)


def test_gradients_are_clipped_and_a_diverged_training_changes_nothing() -> None:
    number = torch.nn.Parameter(torch.zeros(2))
    optimizer = NamedOptimizer(OptimizerSettings(), 1e-3, {"number": number})
    number.grad = torch.tensor([30.0, 40.0])
    optimizer.step(0)
    assert float(optimizer.state()["exp_avg:number"].norm()) == pytest.approx(1.0, rel=1e-4)  # 10 (1 - beta_1)
    number.grad = torch.tensor([float("nan"), 0.0])
    before = number.detach().clone()
    with pytest.raises(DivergedError, match="iteration 2"):
        optimizer.step(1)
    assert torch.equal(number, before)


def test_losses_are_cross_entropies_and_weighted_differences() -> None:
    logits = [torch.randn(2, 1, 3, 3, generator=torch.Generator().manual_seed(1)), torch.tensor([[2.0], [-1.0]])]
    for real in (True, False):
        each = [torch.nn.functional.binary_cross_entropy_with_logits(x, torch.full_like(x, real)) for x in logits]
        assert float(adversarial(logits, real)) == pytest.approx(float(sum(each)))
    found, truth = torch.full((1, 3, 4, 4), 0.5), torch.zeros(1, 3, 4, 4)
    assert float(difference(found, truth, 2.0, 10.0, None)) == pytest.approx(1.0)
    assert float(difference(found, truth, 2.0, 10.0, lambda a, b: (a - b).square().mean())) == pytest.approx(3.5)


# Discriminators


@pytest.mark.parametrize("size", [(40, 96), (7, 5), (32, 31)])
def test_areas_are_torchs_areas(size: tuple[int, int]) -> None:
    pictures = torch.rand(1, 2, *size, generator=torch.Generator().manual_seed(3))
    expected = torch.nn.functional.interpolate(pictures, (32, 32), mode="area")
    assert torch.allclose(area_resized(pictures, 32), expected, atol=1e-6)


def test_clip_is_read_from_a_folder_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = {"hidden_size": 16, "intermediate_size": 32, "num_attention_heads": 2}
    vision = sizes | {"num_hidden_layers": 6, "image_size": 32, "patch_size": 8, "projection_dim": 24}
    text = sizes | {"num_hidden_layers": 1, "vocab_size": 32}
    clip = transformers.CLIPModel(transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=24))
    clip.save_pretrained(tmp_path / "clip")
    read = ClipFeatures.read(tmp_path / "clip")
    assert (read.taps, read.map_channels, read.whole_channels) == ((2, 4), 16, 24)
    assert torch.equal(read.vision.visual_projection.weight, clip.visual_projection.weight)
    monkeypatch.setenv(PLACE, str(tmp_path / "clip"))
    assert ClipFeatures.read(None).taps == (2, 4)

    state = {name: each for name, each in clip.state_dict().items() if "visual_projection" not in name}
    clip.save_pretrained(tmp_path / "half", state_dict=state)
    with pytest.raises(ValueError, match=r"visual_projection\.weight"):
        ClipFeatures.read(tmp_path / "half")
    monkeypatch.setenv(PLACE, str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match=f"nowhere.*clip-vit-base-patch32.*{PLACE}"):
        ClipFeatures.read(None)
