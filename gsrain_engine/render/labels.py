"""The label pass: which layer or actor each pixel shows, and the legend that goes with it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt16

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Actor, Part
from gsrain_engine.scene.scene import Scene

from .renderer import Renderer

_LEAST_ALPHA = 0.5
"""Pixels that the scene covers less than this show nothing, as they have no depth."""


def draw_labels(renderer: Renderer, scene: Scene, camera: Camera, time_s: float) -> UInt16[np.ndarray, "h w"]:
    """Label each pixel with the member that has the largest share in its colour: 1 is the first member, 0 is nothing.

    Three members at a time are drawn in pure red, green and blue, the others in black: a channel is then a member's
    blending weight. Rain takes no part in it.
    """
    shown = [
        (number, part)
        for number, member in enumerate(scene.members, start=1)
        if member.visible and (part := scene.part(member, time_s)) is not None
    ]
    labels = np.zeros((camera.height, camera.width), np.uint16)
    largest = np.zeros((camera.height, camera.width), np.float32)
    for first in range(0, len(shown), 3):
        renderer.draw(_in_signal_colors([part for _, part in shown], first), camera)
        rgba = renderer.read().rgba
        for channel, (number, _) in enumerate(shown[first : first + 3]):
            weight = np.where(rgba[..., 3] >= _LEAST_ALPHA, rgba[..., channel], np.float32(0))
            labels[weight > largest] = number
            largest = np.maximum(largest, weight)
    return labels


def legend(scene: Scene) -> dict[str, Any]:
    """What the labels of a scene mean, as plain values: the same for every frame."""
    return {
        "0": {"name": "", "kind": "nothing"},
        **{
            str(number): {"name": member.name, "kind": "actor", "class": member.class_name}
            if isinstance(member, Actor)
            else {"name": member.name, "kind": member.kind}
            for number, member in enumerate(scene.members, start=1)
        },
    }


def _in_signal_colors(parts: Sequence[Part], first: int) -> list[Part]:
    """Parts `first`, `first + 1` and `first + 2` in red, green and blue, all others in black."""
    return [part._replace(colors=only_channel(number - first)) for number, part in enumerate(parts)]


def only_channel(channel: int) -> Float64[np.ndarray, "3 4"]:
    """Colour change to one pure colour, whatever the colour was; black for channels that don't exist."""
    change = np.zeros((3, 4))
    if 0 <= channel < 3:
        change[channel, 3] = 1.0
    return change
