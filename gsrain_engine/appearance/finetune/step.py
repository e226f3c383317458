"""Training step of CycleGAN-Turbo (Parmar et al. 2024; Zhu et al. 2017): losses, trained parameters, optimizer."""

import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from ...training_run import arrays_of
from ..cyclegan_turbo.model import Direction
from .dataset import DatasetImage, UnpairedImages
from .discriminator import Discriminator
from .settings import FinetuningSettings, OptimizerSettings

torch: Any = import_module("torch")
Tensor = Any

_GENERATOR, _DISCRIMINATORS = "generator", "discriminators"


# Sampler of unpaired images


@dataclass(frozen=True, slots=True, eq=False)
class UnpairedSample:
    """Clear and rainy image of different places: batches of one, (1, 3, h, w) in -1..1; guides (1, 1, h, w)."""

    clear: Tensor
    rainy: Tensor
    clear_guide: Tensor | None
    rainy_guide: Tensor | None


class PairSampler:
    """Endless pairs: each set is shuffled anew in every epoch, so that pairs change.

    It has no state, so a resumed training continues as if never interrupted.
    """

    def __init__(self, pictures: UnpairedImages, seed: int, guided: bool, device: str) -> None:
        self.pictures = pictures
        self._seed, self._guided, self._device = seed, guided, device

    def pair(self, iteration: int) -> UnpairedSample:
        clear, clear_guide = self.read(self._chosen(self.pictures.source, iteration, 0))
        rainy, rainy_guide = self.read(self._chosen(self.pictures.target, iteration, 1))
        return UnpairedSample(clear, rainy, clear_guide, rainy_guide)

    def generator(self, iteration: int) -> Any:
        """Random numbers of an iteration, drawn on the CPU."""
        return torch.Generator().manual_seed(self._seed * 1_000_003 + iteration)

    def read(self, picture: DatasetImage) -> tuple[Tensor, Tensor | None]:
        """Read one image and its guide, as batches of one.

        A missing guide becomes zeros, to which the encoder's new columns add nothing. If only one of the two looks has
        guides, a model can tell the looks apart by them, so better give both looks normals.
        """
        image, guide = picture.read()
        batch = torch.from_numpy(image).permute(2, 0, 1)[None].contiguous().to(self._device) * 2 - 1
        if not self._guided:
            return batch, None
        guide = np.zeros(image.shape[:2], np.float32) if guide is None else guide
        return batch, torch.from_numpy(guide.copy())[None, None].to(self._device)

    def _chosen(self, pictures: Sequence[DatasetImage], iteration: int, which: int) -> DatasetImage:
        turn, place = divmod(iteration, len(pictures))
        return pictures[int(np.random.default_rng((self._seed, which, turn)).permutation(len(pictures))[place])]


def fingerprint(pictures: UnpairedImages) -> str:
    """Identify sets of images by names and sizes, in a readable line."""
    names = "\n".join(f"{each.name} {each.width} {each.height}" for each in (*pictures.source, *pictures.target))
    return f"{len(pictures.source)} clear, {len(pictures.target)} rainy, {zlib.crc32(names.encode()):08x}"


# Step


@dataclass(frozen=True, slots=True, eq=False)
class FinetuneStepResult:
    """Losses and images of an iteration."""

    losses: dict[str, float]
    """Weighted losses by name, and "change": mean |a2b(clear) - clear| as a share of the value range."""
    clear: Tensor
    translated: Tensor
    """(1, 3, h, w) in -1..1, both."""


# Losses of CycleGAN-Turbo (Parmar et al. 2024): multilevel adversarial, cycle and identity

Perceptual = Callable[[Tensor, Tensor], Tensor]
"""Perceptual distance of two batches (b, 3, h, w) in -1..1, a scalar; LPIPS is one."""


class FinetuneTrainer:
    """Trained state and training step: three steps of the generator per iteration, then two of the discriminators.

    As in the published code, the cycle, adversarial and identity losses each get a step with shared moments, so only
    the graph of one direction is in memory at a time. In a cycle, an image's guide serves both directions: rain
    changes looks, not surfaces. The discriminators get only colors.
    """

    def __init__(
        self,
        model: Any,
        discriminators: tuple[Discriminator, Discriminator],
        order: PairSampler,
        settings: FinetuningSettings,
        perceptual: Perceptual | None = None,
    ) -> None:
        """Take a model with LoRA layers, and the discriminators of rainy and of clear images."""
        self.model, self.order = model, order
        self.rainy_judge, self.clear_judge = discriminators
        self._settings, self._perceptual = settings, perceptual
        optimizer = settings.optimizer
        self._generator = NamedOptimizer(optimizer, optimizer.rate, *trained_parameters(model))
        own = {f"rainy.{name}": parameter for name, parameter in self.rainy_judge.named_parameters()}
        own |= {f"clear.{name}": parameter for name, parameter in self.clear_judge.named_parameters()}
        rate = optimizer.rate if optimizer.discriminator_rate is None else optimizer.discriminator_rate
        self._judges = NamedOptimizer(optimizer, rate, own)
        if settings.gradient_checkpointing:
            for part in (model.unet, model.vae, model.vae_b2a):
                part.enable_gradient_checkpointing()

    def iterate(self, number: int) -> FinetuneStepResult:
        """Train on one pair of images. Raises `DivergedError` if a gradient is not finite."""
        pair, random = self.order.pair(number), self.order.generator(number)
        for judge in (self.rainy_judge, self.clear_judge):
            judge.requires_grad_(False)  # gradients still reach the images
        losses = self._learn(number, self._cycle_losses(pair))
        made: list[Tensor] = []
        losses |= self._learn(number, self._adversarial_losses(pair, random, made))
        losses |= self._learn(number, self._identity_losses(pair))
        made_rainy, made_clear = (each.detach() for each in made)
        for judge in (self.rainy_judge, self.clear_judge):
            judge.requires_grad_(True)
        losses |= self._learn_to_judge(pair, made_rainy, made_clear, number, random)
        losses["change"] = float((made_rainy - pair.clear).abs().mean()) / 2
        return FinetuneStepResult(losses, pair.clear, made_rainy)

    def translated(self, pictures: Tensor, guides: Tensor | None, direction: Direction) -> Tensor:
        """Translate without training."""
        with torch.no_grad():
            return self._translate(pictures, guides, direction)

    def state(self) -> dict[str, Any]:
        """Return the complete training state, as tensors by name."""
        weights = {
            f"{_GENERATOR}:weights": self._generator.parameters,
            f"{_DISCRIMINATORS}:rainy": self.rainy_judge.state_dict(),
            f"{_DISCRIMINATORS}:clear": self.clear_judge.state_dict(),
        }
        arrays = {
            f"{kind}:{name}": tensor.detach().cpu().clone()
            for kind, tensors in weights.items()
            for name, tensor in tensors.items()
        }
        for kind, optimizer in ((_GENERATOR, self._generator), (_DISCRIMINATORS, self._judges)):
            arrays |= {f"{kind}:moments:{name}": moment for name, moment in optimizer.state().items()}
        return arrays

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state`; raises KeyError or RuntimeError for missing or unfitting tensors."""
        weights = arrays_of(arrays, f"{_GENERATOR}:weights")
        with torch.no_grad():
            for name, parameter in self._generator.parameters.items():
                parameter.copy_(weights[name])
        self._generator.restore(arrays_of(arrays, f"{_GENERATOR}:moments"))
        self._judges.restore(arrays_of(arrays, f"{_DISCRIMINATORS}:moments"))
        self.rainy_judge.load_state_dict(arrays_of(arrays, f"{_DISCRIMINATORS}:rainy"))
        self.clear_judge.load_state_dict(arrays_of(arrays, f"{_DISCRIMINATORS}:clear"))

    def _learn(self, number: int, losses: Iterable[tuple[str, Tensor]]) -> dict[str, float]:
        """Take one step of the generator on losses, each of which is freed before the next one is computed."""
        values = {name: _learn_from(loss) for name, loss in losses}
        self._generator.step(number)
        return values

    def _cycle_losses(self, pair: UnpairedSample) -> Iterator[tuple[str, Tensor]]:
        weights = self._settings.losses
        for name, picture, guide, there, back in (
            ("cycle_clear", pair.clear, pair.clear_guide, "a2b", "b2a"),
            ("cycle_rainy", pair.rainy, pair.rainy_guide, "b2a", "a2b"),
        ):
            restored = self._translate(self._translate(picture, guide, there), guide, back)
            yield name, difference(restored, picture, weights.cycle, weights.cycle_lpips, self._perceptual)

    def _adversarial_losses(
        self, pair: UnpairedSample, random: Any, made: list[Tensor]
    ) -> Iterator[tuple[str, Tensor]]:
        """Losses of the generator before the discriminators; appends the rainy and the clear image to `made`."""
        for name, judge, picture, guide, direction in (
            ("gan_rainy", self.rainy_judge, pair.clear, pair.clear_guide, "a2b"),
            ("gan_clear", self.clear_judge, pair.rainy, pair.rainy_guide, "b2a"),
        ):
            made.append(self._translate(picture, guide, direction))
            yield name, adversarial(judge(made[-1], random), real=True) * self._settings.losses.gan

    def _identity_losses(self, pair: UnpairedSample) -> Iterator[tuple[str, Tensor]]:
        """Losses of changes of rainy images by a2b and of clear ones by b2a."""
        weights = self._settings.losses
        for name, picture, guide, direction in (
            ("identity_rainy", pair.rainy, pair.rainy_guide, "a2b"),
            ("identity_clear", pair.clear, pair.clear_guide, "b2a"),
        ):
            same = self._translate(picture, guide, direction)
            yield name, difference(same, picture, weights.identity, weights.identity_lpips, self._perceptual)

    def _learn_to_judge(
        self, pair: UnpairedSample, made_rainy: Tensor, made_clear: Tensor, number: int, random: Any
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
        is_half = self._settings.precision == "bfloat16"
        with torch.autocast(pictures.device.type, torch.bfloat16) if is_half else nullcontext():
            translated = self.model.translate(pictures, guides, direction)
        return translated.float()


def _learn_from(loss: Tensor) -> float:
    """Accumulate the gradients of a loss and free its graph."""
    loss.backward()
    return float(loss.detach())


def adversarial(logits: Sequence[Tensor], real: bool) -> Tensor:
    """Sum over levels of the mean cross-entropy of logits with "real" or "made" (multilevel sigmoid loss).

    The generator minimizes it with `real` for its own images.
    """
    losses = [torch.nn.functional.softplus(-each if real else each).mean() for each in logits]
    return torch.stack(losses).sum()


def difference(
    found: Tensor, truth: Tensor, weight: float, perceptual_weight: float, perceptual: Perceptual | None
) -> Tensor:
    """Weighted mean absolute difference of images in -1..1, plus the weighted perceptual one, if any."""
    loss = weight * (found - truth).abs().mean()
    if perceptual is not None and perceptual_weight > 0:
        loss = loss + perceptual_weight * perceptual(found, truth)
    return loss


# Trained parameters of CycleGAN-Turbo

Parameter = Any
_LORA = re.compile(r"\.lora_(A|B|embedding_A|embedding_B)\.")
_SKIP = re.compile(r"^vae(_b2a)?\.decoder\.skip_conv_\d+\.(base_layer\.)?weight$")
_UNET_INPUT = re.compile(r"^unet\.conv_in\.(base_layer\.)?(weight|bias)$")
_ENCODER_INPUT = re.compile(r"^vae(_b2a)?\.encoder\.conv_in\.(base_layer\.)?weight$")
_COLORS = 3


def trained_parameters(model: Any) -> tuple[dict[str, Parameter], dict[str, Parameter]]:
    """Choose the trained parameters, by name, and freeze the rest; the first result has weight decay, the second none.

    The published code trains every LoRA, the UNet's first convolution and the skip convolutions; but adding the
    adapters freezes the skips again, and its checkpoints lack the first convolution. Here:

    * every LoRA and the skip convolutions, which also start at about zero: with weight decay, which pulls back to the
      pretrained model;
    * the UNet's first convolution, and the guide's columns of each encoder's first convolution, for which a LoRA of
      low rank is too small: without decay, which would pull away from the pretrained model.

    `save_weights` writes all of them. Raises ValueError for a model without LoRA layers.
    """
    model.requires_grad_(False)
    decaying: dict[str, Parameter] = {}
    held: dict[str, Parameter] = {}
    for name, parameter in model.named_parameters():
        if _LORA.search(name) or _SKIP.match(name):
            decaying[name] = parameter
        elif _UNET_INPUT.match(name):
            held[name] = parameter
        elif _ENCODER_INPUT.match(name) and parameter.shape[1] > _COLORS:
            held[name] = parameter
            parameter.requires_grad_(True).register_hook(_only_guide)
    if not any(map(_LORA.search, decaying)):
        raise ValueError("the model has no LoRA layers: build it with LoRA ranks to train it")
    for parameter in (*decaying.values(), *held.values()):
        parameter.requires_grad_(True)
    return decaying, held


def _only_guide(gradient: Any) -> Any:
    """Zero the gradient of the color columns: with no gradient and no decay, AdamW leaves them bit-identical."""
    gradient = gradient.clone()
    gradient[:, :_COLORS] = 0
    return gradient


# Optimizer: AdamW with named parameters, gradient clipping and warm-up

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class DivergedError(ValueError):
    """Error of a diverged training: a gradient is not finite."""


class NamedOptimizer:
    """One AdamW. Weight decay applies to the parameters in `decaying`, not to those in `held`."""

    def __init__(
        self,
        settings: OptimizerSettings,
        rate: float,
        decaying: Mapping[str, Parameter],
        held: Mapping[str, Parameter] | None = None,
    ) -> None:
        self.parameters = {**decaying, **(held or {})}
        self._rate, self._warmup, self._clip = rate, settings.warmup_steps, settings.clip_norm
        groups = [{"params": list(decaying.values())}, {"params": list((held or {}).values()), "weight_decay": 0.0}]
        self._adam = torch.optim.AdamW(
            [group for group in groups if group["params"]],
            lr=rate,
            betas=(settings.beta_1, settings.beta_2),
            eps=settings.epsilon,
            weight_decay=settings.weight_decay,
            fused=True,  # one pass over hundreds of small tensors
        )

    def begin(self) -> None:
        self._adam.zero_grad(set_to_none=True)

    def step(self, iteration: int) -> None:
        """Clip, update and clear the gradients.

        The learning rate depends on the iteration alone, not on the number of its steps; the published code advances
        its schedule with each step. Raises `DivergedError` before any update if the gradient is not finite.
        """
        for group in self._adam.param_groups:
            group["lr"] = self._rate * min(1.0, (iteration + 1) / max(self._warmup, 1))
        length = float(torch.nn.utils.clip_grad_norm_(self.parameters.values(), self._clip))
        if not length < float("inf"):
            raise DivergedError(
                f"iteration {iteration + 1}: the gradient's length is {length}; lower the rate, and start from the "
                "weights that were saved last"
            )
        self._adam.step()
        self.begin()

    def state(self) -> dict[str, Any]:
        """Return all moments, on the CPU, as "moment:parameter"; empty before the first step."""
        return {
            f"{moment}:{name}": self._adam.state[parameter][moment].detach().cpu().clone()
            for name, parameter in self.parameters.items()
            if parameter in self._adam.state
            for moment in _MOMENTS
        }

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state`; raises KeyError if a parameter's moments are incomplete."""
        self._adam.state.clear()
        for name, parameter in self.parameters.items():
            if f"step:{name}" not in arrays:
                continue
            moments = {moment: arrays[f"{moment}:{name}"].to(parameter.device) for moment in _MOMENTS}
            moments |= {moment: moments[moment].to(parameter) for moment in _MOMENTS[1:]}  # and its precision
            self._adam.state[parameter] = {moment: value.clone() for moment, value in moments.items()}
