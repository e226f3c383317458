"""Cross-view attention: the order of views, one layer against formulas written out, a whole small UNet."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
attention = pytest.importorskip("diffusers.models.attention_processor")

from gsrain_engine.appearance.correspondence import Correspondence, MatchOutcome  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.cross_view_attention import (  # noqa: E402
    MAX_SCORES,
    AttendingView,
    FeatureMaps,
    MutualSelfAttention,
    TileWindow,
    chunked_attention,
    cross_view_attention,
    last_uses,
    plan_outward,
)

# Plan


@st.composite
def neighbors(draw) -> list[tuple[int, ...]]:
    """Up to eight views, each naming some of the others."""
    count = draw(st.integers(1, 8))
    others = [st.sampled_from([o for o in range(count) if o != view] or [view]) for view in range(count)]
    return [tuple(draw(st.lists(each, unique=True, max_size=min(3, count - 1)))) for each in others]


@given(neighbors(), st.integers(1, 3))
def test_each_view_comes_once_and_attends_to_earlier_linked_views(named, limit) -> None:
    steps = plan_outward(named, limit)
    order = [step.view for step in steps]
    assert sorted(order) == list(range(len(named)))
    for number, step in enumerate(steps):
        linked = {o for o in order[:number] if o in named[step.view] or step.view in named[o]}
        assert set(step.sources) <= linked and len(step.sources) == min(limit, len(linked))
    sources = {source for step in steps for source in step.sources}
    assert last_uses(steps) == {s: max(n for n, step in enumerate(steps) if s in step.sources) for s in sources}


def test_the_plan_begins_in_the_middle_and_each_separate_place_has_an_anchor() -> None:
    row = plan_outward([(1, 2), (0, 2), (1, 3), (2, 4), (3, 2)], 2)
    assert row == [(2, ()), (1, (2,)), (0, (1, 2)), (3, (2,)), (4, (3, 2))]
    assert plan_outward([(1,), (0,), (3,), (2,), ()], 2) == [(0, ()), (1, (0,)), (2, ()), (3, (2,)), (4, ())]


# One layer


def layer(**options):
    torch.manual_seed(1)
    return attention.Attention(query_dim=12, heads=3, dim_head=4, **options).eval()


@pytest.mark.parametrize("options", [{}, {"bias": True, "out_bias": False}])
@torch.inference_mode()
def test_without_neighbors_it_is_the_attention_of_diffusers(options):
    attn, features = layer(**options), torch.randn(1, 20, 12)
    ours = MutualSelfAttention("x", lambda name, own: None)(attn, features)
    assert torch.equal(ours, attention.AttnProcessor2_0()(attn, features))


@torch.inference_mode()
def test_with_neighbors_it_is_the_formula_with_a_mask():
    attn, own, neighbor = layer(), torch.randn(1, 20, 12), torch.randn(1, 20, 12)
    valid = torch.arange(20) % 3 > 0
    ours = MutualSelfAttention("x", lambda name, own: neighbor[0, valid])(attn, own)

    both = torch.cat([neighbor, own], dim=1)
    mask = torch.cat([valid, torch.ones(20, dtype=torch.bool)])
    parts = []
    for head in range(3):
        d = slice(4 * head, 4 * head + 4)
        scores = attn.to_q(own)[..., d] @ attn.to_k(both)[..., d].transpose(1, 2) / 2
        parts.append(scores.masked_fill(~mask, -torch.inf).softmax(-1) @ attn.to_v(both)[..., d])
    torch.testing.assert_close(ours, attn.to_out[0](torch.cat(parts, dim=-1)))


@torch.inference_mode()
def test_scores_are_bounded(monkeypatch):
    counted = []
    original = torch.nn.functional.scaled_dot_product_attention

    def counting(query, key, value, **options):
        counted.append(query.shape[1] * query.shape[2] * key.shape[2])
        return query if query.is_meta else original(query, key, value, **options)

    query, key, value = (torch.randn(1, 3, n, 4) for n in (20, 27, 27))
    whole = chunked_attention(query, key, value, 0.5)
    monkeypatch.setattr(torch.nn.functional, "scaled_dot_product_attention", counting)
    for most, count in ((800, 3), (1, 20)):
        torch.testing.assert_close(chunked_attention(query, key, value, 0.5, most), whole)
        assert len(counted) == count and sum(counted) == 3 * 20 * 27
        counted.clear()
    # SD-Turbo's finest layer at 512 px: 5 heads, 4096 tokens, two neighbors. Only shapes are computed.
    query, key = (torch.empty(1, 5, n, 64, device="meta") for n in (4096, 3 * 4096))
    chunked_attention(query, key, key, 0.125)
    assert sum(counted) == 5 * 4096 * 3 * 4096 and max(counted) <= MAX_SCORES


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


@pytest.fixture(scope="module")
def unet():
    torch.manual_seed(3)
    return diffusers.UNet2DConditionModel(
        layers_per_block=1, norm_num_groups=4, cross_attention_dim=8, attention_head_dim=2,
        block_out_channels=(16, 16), down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"),
        up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
    ).eval()  # fmt: skip


LATENTS = torch.randn(2, 4, LATENT, LATENT, generator=torch.Generator().manual_seed(5))


def run(unet, latents):
    with torch.inference_mode():
        return unet(latents, 999, encoder_hidden_states=torch.ones(1, 3, 8)).sample


def attended(unet, correspondence: Correspondence, latents=LATENTS):
    """The second latent, attending to the first one, which passes the network before."""
    with cross_view_attention(unet, (8, 16)) as exchange:
        with exchange.during(AttendingView(0, is_source=True), WHOLE):
            run(unet, latents[:1])
        with exchange.during(AttendingView(1, ((0, correspondence),)), WHOLE):
            return run(unet, latents[1:])


def test_a_view_changes_by_what_it_matches_in_another_one(unet):
    plain = run(unet, LATENTS[1:])
    assert torch.equal(attended(unet, shifted(valid=False)), plain)
    assert (attended(unet, shifted(8)) - plain).abs().max() > 1e-3
    twins = LATENTS[1:].expand(2, -1, -1, -1)
    torch.testing.assert_close(attended(unet, shifted(), latents=twins), plain, atol=2e-6, rtol=1e-5)


def test_overlapping_tiles_of_a_source_are_averaged_until_it_is_forgotten():
    maps = FeatureMaps()
    for top, value in ((0, 1.0), (2, 3.0)):
        maps.put(0, "x", torch.full((6 * 4, 2), value), TileWindow(top, 0, 6, 4, (8, 4)))
    rows, columns = ((2 * np.arange(n, dtype=np.float32) + 1) / n - 1 for n in (8, 4))
    centers = np.stack(np.broadcast_arrays(columns[None], rows[:, None]), axis=2)
    averaged = maps.warped(0, "x", centers, np.ones((8, 4), bool)).reshape(8, 4, 2)
    assert (averaged[:, 0, 1] == torch.tensor([1, 1, 2, 2, 2, 2, 3, 3.0])).all()
    maps.forget({0})
    assert maps.warped(0, "x", centers, np.ones((8, 4), bool)) is None
    with pytest.raises(ValueError, match="whole tokens"):
        TileWindow(3, 0, 48, PX, (PX, PX)).in_tokens(6, 8)
