"""One layer against formulas written out, and the bound on scores."""

import pytest

torch = pytest.importorskip("torch")
attention = pytest.importorskip("diffusers.models.attention_processor")

from gsrain_engine.appearance.cyclegan_turbo.cross_view_attention import (  # noqa: E402
    CrossViewAttention,
    MutualSelfAttention,
    chunked_attention,
)


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
def test_never_more_scores_at_once_than_asked_for(monkeypatch, max_scores):
    attn, own, neighbour = layer(), torch.randn(2, 20, 12), torch.randn(7, 12)
    whole = MutualSelfAttention("x", Others(None, neighbour), 10**9)(attn, own)
    counted, of_one_query = [], 3 * 27
    original = torch.nn.functional.scaled_dot_product_attention

    def counting(query, key, value, **options):
        counted.append(query.shape[0] * query.shape[1] * query.shape[2] * key.shape[2])
        return original(query, key, value, **options)

    monkeypatch.setattr(torch.nn.functional, "scaled_dot_product_attention", counting)
    found = MutualSelfAttention("x", Others(None, neighbour), max_scores)(attn, own)
    assert max(counted) <= max(max_scores, of_one_query)
    assert sum(counted) == 3 * 20 * 20 + 3 * 20 * 27
    torch.testing.assert_close(found, whole)


@torch.inference_mode()
def test_chunks_of_three_large_views_stay_below_the_default(monkeypatch):
    # SD-Turbo's finest layer at 512 px: 5 heads, 4096 tokens, two neighbours. Only shapes are computed.
    query, key = (torch.empty(1, 5, n, 64, device="meta") for n in (4096, 3 * 4096))
    counted = []

    def counting(query, key, value, **options):
        counted.append(query.shape[1] * query.shape[2] * key.shape[2])
        return query

    monkeypatch.setattr(torch.nn.functional, "scaled_dot_product_attention", counting)
    chunked_attention(query, key, key, 0.125, CrossViewAttention().max_scores)
    assert sum(counted) == 5 * 4096 * 3 * 4096
    assert 4 * max(counted) <= 256 * 2**20
