"""Pictures inside a page: data URIs of photographs and of error maps, and the colours that errors are shown in."""

import base64

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

LARGEST_ERROR = 0.25
"""Errors are shown from 0 to here (of 1), on one scale in all reports, so that pages can be compared."""

_JPEG_QUALITY = 88
_LEFT_OUT = (128, 128, 128)
_SHADES = 256


def photograph(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """Return a picture as the data URI of a JPEG."""
    return _data_uri(image, ".jpg", "image/jpeg", [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])


def drawing(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """Return a drawing as the data URI of a PNG, without loss."""
    return _data_uri(image, ".png", "image/png", [])


def error_picture(error: Float32[np.ndarray, "h w"]) -> str:
    """Return the colours of an error map as a data URI; grey where it is NaN."""
    shares = np.nan_to_num(np.clip(error / LARGEST_ERROR, 0, 1))
    colors = _shades()[np.rint(shares * (_SHADES - 1)).astype(int)]
    colors[np.isnan(error)] = _LEFT_OUT
    return photograph(colors)


def color_bar() -> str:
    """Return the colours from no error to the largest, left to right, as a data URI."""
    return _data_uri(_shades()[None], ".png", "image/png", [])


def _shades() -> UInt8[np.ndarray, "shades 3"]:
    from matplotlib import colormaps  # loads slowly, and most who load this module write no page

    colors = colormaps["magma"](np.linspace(0, 1, _SHADES))
    return np.rint(255 * np.asarray(colors)[:, :3]).astype(np.uint8)


def _data_uri(image: UInt8[np.ndarray, "h w 3"], ending: str, kind: str, options: list[int]) -> str:
    _, encoded = cv2.imencode(ending, np.ascontiguousarray(image[..., ::-1]), options)
    return f"data:{kind};base64,{base64.b64encode(encoded.tobytes()).decode()}"
