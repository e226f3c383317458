"""Unit quaternions without their largest component, as several scene formats store them."""

import numpy as np
from jaxtyping import Float32, Integer

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Components that are stored, in order, when the largest is component 0, 1, 2 or 3."""


def with_largest(largest: Integer[np.ndarray, " n"], others: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 4"]:
    """Put the largest component, which is never negative, back in its place (0..3) among the three others.

    Where the three are together longer than 1, which only damage and rounding do, the largest becomes 0.
    """
    quaternions = np.empty((len(others), 4), np.float32)
    np.put_along_axis(quaternions, OTHERS[largest], others, axis=1)
    rest = np.sqrt(np.maximum(0, 1 - np.einsum("ij,ij->i", others, others)))
    np.put_along_axis(quaternions, largest[:, None].astype(np.intp), rest[:, None], axis=1)
    return quaternions


def without_largest(
    quaternions: Float32[np.ndarray, "n 4"],
) -> tuple[Integer[np.ndarray, " n"], Float32[np.ndarray, "n 3"]]:
    """Index of the largest component and the three others, with the signs that make the largest positive."""
    largest = np.abs(quaternions).argmax(axis=1)
    signs = np.where(np.take_along_axis(quaternions, largest[:, None], axis=1) < 0, np.float32(-1), np.float32(1))
    return largest, np.take_along_axis(quaternions, OTHERS[largest], axis=1) * signs
