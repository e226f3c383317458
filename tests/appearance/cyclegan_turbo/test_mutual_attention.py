"""The three invariants of mutual self-attention, on a layer and on a whole small UNet."""

from dataclasses import dataclass

import numpy as np
import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")

from gsrain_engine.appearance.correspondence import (  # noqa: E402
    Correspondence,
    MatchOutcome,
)
from gsrain_engine.appearance.cyclegan_turbo.cross_view_attention import (  # noqa: E402
    BatchElement,
    CrossViewAttention,
    TileWindow,
    cross_view_attention,
)

PX, LATENT = 64, 8
WHOLE = TileWindow.whole(PX, PX)


def shifted(pixels: int = 0, valid: bool = True) -> Correspondence:
    """Places of a picture in another one that lies `pixels` to the right."""
    rows, columns = np.mgrid[:PX, :PX] + 0.5
    places = np.stack([columns + pixels, rows], axis=-1).astype(np.float32)
    inside = (places[..., 0] > 0) & (places[..., 0] < PX) & valid
    outcome = np.where(inside, MatchOutcome.MATCHED, MatchOutcome.OUTSIDE).astype(np.uint8)
    return Correspondence(places, outcome, (PX, PX))


@pytest.fixture(scope="module")
def unet():
    torch.manual_seed(3)
    return diffusers.UNet2DConditionModel(
        block_out_channels=(16, 16),
        down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"),
        up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
        layers_per_block=1,
        norm_num_groups=4,
        cross_attention_dim=8,
        attention_head_dim=2,
    ).eval()


@dataclass
class Inputs:
    latents: object
    caption: object


@pytest.fixture
def inputs():
    torch.manual_seed(5)
    return Inputs(torch.randn(2, 4, LATENT, LATENT), torch.randn(1, 3, 8))


def run(unet, latents, caption):
    with torch.inference_mode():
        return unet(latents, 999, encoder_hidden_states=caption.expand(len(latents), -1, -1)).sample


def pair(correspondence, source=0):
    """A view that nobody sees anything in, and one that looks at it."""
    return [BatchElement(0, WHOLE, (), True), BatchElement(1, WHOLE, ((source, correspondence),), False)]


SETTINGS = CrossViewAttention(px_per_token=(8, 16))


def test_a_view_that_looks_at_its_own_twin_is_as_without(unet, inputs):
    latents = inputs.latents[:1].expand(2, -1, -1, -1)
    plain = run(unet, latents, inputs.caption)
    with cross_view_attention(unet, SETTINGS) as talk, talk.batch(pair(shifted())):
        mutual = run(unet, latents, inputs.caption)
    torch.testing.assert_close(mutual, plain, atol=2e-6, rtol=1e-5)


def test_a_view_that_matches_nothing_is_exactly_as_without(unet, inputs):
    plain = run(unet, inputs.latents, inputs.caption)
    with cross_view_attention(unet, SETTINGS) as talk, talk.batch(pair(shifted(valid=False))):
        assert torch.equal(run(unet, inputs.latents, inputs.caption), plain)


def test_only_the_view_that_looks_changes(unet, inputs):
    plain = run(unet, inputs.latents, inputs.caption)
    with cross_view_attention(unet, SETTINGS) as talk, talk.batch(pair(shifted(8))):
        mutual = run(unet, inputs.latents, inputs.caption)
    assert torch.equal(mutual[0], plain[0])
    assert (mutual[1] - plain[1]).abs().max() > 1e-3


def test_one_after_the_other_is_as_both_at_once(unet, inputs):
    look = pair(shifted(8))
    with cross_view_attention(unet, SETTINGS) as talk, talk.batch(look):
        at_once = run(unet, inputs.latents, inputs.caption)
    with cross_view_attention(unet, SETTINGS) as talk:
        with talk.batch(look[:1]):
            run(unet, inputs.latents[:1], inputs.caption)
        kept = talk.maps.nbytes
        with talk.batch(look[1:]):
            after = run(unet, inputs.latents[1:], inputs.caption)
        assert talk.maps.nbytes == kept > 0
        talk.maps.forget({0})
        assert talk.maps.nbytes == 0
    torch.testing.assert_close(after[0], at_once[1], atol=2e-6, rtol=1e-5)


def test_the_network_is_as_before_afterwards(unet, inputs):
    before = dict(unet.attn_processors)
    plain = run(unet, inputs.latents, inputs.caption)
    with cross_view_attention(unet, SETTINGS) as talk:
        assert unet.attn_processors != before
        assert torch.equal(run(unet, inputs.latents, inputs.caption), plain)
        with pytest.raises(ValueError, match="2 views were announced"), talk.batch(pair(shifted())):
            run(unet, inputs.latents[:1], inputs.caption)
    assert unet.attn_processors == before


def test_layers_are_chosen_by_name_and_by_the_width_of_their_tokens(unet, inputs):
    plain = run(unet, inputs.latents, inputs.caption)

    def changed(**choice):
        with cross_view_attention(unet, CrossViewAttention(**choice)) as talk, talk.batch(pair(shifted(8))):
            return not torch.equal(run(unet, inputs.latents, inputs.caption), plain)

    assert changed(layers=("up_blocks.*",), px_per_token=(8,))
    assert changed(layers=("mid_block.*",), px_per_token=(16,))
    assert not changed(layers=("mid_block.*",), px_per_token=(8,))
    with pytest.raises(ValueError, match="named like attn2"):
        changed(layers=("attn2",))


def test_attention_to_the_text_stays_what_it_was(unet):
    with cross_view_attention(unet, SETTINGS):
        names = {name: type(p).__name__ for name, p in unet.attn_processors.items()}
    assert {kind for name, kind in names.items() if "attn1" in name} == {"MutualSelfAttention"}
    assert {kind for name, kind in names.items() if "attn2" in name} == {"AttnProcessor2_0"}


def test_peft_layers_count_too(inputs):
    peft = pytest.importorskip("peft")
    torch.manual_seed(3)
    unet = diffusers.UNet2DConditionModel(
        block_out_channels=(8,),
        down_block_types=("CrossAttnDownBlock2D",),
        up_block_types=("CrossAttnUpBlock2D",),
        layers_per_block=1,
        norm_num_groups=4,
        cross_attention_dim=8,
        attention_head_dim=2,
    ).eval()
    settings = CrossViewAttention(px_per_token=(8,))

    def looked():
        with cross_view_attention(unet, settings) as talk, talk.batch(pair(shifted(8))):
            return run(unet, inputs.latents, inputs.caption)

    unet.add_adapter(peft.LoraConfig(r=2, target_modules=["to_k", "to_v"], init_lora_weights=False))
    adapted = looked()
    unet.disable_adapters()
    bare = looked()
    assert not torch.equal(adapted, bare)
    unet.enable_adapters()
    unet.fuse_lora()
    torch.testing.assert_close(looked(), adapted, atol=1e-5, rtol=1e-4)
