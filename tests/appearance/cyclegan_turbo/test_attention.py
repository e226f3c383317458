"""Cross-view attention: the order of views, one layer against formulas written out, a whole small UNet."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
attention = pytest.importorskip("diffusers.models.attention_processor")

from gsrain_engine.appearance.correspondence import Correspondence, MatchOutcome  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.cross_view_attention import (  # noqa: E402
    BatchElement,
    CrossViewAttention,
    MutualSelfAttention,
    TileWindow,
    chunked_attention,
    cross_view_attention,
    plan_outward,
)

# Plan

ROW = [(1, 2), (0, 2), (1, 3), (2, 4), (3, 2)]


def sources(plan):
    return {view: sources for step in plan.steps for view, sources in zip(step.views, step.sources, strict=True)}


@st.composite
def neighbors(draw) -> list[tuple[int, ...]]:
    """Up to eight views, each naming some of the others."""
    count = draw(st.integers(1, 8))
    return [
        tuple(draw(st.lists(st.sampled_from([o for o in range(count) if o != view] or [0]), unique=True, max_size=3)))
        if count > 1
        else ()
        for view in range(count)
    ]


@given(neighbors(), st.integers(1, 3))
def test_each_view_comes_once_and_looks_only_back_at_so_many_linked_ones(named, limit) -> None:
    plan = plan_outward(named, limit)
    order = [view for step in plan.steps for view in step.views]
    assert sorted(order) == list(range(len(named)))
    used: dict[int, int] = {}
    for number, step in enumerate(plan.steps):
        for view, looked_at in zip(step.views, step.sources, strict=True):
            assert len(looked_at) <= limit
            for other in looked_at:
                assert order.index(other) < order.index(view)
                assert other in named[view] or view in named[other]
                used[other] = number
    assert plan.last_use() == used


def test_outward_begins_in_the_middle_and_at_the_best_first() -> None:
    found = sources(plan_outward(ROW, 2))
    assert found[2] == () and all(looked_at for view, looked_at in found.items() if view != 2)
    everybody = [tuple(o for o in (0, 1, 2, 3) if o != view) for view in range(4)]
    assert sources(plan_outward(everybody, 3))[3] == (0, 1, 2)
    apart = plan_outward([(1,), (0,), (3,), (2,), ()], 2)
    assert [view for view, looked_at in sources(apart).items() if not looked_at] == [0, 2, 4]  # each has its anchor


# One layer


class Others:
    def __init__(self, *features):
        self.features = list(features)

    def __call__(self, layer, features):
        return self.features


def layer(**options):
    torch.manual_seed(1)
    return attention.Attention(query_dim=12, heads=3, dim_head=4, **options).eval()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"bias": True, "out_bias": False},
        {"residual_connection": True, "rescale_output_factor": 2.0, "norm_num_groups": 3},
        {"qk_norm": "layer_norm"},
    ],
)
@pytest.mark.parametrize("shape", [(2, 20, 12), (2, 12, 5, 4)])
@torch.inference_mode()
def test_alone_it_is_diffusers_own(options, shape):
    attn, features = layer(**options), torch.randn(shape)
    ours = MutualSelfAttention("x", Others(None, None), 10**9)(attn, features)
    assert torch.equal(ours, attention.AttnProcessor2_0()(attn, features))


@torch.inference_mode()
def test_it_is_the_formula_with_a_mask():
    attn, own, neighbour = layer(), torch.randn(1, 20, 12), torch.randn(1, 20, 12)
    valid = torch.arange(20) % 3 > 0
    ours = MutualSelfAttention("x", Others(neighbour[0, valid]), 10**9)(attn, own)

    both = torch.cat([neighbour, own], dim=1)
    mask = torch.cat([valid, torch.ones(20, dtype=torch.bool)])
    parts = []
    for head in range(3):
        d = slice(4 * head, 4 * head + 4)
        scores = attn.to_q(own)[..., d] @ attn.to_k(both)[..., d].transpose(1, 2) / 2
        parts.append(scores.masked_fill(~mask, -torch.inf).softmax(-1) @ attn.to_v(both)[..., d])
    torch.testing.assert_close(ours, attn.to_out[0](torch.cat(parts, dim=-1)))


@torch.inference_mode()
@pytest.mark.parametrize("max_scores", [10**9, 800, 61, 1])
def test_never_more_scores_in_one_call_than_asked_for(monkeypatch, max_scores):
    attn, own, neighbour = layer(), torch.randn(2, 20, 12), torch.randn(7, 12)
    whole = MutualSelfAttention("x", Others(None, neighbour), 10**9)(attn, own)
    counted, of_one_query = [], 3 * 27
    original = torch.nn.functional.scaled_dot_product_attention

    def counting(query, key, value, **options):
        counted.append(query.shape[0] * query.shape[1] * query.shape[2] * key.shape[2])
        return query if query.is_meta else original(query, key, value, **options)

    monkeypatch.setattr(torch.nn.functional, "scaled_dot_product_attention", counting)
    found = MutualSelfAttention("x", Others(None, neighbour), max_scores)(attn, own)
    assert max(counted) <= max(max_scores, of_one_query)
    assert sum(counted) == 3 * 20 * 20 + 3 * 20 * 27
    torch.testing.assert_close(found, whole)

    # SD-Turbo's finest layer at 512 px: 5 heads, 4096 tokens, two neighbours. Only shapes are computed.
    counted.clear()
    query, key = (torch.empty(1, 5, n, 64, device="meta") for n in (4096, 3 * 4096))
    chunked_attention(query, key, key, 0.125, CrossViewAttention().max_scores)
    assert sum(counted) == 5 * 4096 * 3 * 4096 and 4 * max(counted) <= 256 * 2**20


# A UNet

PX, LATENT = 64, 8


WHOLE = TileWindow.whole(PX, PX)


def shifted(pixels: int = 0, valid: bool = True) -> Correspondence:
    """Places of a picture in another one that lies `pixels` to the right."""
    rows, columns = np.mgrid[:PX, :PX] + 0.5
    places = np.stack([columns + pixels, rows], axis=-1).astype(np.float32)
    inside = (places[..., 0] > 0) & (places[..., 0] < PX) & valid
    outcome = np.where(inside, MatchOutcome.MATCHED, MatchOutcome.OUTSIDE).astype(np.uint8)
    return Correspondence(places, outcome, (PX, PX))


def small_unet(**changes):
    torch.manual_seed(3)
    options = {"layers_per_block": 1, "norm_num_groups": 4, "cross_attention_dim": 8, "attention_head_dim": 2}
    blocks = {
        "block_out_channels": (16, 16),
        "down_block_types": ("CrossAttnDownBlock2D", "DownBlock2D"),
        "up_block_types": ("UpBlock2D", "CrossAttnUpBlock2D"),
    }
    return diffusers.UNet2DConditionModel(**options, **(blocks | changes)).eval()


@pytest.fixture(scope="module")
def unet():
    return small_unet()


class Inputs(NamedTuple):
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


def test_only_a_view_that_matches_something_changes(unet, inputs):
    plain = run(unet, *inputs)
    with cross_view_attention(unet, SETTINGS) as talk, talk.batch(pair(shifted(valid=False))):
        assert torch.equal(run(unet, *inputs), plain)
    with cross_view_attention(unet, SETTINGS) as talk, talk.batch(pair(shifted(8))):
        mutual = run(unet, *inputs)
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


def test_the_network_is_as_before_afterwards_and_attention_to_the_text_always(unet, inputs):
    before = dict(unet.attn_processors)
    plain = run(unet, *inputs)
    with cross_view_attention(unet, SETTINGS) as talk:
        changed = {name for name, each in unet.attn_processors.items() if isinstance(each, MutualSelfAttention)}
        assert changed == {name for name in before if "attn1" in name}
        assert torch.equal(run(unet, *inputs), plain)
        with pytest.raises(ValueError, match="2 views"), talk.batch(pair(shifted())):
            run(unet, inputs.latents[:1], inputs.caption)
    assert unet.attn_processors == before
