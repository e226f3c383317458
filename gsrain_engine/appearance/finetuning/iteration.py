"""One iteration of CycleGAN-Turbo's training (Parmar et al. 2024; Zhu et al. 2017), and what it leaves behind."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

from .discriminator import Discriminator
from .losses import Perceptual, adversarial, difference
from .optimizer import NamedOptimizer, held_still
from .picture_order import Pair, PictureOrder
from .settings import FinetuningSettings
from .trained_parameters import restore, state_of, trained_parameters

torch: Any = import_module("torch")

Tensor = Any
Direction = Literal["a2b", "b2a"]
"""a is clear, b is rainy."""

_GENERATOR, _DISCRIMINATORS = "generator", "discriminators"


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """What an iteration did."""

    losses: dict[str, float]
    """Weighted losses by name, and "change": mean |a2b(clear) - clear| as a share of the range of values."""
    clear: Tensor
    translated: Tensor
    """(1, 3, h, w) of values -1..1, both."""


class Training:
    """What a training changes, and how: the generator's three steps of an iteration, then the discriminators' two.

    As in the published code the cycle, the adversarial and the identity loss each get a step of their own, with moments
    in common: one graph of one direction is in memory at a time. In a cycle the guide of a picture serves both ways:
    rain changes looks, not surfaces. The discriminators only see colours.
    """

    def __init__(
        self,
        model: Any,
        discriminators: tuple[Discriminator, Discriminator],
        order: PictureOrder,
        settings: FinetuningSettings,
        perceptual: Perceptual | None = None,
    ) -> None:
        """Take a model with LoRA layers, what tells rainy from made rainy, what tells clear from made clear."""
        self.model, self.order = model, order
        self.rainy_judge, self.clear_judge = discriminators
        self._settings, self._perceptual = settings, perceptual
        optimizer = settings.optimizer
        self._generator = NamedOptimizer(optimizer, optimizer.rate, *trained_parameters(model))
        own = {
            f"{kind}.{name}": parameter
            for kind, judge in (("rainy", self.rainy_judge), ("clear", self.clear_judge))
            for name, parameter in judge.named_parameters()
        }
        rate = optimizer.rate if optimizer.discriminator_rate is None else optimizer.discriminator_rate
        self._judges = NamedOptimizer(optimizer, rate, own)
        if settings.gradient_checkpointing:
            for part in (model.unet, model.vae, model.vae_b2a):
                part.enable_gradient_checkpointing()

    def iterate(self, number: int) -> Done:
        """Learn from one pair of pictures. Raises `DivergedError` where a gradient is no number any more."""
        pair, random = self.order.pair(number), self.order.generator(number)
        held_still((self.rainy_judge, self.clear_judge), True)
        losses = self._learn_cycles(pair, number)
        deceived, made_rainy, made_clear = self._learn_to_deceive(pair, number, random)
        losses |= deceived | self._learn_identity(pair, number)
        held_still((self.rainy_judge, self.clear_judge), False)
        losses |= self._learn_to_judge(pair, made_rainy, made_clear, number, random)
        losses["change"] = float((made_rainy - pair.clear).abs().mean()) / 2
        return Done(losses, pair.clear, made_rainy)

    def translated(self, pictures: Tensor, guides: Tensor | None, direction: Direction) -> Tensor:
        """Translate without learning."""
        with torch.no_grad(), self._precision():
            return self.model.translate(pictures, guides, direction).float()

    def state(self) -> dict[str, Any]:
        """Return everything that the training goes on from, as tensors by name."""
        arrays = _under(f"{_GENERATOR}:weights", state_of(self._generator.parameters))
        arrays |= _under(f"{_GENERATOR}:moments", self._generator.state())
        arrays |= _under(f"{_DISCRIMINATORS}:moments", self._judges.state())
        for kind, judge in (("rainy", self.rainy_judge), ("clear", self.clear_judge)):
            weights = {name: tensor.detach().cpu().clone() for name, tensor in judge.state_dict().items()}
            arrays |= _under(f"{_DISCRIMINATORS}:{kind}", weights)
        return arrays

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Go back to what `state` returned; raises KeyError or RuntimeError where something is missing or odd."""
        restore(self._generator.parameters, _of(arrays, f"{_GENERATOR}:weights"))
        self._generator.restore(_of(arrays, f"{_GENERATOR}:moments"))
        self._judges.restore(_of(arrays, f"{_DISCRIMINATORS}:moments"))
        self.rainy_judge.load_state_dict(_of(arrays, f"{_DISCRIMINATORS}:rainy"))
        self.clear_judge.load_state_dict(_of(arrays, f"{_DISCRIMINATORS}:clear"))

    def _learn_cycles(self, pair: Pair, number: int) -> dict[str, float]:
        weights = self._settings.losses
        losses: dict[str, float] = {}
        for name, picture, guide, way in (
            ("cycle_clear", pair.clear, pair.clear_guide, ("a2b", "b2a")),
            ("cycle_rainy", pair.rainy, pair.rainy_guide, ("b2a", "a2b")),
        ):
            there = self._translate(picture, guide, way[0])
            back = self._translate(there, guide, way[1])
            loss = difference(back, picture, weights.cycle, weights.cycle_lpips, self._perceptual)
            losses[name] = _learn_from(loss)
        self._generator.step(number)
        return losses

    def _learn_to_deceive(self, pair: Pair, number: int, random: Any) -> tuple[dict[str, float], Tensor, Tensor]:
        losses: dict[str, float] = {}
        made: list[Tensor] = []
        for name, judge, picture, guide, direction in (
            ("gan_rainy", self.rainy_judge, pair.clear, pair.clear_guide, "a2b"),
            ("gan_clear", self.clear_judge, pair.rainy, pair.rainy_guide, "b2a"),
        ):
            made.append(self._translate(picture, guide, direction))
            loss = adversarial(judge(made[-1], random), real=True) * self._settings.losses.gan
            losses[name] = _learn_from(loss)
        self._generator.step(number)
        return losses, made[0].detach(), made[1].detach()

    def _learn_identity(self, pair: Pair, number: int) -> dict[str, float]:
        """A rainy picture made rainy, and a clear one made clear, stay as they are."""
        weights = self._settings.losses
        losses: dict[str, float] = {}
        for name, picture, guide, direction in (
            ("identity_rainy", pair.rainy, pair.rainy_guide, "a2b"),
            ("identity_clear", pair.clear, pair.clear_guide, "b2a"),
        ):
            same = self._translate(picture, guide, direction)
            loss = difference(same, picture, weights.identity, weights.identity_lpips, self._perceptual)
            losses[name] = _learn_from(loss)
        self._generator.step(number)
        return losses

    def _learn_to_judge(
        self, pair: Pair, made_rainy: Tensor, made_clear: Tensor, number: int, random: Any
    ) -> dict[str, float]:
        losses: dict[str, float] = {}
        self._judges.begin()
        for kind, real, rainy, clear in (
            ("made", False, made_rainy, made_clear),
            ("real", True, pair.rainy, pair.clear),
        ):
            for look, judge, picture in (("rainy", self.rainy_judge, rainy), ("clear", self.clear_judge, clear)):
                # Half each: the mean over the two discriminators, as in the published code.
                loss = adversarial(judge(picture, random), real) * (0.5 * self._settings.losses.gan)
                losses[f"judge_{look}_{kind}"] = _learn_from(loss)
            self._judges.step(number)
        return losses

    def _translate(self, pictures: Tensor, guides: Tensor | None, direction: str) -> Tensor:
        with self._precision():
            translated = self.model.translate(pictures, guides, direction)
        return translated.float()

    def _precision(self) -> AbstractContextManager[Any]:
        if self._settings.precision == "float32":
            return nullcontext()
        device = next(iter(self._generator.parameters.values())).device.type
        return torch.autocast(device, torch.bfloat16)


def _learn_from(loss: Tensor) -> float:
    """Leave the gradients of a loss where they belong, and free its graph."""
    loss.backward()
    return float(loss.detach())


def _under(kind: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{kind}:{name}": array for name, array in arrays.items()}


def _of(arrays: Mapping[str, Any], kind: str) -> dict[str, Any]:
    prefix = f"{kind}:"
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
