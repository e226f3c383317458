"""Pixels of recorded images as display color, and back into the encoding that they had.

Facts: sensor_msgs/image_encodings.hpp of github.com/ros2/common_interfaces.
"""

import io
from collections.abc import Callable, Mapping

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ..io.images import opened_image
from .messages import ImageMessage

Colors = UInt8[np.ndarray, "h w 3"]
_JPEG_QUALITY = 95
_CHANNELS: Mapping[str, str] = {
    "rgb8": "RGB", "bgr8": "BGR", "8UC3": "BGR", "rgba8": "RGBA", "bgra8": "BGRA", "mono8": "L", "8UC1": "L",
}  # fmt: skip
"""Order of the channels of plain encodings; L is gray."""

_BAYER = ("RGGB", "BGGR", "GBRG", "GRBG")
_YUV422: Mapping[str, tuple[int, int]] = {
    name: (from_yuv, to_yuv)
    for names, from_yuv, to_yuv in (
        (("uyvy", "yuv422"), cv2.COLOR_YUV2RGB_UYVY, cv2.COLOR_RGB2YUV_UYVY),
        (("yuyv", "yuv422_yuy2"), cv2.COLOR_YUV2RGB_YUY2, cv2.COLOR_RGB2YUV_YUY2),
    )
    for name in names
}


def is_picture(image: ImageMessage) -> bool:
    """Return whether an image holds colors that are read: not depth, not 16 bits, not a video."""
    if image.is_compressed:
        words = image.encoding.lower()
        return "depth" not in words and "16" not in words and any(each in words for each in ("jp", "png", "webp"))
    return image.encoding in _CHANNELS or image.encoding in _YUV422 or _bayer_pattern(image) is not None


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
    pixels = _rows(image)
    if image.encoding in _YUV422:
        return np.asarray(cv2.cvtColor(pixels, _YUV422[image.encoding][0]), np.uint8)
    if (pattern := _bayer_pattern(image)) is not None:
        code: int = getattr(cv2, f"COLOR_Bayer{pattern}2RGB")
        return np.asarray(cv2.cvtColor(pixels[..., 0], code), np.uint8)
    order = _CHANNELS[image.encoding]
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
    return image.with_pixels(pixels.tobytes(), pixels.shape[1] * pixels.shape[2])


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
    image: ImageMessage, colors: UInt8[np.ndarray, "h w 3"], before: UInt8[np.ndarray, "h w c"]
) -> UInt8[np.ndarray, "h w c"]:
    if image.encoding in _YUV422:
        return np.asarray(cv2.cvtColor(colors, _YUV422[image.encoding][1]), np.uint8)
    if (pattern := _bayer_pattern(image)) is not None:
        # Colors at the border are interpolated: only their change is written.
        mosaic, change = before.copy(), colors.astype(np.int16) - colors_of(image)
        for place, channel in enumerate(pattern):
            at = (slice(place // 2, None, 2), slice(place % 2, None, 2))
            mosaic[(*at, 0)] = np.clip(before[(*at, 0)] + change[(*at, "RGB".index(channel))], 0, 255)
        return mosaic
    order = _CHANNELS[image.encoding]
    if order == "L":
        return np.asarray(cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY), np.uint8)[..., None]
    channels = [before[..., order.index("A")] if each == "A" else colors[..., "RGB".index(each)] for each in order]
    return np.stack(channels, axis=-1)


def _rows(image: ImageMessage) -> UInt8[np.ndarray, "h w c"]:
    """Pixels as they are stored, without the padding of rows."""
    channels = 2 if image.encoding in _YUV422 else len(_CHANNELS.get(image.encoding, "L"))
    height, width, step, data = image.height, image.width, image.step, image.data
    if height < 1 or width < 1 or step < width * channels or len(data) < height * step:
        size = f"{width}x{height} px of {image.encoding} with {step} bytes a row"
        raise ValueError(f"{image.topic.name}: says that it is {size}, and has {len(data)} bytes")
    return data[: height * step].reshape(height, step)[:, : width * channels].reshape(height, width, channels)


def _bayer_pattern(image: ImageMessage) -> str | None:
    """Colors of the first two rows and columns of a mosaic of 8 bits, such as RGGB; None without one."""
    word = image.encoding
    pattern = word.removeprefix("bayer_").removesuffix("8").upper()
    return pattern if word.startswith("bayer_") and word.endswith("8") and pattern in _BAYER else None
