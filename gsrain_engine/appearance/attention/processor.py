"""Self-attention that also looks at other views: a processor for diffusers' `Attention`."""

from importlib import import_module
from typing import Any, Protocol, runtime_checkable

from .chunked import attended

torch: Any = import_module("torch")
diffusers_attention: Any = import_module("diffusers.models.attention_processor")

Tensor = Any


@runtime_checkable
class LooksAround(Protocol):
    """Knows what the queries of a layer may look at besides their own view."""

    def looked_at(self, layer: str, features: Tensor) -> list[Tensor | None]:
        """Return for each entry of (b, tokens, channels) features of other views, (more tokens, channels), or None."""
        ...


class MutualSelfAttention:
    """Mutual self-attention, eq. (16)-(19): a view's queries, keys and values of neighbours warped onto it and its own.

    All else is as diffusers' `AttnProcessor2_0`. Tokens without a place in the neighbour are left out, which is what a
    mask with minus infinity does; warped zeros would have weight e^0. Entries with nothing to look at get plain
    attention.
    """

    def __init__(self, layer: str, around: LooksAround, most_scores: int) -> None:
        self.layer, self.around, self.most_scores = layer, around, most_scores
        self._plain = diffusers_attention.AttnProcessor2_0()

    def __call__(
        self,
        attn: Any,
        hidden_states: Tensor,
        encoder_hidden_states: Tensor | None = None,
        attention_mask: Tensor | None = None,
        temb: Tensor | None = None,
    ) -> Tensor:
        """Attend over (b, tokens, channels) or (b, channels, h, w) features; returns the same shape."""
        if encoder_hidden_states is not None or attention_mask is not None:
            return self._plain(attn, hidden_states, encoder_hidden_states, attention_mask, temb)
        residual = hidden_states
        if attn.spatial_norm is not None:
            hidden_states = attn.spatial_norm(hidden_states, temb)
        shape = hidden_states.shape
        if len(shape) == 4:
            hidden_states = hidden_states.flatten(2).transpose(1, 2)
        if attn.group_norm is not None:
            hidden_states = attn.group_norm(hidden_states.transpose(1, 2)).transpose(1, 2)
        found = self._attended(attn, hidden_states).to(hidden_states.dtype)
        found = attn.to_out[1](attn.to_out[0](found))
        if len(shape) == 4:
            found = found.transpose(1, 2).reshape(shape)
        if attn.residual_connection:
            found = found + residual
        return found / attn.rescale_output_factor

    def _attended(self, attn: Any, features: Tensor) -> Tensor:
        others = self.around.looked_at(self.layer, features)
        query = _heads(attn, attn.to_q(features), attn.norm_q)
        key, value = _keys(attn, features)
        if all(other is None for other in others):
            return _joined(attended(query, key, value, attn.scale, self.most_scores))
        outputs: list[Tensor] = []
        for i, other in enumerate(others):
            q, k, v = query[i : i + 1], key[i : i + 1], value[i : i + 1]
            if other is not None:
                other_k, other_v = _keys(attn, other[None])
                k, v = torch.cat([other_k, k], dim=2), torch.cat([other_v, v], dim=2)
            outputs.append(attended(q, k, v, attn.scale, self.most_scores))
        return _joined(torch.cat(outputs))


def _keys(attn: Any, features: Tensor) -> tuple[Tensor, Tensor]:
    """Keys and values. They are linear: those of warped features are the warped ones."""
    return _heads(attn, attn.to_k(features), attn.norm_k), _heads(attn, attn.to_v(features), None)


def _heads(attn: Any, projected: Tensor, norm: Any) -> Tensor:
    """(b, tokens, heads x d) as (b, heads, tokens, d)."""
    split = projected.unflatten(-1, (attn.heads, -1)).transpose(1, 2)
    return split if norm is None else norm(split)


def _joined(found: Tensor) -> Tensor:
    """(b, heads, tokens, d) as (b, tokens, heads x d)."""
    return found.transpose(1, 2).flatten(2)
