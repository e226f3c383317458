"""Overlap of boxes, and keeping one box where several lie over each other."""

import numpy as np
from jaxtyping import Float, Float64, Int

Boxes = Float[np.ndarray, "_ 4"]
"""Rows x1 y1 x2 y2."""


def intersection_over_union(
    first: Float[np.ndarray, "n 4"], second: Float[np.ndarray, "m 4"]
) -> Float64[np.ndarray, "n m"]:
    """Area that two boxes share over the area that they cover together: 0..1, 1 for equal boxes (Jaccard index).

    0 where both are empty.
    """
    a, b = first.astype(np.float64)[:, None], second.astype(np.float64)[None]
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    shared = np.prod(np.maximum(sides, 0.0), axis=-1)
    union = _area(a) + _area(b) - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def kept_boxes(
    boxes: Float[np.ndarray, "n 4"],
    confidences: Float[np.ndarray, " n"],
    classes: Int[np.ndarray, " n"],
    most_iou: float,
) -> Int[np.ndarray, " k"]:
    """Rows that stay, the most confident first: greedy non-maximum suppression, each class by itself.

    A box goes where a more confident one of its class overlaps it by more than `most_iou`. Of equally confident ones
    the earlier stays.
    """
    order = np.argsort(-confidences, kind="stable")
    kept: list[int] = []
    while len(order):
        best, order = order[0], order[1:]
        kept.append(int(best))
        overlap = intersection_over_union(boxes[best][None], boxes[order])[0]
        order = order[(overlap <= most_iou) | (classes[order] != classes[best])]
    return np.array(kept, np.int64)


def _area(boxes: Float64[np.ndarray, "*n 4"]) -> Float64[np.ndarray, "*n"]:
    return np.prod(np.maximum(boxes[..., 2:] - boxes[..., :2], 0.0), axis=-1)
