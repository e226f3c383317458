"""CycleGAN-Turbo: the step, the skips, the fourth channel, and what training starts from."""

from typing import Any

import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")

from gsrain_engine.appearance.cyclegan_turbo import lora  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import (  # noqa: E402
    CycleGanTurbo,
    OneStep,
    add_skips,
    build_random_model,
    decode_latents,
    encode_images,
    sd_turbo,
    tiny,
)
from gsrain_engine.appearance.cyclegan_turbo.weights import plain_layers  # noqa: E402

from .published_checkpoints import pristine, untrained  # noqa: E402


def _noise(seed: int, *shape: int) -> Any:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def _out(model: CycleGanTurbo, pictures: Any, guides: Any = None, direction: str = "a2b") -> Any:
    with torch.no_grad():
        return model.translate(pictures, guides, direction)


def test_the_step_is_that_of_ddpm_with_trailing_spacing() -> None:
    step = OneStep.of(sd_turbo())
    first, last = sd_turbo().betas
    scheduler = diffusers.DDPMScheduler(
        beta_start=first, beta_end=last, beta_schedule="scaled_linear", timestep_spacing="trailing", clip_sample=False
    )
    scheduler.set_timesteps(1)
    assert scheduler.timesteps.tolist() == [step.timestep] == [999]
    latents, noise = _noise(1, 2, 4, 8, 8), _noise(2, 2, 4, 8, 8)
    theirs = scheduler.step(noise, 999, latents, generator=torch.Generator().manual_seed(3)).prev_sample
    torch.testing.assert_close(step.clean(latents, noise), theirs, rtol=1e-5, atol=1e-5)
    assert step.signal**2 == pytest.approx(0.0046601, abs=1e-7)


def test_the_real_architecture_has_the_published_layers() -> None:
    with torch.device("meta"):
        model = build_random_model(sd_turbo(), normals=True)
    assert [len(names) for names in lora.unet_targets(model.unet)] == [94, 147, 17]
    layers = [name.removeprefix("vae.") for name in plain_layers(model) if name.startswith("vae.")]
    assert len(lora.match_targets(layers, lora.VAE_LAYERS)) == 74
    skips = [model.vae.get_parameter(f"decoder.skip_conv_{i}.weight").shape[:2] for i in (1, 2, 3, 4)]
    assert skips == [(512, 512), (512, 256), (512, 128), (256, 128)]
    assert model.vae.encoder.conv_in.weight.shape == (128, 4, 3, 3)
    assert sum(each.numel() for each in model.unet.parameters()) == 865_910_724
    assert (sd_turbo().side_multiple, sd_turbo().caption_shape) == (8, (1, 77, 1024))
    assert model.unet.attn_processors.keys() == pristine().unet.attn_processors.keys()  # tiny() has the same blocks


def test_a_picture_is_translated_the_same_each_time_and_differently_in_each_direction() -> None:
    model, pictures = pristine(), _noise(3, 2, 3, 24, 40)
    there = _out(model, pictures)
    assert there.shape == pictures.shape and there.abs().max() <= 1
    assert torch.equal(there, _out(model, pictures))
    assert not torch.equal(there, _out(model, pictures, direction="b2a"))
    torch.testing.assert_close(there[1:], _out(model, pictures[1:]), atol=1e-4, rtol=0)
    torch.testing.assert_close(there, model.translate(pictures), atol=1e-4, rtol=0)  # with gradients: all at once
    made = _out(untrained().to(torch.bfloat16), pictures.to(torch.bfloat16)).float()
    assert made.isfinite().all() and (made - there).abs().mean() < 0.1


def test_the_fourth_channel_changes_no_bit_and_gets_gradients() -> None:
    pictures, guides = _noise(4, 1, 3, 32, 32), _noise(5, 1, 1, 32, 32)
    narrow, wide = pristine(), untrained(normals=True)
    assert wide.takes_guides and not narrow.takes_guides
    assert wide.vae.config.in_channels == wide.vae_b2a.config.in_channels == 4
    expected = _out(narrow, pictures)
    assert torch.equal(_out(wide, pictures, guides), expected)
    assert torch.equal(_out(wide, pictures), expected)
    wide.vae.encoder.conv_in.weight.requires_grad_(True)
    wide.translate(pictures, guides).square().mean().backward()
    assert wide.vae.encoder.conv_in.weight.grad[:, 3].abs().max() > 0
    with torch.no_grad():
        wide.vae.encoder.conv_in.weight[:, 3] += 0.1
    assert not torch.equal(_out(wide, pictures, guides), expected)


def test_without_skips_it_is_diffusers_autoencoder() -> None:
    torch.manual_seed(0)
    vae = diffusers.AutoencoderKL(**tiny().vae).eval()
    pictures = _noise(8, 1, 3, 32, 32)
    with torch.no_grad():
        mode = vae.encode(pictures).latent_dist.mode() * vae.config.scaling_factor
        plain = vae.decode(mode / vae.config.scaling_factor).sample.clamp(-1, 1)
        add_skips(vae)
        latents, skips = encode_images(vae, pictures)
        assert torch.equal(latents, mode)
        assert torch.equal(decode_latents(vae, latents, skips, strength=0), plain)
        with_skips = decode_latents(vae, latents, skips)
        assert not torch.equal(with_skips, plain)
        torch.testing.assert_close(with_skips, plain, atol=1e-2, rtol=0)


def test_adapters_change_nothing_before_training_and_count_as_published() -> None:
    pytest.importorskip("peft")
    pictures = _noise(10, 1, 3, 16, 16)
    model = build_random_model(tiny(), False, lora.LoraRanks(unet=8, vae=4))
    assert torch.equal(_out(model, pictures), _out(pristine(), pictures))
    scales = {lora.addition_of(layer).scale for _, layer in lora.adapted_layers(model.unet)}
    assert scales == {1.0}
    assert {lora.addition_of(layer).scale for _, layer in lora.adapted_layers(model.vae)} == {2.0}
    assert model.unet.active_adapters() == list(lora.UNET_ADAPTERS)
    trained = {name.split(".")[-3] for name, each in model.named_parameters() if each.requires_grad}
    assert trained == {"lora_A", "lora_B"}
