"""An iteration: who learns from what, what is held, and what a checkpoint of it holds."""

from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.appearance.finetune.settings import OptimizerSettings  # noqa: E402
from gsrain_engine.appearance.finetune.step import (  # noqa: E402
    DivergedError,
    NamedOptimizer,
    adversarial,
    difference,
    trained_parameters,
)

from .small_training import small_settings, small_start  # noqa: E402


def _changed(before: dict[str, object], after: dict[str, object]) -> set[str]:
    return {name for name in before if not torch.equal(before[name], after[name])}


def _weights(model: object) -> dict[str, object]:
    return {name: each.detach().clone() for name, each in model.named_parameters()}


@pytest.mark.usefixtures("small_networks")
def test_only_what_is_learned_moves(tmp_path: Path) -> None:
    training = small_start(small_settings(tmp_path))
    before = _weights(training.model)
    judged = _weights(training.rainy_judge)
    seen = {name: each.clone() for name, each in training.rainy_judge._features[0].state_dict().items()}
    training.iterate(0)
    moved = _changed(before, _weights(training.model))

    learned = {name for group in trained_parameters(training.model) for name in group}
    assert moved <= learned
    assert {name for name in learned if "lora_" not in name} - moved == {
        # No picture has a guide here, so nothing comes through its columns.
        f"{vae}.encoder.conv_in.base_layer.weight"
        for vae in ("vae", "vae_b2a")
    }
    assert "unet.conv_in.base_layer.weight" in moved
    assert any("skip_conv_1.base_layer" in name for name in moved)
    assert _changed(judged, _weights(training.rainy_judge)) == set(judged)
    assert not _changed(seen, training.rainy_judge._features[0].state_dict())


@pytest.mark.usefixtures("small_networks")
def test_the_columns_of_the_colours_keep_every_bit(tmp_path: Path) -> None:
    training = small_start(small_settings(tmp_path))
    model = training.model
    decaying, held = trained_parameters(model)
    optimizer = NamedOptimizer(OptimizerSettings(weight_decay=0.5), 1e-2, decaying, held)
    weight = model.vae.encoder.conv_in.base_layer.weight
    before = weight.detach().clone()
    clear, _ = training.order.read(training.order.pictures.source[0])
    made = model.translate(clear, torch.ones_like(clear[:, :1]), "a2b")
    made.square().mean().backward()
    optimizer.step(0)
    assert torch.equal(weight[:, :3], before[:, :3])
    assert not before[:, 3].any() and weight[:, 3].all()


@pytest.mark.usefixtures("small_networks")
def test_a_state_brings_everything_back(tmp_path: Path) -> None:
    settings = small_settings(tmp_path)
    first = small_start(settings)
    first.iterate(0)
    second = small_start(small_settings(tmp_path, seed=5))
    second.restore(first.state())
    second.order = first.order
    own, theirs = first.state(), second.state()
    assert set(own) == set(theirs) and not _changed(own, theirs)
    missing = {name: each for name, each in own.items() if not name.endswith("conv_in.base_layer.weight")}
    with pytest.raises(KeyError, match="conv_in"):
        second.restore(missing)


def test_a_model_without_adapters_is_refused() -> None:
    with pytest.raises(ValueError, match="no LoRA"):
        trained_parameters(torch.nn.Linear(2, 2))


def test_the_rate_follows_from_the_iteration() -> None:
    """However many steps an iteration takes; the first step of Adam is as long as the rate."""
    for iteration, share in ((0, 0.25), (2, 0.75), (9, 1.0)):
        number = torch.nn.Parameter(torch.zeros(1))
        optimizer = NamedOptimizer(OptimizerSettings(warmup_steps=4, weight_decay=0), 0.1, {"number": number})
        number.grad = torch.ones(1)
        optimizer.step(iteration)
        assert number.item() == pytest.approx(-0.1 * share, rel=1e-5)


def test_gradients_are_clipped_and_their_length_is_told() -> None:
    number = torch.nn.Parameter(torch.zeros(2))
    optimizer = NamedOptimizer(OptimizerSettings(), 1e-3, {"number": number})
    number.grad = torch.tensor([30.0, 40.0])
    assert optimizer.step(0) == pytest.approx(50)
    assert float(optimizer.state()["exp_avg:number"].norm()) == pytest.approx(1.0, rel=1e-4)  # 10 (1 - beta_1)
    number.grad = torch.tensor([float("nan"), 0.0])
    before = number.detach().clone()
    with pytest.raises(DivergedError, match="iteration 2"):
        optimizer.step(1)
    assert torch.equal(number, before)


def test_adversarial_losses_are_cross_entropies() -> None:
    logits = [torch.randn(2, 1, 3, 3, generator=torch.Generator().manual_seed(1)), torch.tensor([[2.0], [-1.0]])]
    for real in (True, False):
        each = [torch.nn.functional.binary_cross_entropy_with_logits(x, torch.full_like(x, real)) for x in logits]
        assert float(adversarial(logits, real)) == pytest.approx(float(sum(each)))


def test_a_difference_is_weighted() -> None:
    shown, truth = torch.full((1, 3, 4, 4), 0.5), torch.zeros(1, 3, 4, 4)

    def perceptual(a: object, b: object) -> object:
        return (a - b).square().mean()

    assert float(difference(shown, truth, 2.0, 10.0, None)) == pytest.approx(1.0)
    assert float(difference(shown, truth, 2.0, 10.0, perceptual)) == pytest.approx(3.5)
