"""Pixels of recorded images as display color, and back into the encoding that they had.

Facts: sensor_msgs/image_encodings.hpp of github.com/ros2/common_interfaces.
"""

import io
import re
from collections.abc import Callable, Mapping

import cv2
import numpy as np
from jaxtyping import Int16, Shaped, UInt8
from PIL import Image

from ..io.images import opened_image
from .messages import ImageMessage

Colors = UInt8[np.ndarray, "h w 3"]
_JPEG_QUALITY = 95
_CHANNELS: Mapping[str, str] = {
    "rgb8": "RGB", "bgr8": "BGR", "8uc3": "BGR", "rgba8": "RGBA", "bgra8": "BGRA", "mono8": "L", "8uc1": "L",
    "mono16": "L",
}  # fmt: skip
"""Order of the channels of plain encodings; L is gray."""

_BAYER = ("RGGB", "BGGR", "GBRG", "GRBG")
_FINE = 257  # 65535 / 255: steps of 16 bits in one of 8
_YUV420: Mapping[str, tuple[int, int]] = {"nv12": (cv2.COLOR_YUV2RGB_NV12, 1), "nv21": (cv2.COLOR_YUV2RGB_NV21, -1)}
"""Conversion, and the order of the two chroma values (1: U first), of which each four pixels have one pair."""

_YUV422: Mapping[str, tuple[int, int]] = {
    name: (from_yuv, to_yuv)
    for names, from_yuv, to_yuv in (
        (("uyvy", "yuv422"), cv2.COLOR_YUV2RGB_UYVY, cv2.COLOR_RGB2YUV_UYVY),
        (("yuyv", "yuv422_yuy2"), cv2.COLOR_YUV2RGB_YUY2, cv2.COLOR_RGB2YUV_YUY2),
    )
    for name in names
}


def is_picture(image: ImageMessage) -> bool:
    """Return whether an image holds colors that are read: not depth, not a video."""
    if image.is_compressed:
        words = image.encoding.lower()
        return "depth" not in words and "16" not in words and any(each in words for each in ("jp", "png", "webp"))
    name = _encoding(image)
    return name in _CHANNELS or name in _YUV422 or name in _YUV420 or _bayer_pattern(image) is not None


def size_of(image: ImageMessage) -> tuple[int, int]:
    """Width and height; raises `CaptureError` for a compressed picture that can't be read."""
    if not image.is_compressed:
        return image.width, image.height
    with opened_image(image.data.tobytes(), image.topic.name) as picture:
        return picture.size


def colors_of(image: ImageMessage) -> UInt8[np.ndarray, "h w 3"]:
    """Decode the pixels; raises ValueError, also for sizes that its bytes don't have."""
    if image.is_compressed:
        with opened_image(image.data.tobytes(), image.topic.name) as picture:
            return np.array(picture.convert("RGB"), np.uint8)
    name, pixels = _encoding(image), _rows(image)
    if name in _YUV422:
        return np.asarray(cv2.cvtColor(pixels, _YUV422[name][0]), np.uint8)
    if name in _YUV420:
        return np.asarray(cv2.cvtColor(pixels, _YUV420[name][0]), np.uint8)
    if pixels.dtype != np.uint8:
        pixels = ((pixels.astype(np.uint32) + _FINE // 2) // _FINE).astype(np.uint8)
    if (pattern := _bayer_pattern(image)) is not None:
        code: int = getattr(cv2, f"COLOR_Bayer{pattern}2RGB")
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., 0]), code), np.uint8)
    order = _CHANNELS[name]
    return np.stack([pixels[..., 0 if order == "L" else order.index(each)] for each in "RGB"], axis=-1)


def with_colors(image: ImageMessage, change: Callable[[Colors], Colors]) -> bytes | None:
    """Encode the message with changed colors, in the encoding and size that it has; raises ValueError.

    None if `change` returns the array that it was given.
    """
    before = colors_of(image)
    colors = change(before)
    if colors is before:
        return None
    if image.is_compressed:
        return image.with_pixels(_compressed(image, colors))
    pixels = np.ascontiguousarray(_encoded(image, colors, _rows(image)))
    return image.with_pixels(pixels.tobytes(), pixels.shape[1] * pixels.shape[2] * pixels.itemsize)


def _compressed(image: ImageMessage, colors: UInt8[np.ndarray, "h w 3"]) -> bytes:
    with opened_image(image.data.tobytes(), image.topic.name) as picture:
        form, mode = picture.format, picture.mode
    options = {"quality": _JPEG_QUALITY, "subsampling": 0} if form in ("JPEG", "MPO") else {}
    stream = io.BytesIO()
    changed = Image.fromarray(colors)
    changed = changed.convert("L") if mode == "L" else changed
    changed.save(stream, format="JPEG" if form == "MPO" else form, **options)
    return stream.getvalue()


def _encoded(
    image: ImageMessage, colors: UInt8[np.ndarray, "h w 3"], before: Shaped[np.ndarray, "r w c"]
) -> Shaped[np.ndarray, "r w c"]:
    name = _encoding(image)
    if name in _YUV422:
        return np.asarray(cv2.cvtColor(colors, _YUV422[name][1]), np.uint8)
    if name in _YUV420:
        return _subsampled(colors, _YUV420[name][1])
    if (pattern := _bayer_pattern(image)) is not None:
        # Colors at the border are interpolated: only their change is written.
        mosaic, change = before.copy(), colors.astype(np.int16) - colors_of(image)
        for place, channel in enumerate(pattern):
            at = (slice(place // 2, None, 2), slice(place % 2, None, 2))
            mosaic[(*at, 0)] = _changed(before[(*at, 0)], change[(*at, "RGB".index(channel))])
        return mosaic
    order = _CHANNELS[name]
    if order == "L":
        gray = np.asarray(cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY), np.uint8)
        if before.dtype == np.uint8:
            return gray[..., None]
        return _changed(before[..., 0], gray.astype(np.int16) - colors_of(image)[..., 0])[..., None]
    channels = [before[..., order.index("A")] if each == "A" else colors[..., "RGB".index(each)] for each in order]
    return np.stack(channels, axis=-1)


def _changed(before: Shaped[np.ndarray, "h w"], change: Int16[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    """Add a change of 8 bits to values of 8 or 16 bits, whose own steps stay."""
    bounds = np.iinfo(before.dtype)
    wider = change.astype(np.int32) * (1 if bounds.bits == 8 else _FINE)
    return np.clip(before.astype(np.int32) + wider, 0, bounds.max).astype(before.dtype)


def _subsampled(colors: UInt8[np.ndarray, "h w 3"], order: int) -> UInt8[np.ndarray, "r w 1"]:
    """Rows of brightness, and below them half as many rows of pairs of chroma values."""
    height, width = colors.shape[:2]
    planes = np.asarray(cv2.cvtColor(colors, cv2.COLOR_RGB2YUV_I420), np.uint8).reshape(-1)
    chroma = planes[height * width :].reshape(2, -1)[::order]
    return np.concatenate([planes[: height * width], chroma.T.ravel()]).reshape(-1, width, 1)


def _rows(image: ImageMessage) -> Shaped[np.ndarray, "r w c"]:
    """Pixels as they are stored, without the padding of rows; three rows for two of the picture in YUV 4:2:0."""
    name = _encoding(image)
    channels = 2 if name in _YUV422 else len(_CHANNELS.get(name, "L"))
    kind = np.dtype(f"{'>' if image.is_bigendian else '<'}u2") if name.endswith("16") else np.dtype(np.uint8)
    height, width, step, data = image.height, image.width, image.step, image.data
    is_odd = name in _YUV420 and bool(height % 2 or width % 2)
    rows, row = height + height // 2 if name in _YUV420 else height, width * channels * kind.itemsize
    if height < 1 or width < 1 or is_odd or step < row or len(data) < rows * step:
        size = f"{width}x{height} px of {image.encoding} with {step} bytes a row"
        raise ValueError(f"{image.topic.name}: says that it is {size}, and has {len(data)} bytes")
    inner = np.ascontiguousarray(data[: rows * step].reshape(rows, step)[:, :row])
    return inner.view(kind).reshape(rows, width, channels)


def _encoding(image: ImageMessage) -> str:
    """Encoding of plain pixels; drivers write some in upper case."""
    return image.encoding.lower()


def _bayer_pattern(image: ImageMessage) -> str | None:
    """Colors of the first two rows and columns of a mosaic, such as RGGB; None without one."""
    found = re.fullmatch("bayer_([bgr]{4})(8|16)", _encoding(image))
    pattern = "" if found is None else found[1].upper()
    return pattern if pattern in _BAYER else None
