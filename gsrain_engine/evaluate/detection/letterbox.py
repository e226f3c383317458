"""Fitting a picture into the input of a detector, and boxes back into the picture."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from .description import DetectorDescription, Fit


@dataclass(frozen=True, slots=True)
class Placement:
    """Where in the input a picture lies: its own sizes and those it got, the corner it starts at; all in pixels."""

    picture_width: int
    picture_height: int
    width: int
    height: int
    left: int
    top: int

    def in_picture(self, boxes: Float32[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n 4"]:
        """Boxes x1 y1 x2 y2 of the input in pixels of the picture, cut off at its edges."""
        scale = np.array([self.picture_width / self.width, self.picture_height / self.height] * 2)
        corner = np.array([self.left, self.top] * 2)
        limits = np.array([self.picture_width, self.picture_height] * 2)
        return np.clip((boxes - corner) * scale, 0.0, limits)


def placed(picture: tuple[int, int], size: tuple[int, int], fit: Fit) -> Placement:
    """Place a picture of (width, height) in an input of (width, height).

    Bars around the picture differ by at most a pixel, the larger one right and below.
    """
    (picture_width, picture_height), (width, height) = picture, size
    if fit == "stretch":
        return Placement(picture_width, picture_height, width, height, 0, 0)
    scale = min(width / picture_width, height / picture_height)
    inner_width = min(width, max(1, round(picture_width * scale)))
    inner_height = min(height, max(1, round(picture_height * scale)))
    left, top = (width - inner_width) // 2, (height - inner_height) // 2
    if fit == "letterbox_corner":
        left = top = 0
    return Placement(picture_width, picture_height, inner_width, inner_height, left, top)


def network_input(
    image: UInt8[np.ndarray, "h w 3"], placement: Placement, size: tuple[int, int], description: DetectorDescription
) -> Float32[np.ndarray, "1 3 hi wi"]:
    """The picture (RGB) as a detector of input `size` (width, height) takes it.

    Enlarged and reduced bilinearly and without smoothing, as the detectors' own programs do.
    """
    canvas = np.full((size[1], size[0], 3), description.padding, np.uint8)
    inner = cv2.resize(image, (placement.width, placement.height), interpolation=cv2.INTER_LINEAR)
    rows = slice(placement.top, placement.top + placement.height)
    canvas[rows, placement.left : placement.left + placement.width] = inner
    ordered = canvas if description.channels == "rgb" else canvas[..., ::-1]
    values = ordered.astype(np.float32) * np.float32(description.scale)
    values = (values - np.array(description.mean, np.float32)) / np.array(description.deviation, np.float32)
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None])
