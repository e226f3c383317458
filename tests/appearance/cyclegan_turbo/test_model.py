"""CycleGAN-Turbo: the step, the skips, the fourth channel, and what training starts from."""

from typing import Any

import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")

from gsrain_engine.appearance.cyclegan_turbo import lora  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import (  # noqa: E402
    OneStep,
    add_skips,
    build_random_model,
    decode_latents,
    encode_images,
    sd_turbo,
    tiny,
)
from gsrain_engine.appearance.cyclegan_turbo.weights import plain_layers  # noqa: E402

from .published_checkpoints import noise, out, pristine, untrained  # noqa: E402


def test_the_step_is_that_of_ddpm_with_trailing_spacing() -> None:
    step = OneStep.of(sd_turbo())
    first, last = sd_turbo().betas
    scheduler = diffusers.DDPMScheduler(
        beta_start=first, beta_end=last, beta_schedule="scaled_linear", timestep_spacing="trailing", clip_sample=False
    )
    scheduler.set_timesteps(1)
    assert scheduler.timesteps.tolist() == [step.timestep] == [999]
    latents, predicted = noise(1, 2, 4, 8, 8), noise(2, 2, 4, 8, 8)
    theirs = scheduler.step(predicted, 999, latents, generator=torch.Generator().manual_seed(3)).prev_sample
    torch.testing.assert_close(step.clean(latents, predicted), theirs, rtol=1e-5, atol=1e-5)
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
    model, pictures = pristine(), noise(3, 2, 3, 24, 40)
    there = out(model, pictures)
    assert there.shape == pictures.shape and there.abs().max() <= 1
    assert torch.equal(there, out(model, pictures))
    assert not torch.equal(there, out(model, pictures, direction="b2a"))
    torch.testing.assert_close(there[1:], out(model, pictures[1:]), atol=1e-4, rtol=0)
    made = out(untrained().to(torch.bfloat16), pictures.to(torch.bfloat16)).float()
    assert (made - there).abs().mean() < 0.1
    with pytest.raises(ValueError, match="multiples of 8"):
        out(model, noise(3, 1, 3, 20, 40))
    with pytest.raises(ValueError, match="fourth channel"):
        out(model, pictures, noise(3, 2, 1, 24, 40))


def test_the_fourth_channel_changes_no_bit_and_gets_gradients() -> None:
    pictures, guides = noise(4, 1, 3, 32, 32), noise(5, 1, 1, 32, 32)
    narrow, wide = pristine(), untrained(normals=True)
    assert wide.takes_guides and not narrow.takes_guides
    expected = out(narrow, pictures)
    assert torch.equal(out(wide, pictures, guides), expected) and torch.equal(out(wide, pictures), expected)
    wide.vae.encoder.conv_in.weight.requires_grad_(True)
    wide.translate(pictures, guides).square().mean().backward()
    assert wide.vae.encoder.conv_in.weight.grad[:, 3].abs().max() > 0
    with torch.no_grad():
        wide.vae.encoder.conv_in.weight[:, 3] += 0.1
    assert not torch.equal(out(wide, pictures, guides), expected)


def test_without_skips_it_is_diffusers_autoencoder() -> None:
    torch.manual_seed(0)
    vae: Any = diffusers.AutoencoderKL(**tiny().vae).eval()
    pictures = noise(8, 1, 3, 32, 32)
    with torch.no_grad():
        mode = vae.encode(pictures).latent_dist.mode() * vae.config.scaling_factor
        plain = vae.decode(mode / vae.config.scaling_factor).sample.clamp(-1, 1)
        add_skips(vae)
        latents, skips = encode_images(vae, pictures)
        assert torch.equal(latents, mode)
        assert torch.equal(decode_latents(vae, latents, [0 * skip for skip in skips]), plain)
        with_skips = decode_latents(vae, latents, skips)
        assert 0 < (with_skips - plain).abs().max() < 1e-2


def test_adapters_change_nothing_before_training_and_are_scaled_as_published() -> None:
    pytest.importorskip("peft")
    pictures = noise(10, 1, 3, 16, 16)
    model = build_random_model(tiny(), False, lora.LoraRanks(unet=8, vae=4))
    assert torch.equal(out(model, pictures), out(pristine(), pictures))
    for part, scale in ((model.unet, 1.0), (model.vae, 2.0)):
        assert {lora.addition_of(layer).scale for _, layer in lora.adapted_layers(part)} == {scale}
    assert model.unet.active_adapters() == list(lora.UNET_ADAPTERS)
    assert all(".lora_" in name for name, each in model.named_parameters() if each.requires_grad)
