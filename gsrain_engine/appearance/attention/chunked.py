"""Attention whose memory is bounded: queries come in chunks."""

from importlib import import_module
from typing import Any

torch: Any = import_module("torch")

Tensor = Any


def attended(query: Tensor, key: Tensor, value: Tensor, scale: float, most_scores: int) -> Tensor:
    """Return softmax(scale query key^T) value of (b, heads, tokens, d) tensors.

    The keys' number may differ from the queries'. Not more than `most_scores` scores (b x heads x queries x keys)
    exist at once, whatever kernel torch takes, as long as those of one query do not exceed it.
    """
    scores_per_query = query.shape[0] * query.shape[1] * key.shape[2]
    chunk = max(most_scores // max(scores_per_query, 1), 1)
    parts = [
        torch.nn.functional.scaled_dot_product_attention(part, key, value, scale=scale)
        for part in query.split(chunk, dim=2)
    ]
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=2)
