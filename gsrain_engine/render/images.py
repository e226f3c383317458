"""Image output: PNG, JPEG, OpenEXR and NPY files, written atomically, and color conversions."""

import colorsys
import json
import struct
from collections.abc import Callable, Generator, Mapping, Set
from contextlib import contextmanager, nullcontext
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from jaxtyping import Float32, UInt8, UInt16
from PIL import Image, ImageCms

from ..safe_io.files import whole_file
from ..scene.geometry import linear_to_srgb, srgb_to_linear
from .export_settings import DEFAULT_JPEG_QUALITY, ExportFiles, ExportSettings, Pass, export_files
from .renderer import Frame
from .video import VideoWriter


@contextmanager
def _new_file(path: Path) -> Generator[Path]:
    """Replace a file atomically; creates missing folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        yield partial


_PNG: dict[str, Any] = {"format": "PNG"}


def write_png(path: Path | str, pixels: UInt8[np.ndarray, "h w *c"] | UInt16[np.ndarray, "h w"]) -> None:
    """Write an 8-bit image, or 16-bit gray, as PNG; creates missing folders."""
    with _new_file(Path(path)) as partial:
        Image.fromarray(pixels).save(partial, format="PNG")


def write_image(path: Path, image: Image.Image, jpeg_quality: int | None = None) -> None:
    """Write an image in the format of its suffix, PNG if it is unknown; `jpeg_quality` is 1..100."""
    kind = Image.registered_extensions().get(path.suffix.lower(), "PNG")
    options = {"format": kind} if kind != "JPEG" or jpeg_quality is None else _jpeg_options(jpeg_quality)
    with _new_file(path) as partial:
        image.save(partial, **options)


def jpeg_file(pixels: UInt8[np.ndarray, "h w 3"], quality: int) -> bytes:
    """Return the JPEG file that `write_image` would write of an image."""
    file = BytesIO()
    Image.fromarray(pixels).save(file, **_jpeg_options(quality))
    return file.getvalue()


def _jpeg_options(quality: int) -> dict[str, Any]:
    """Options of Pillow for a JPEG of a quality 1..100, with full-resolution chroma and an sRGB profile.

    The same pixels give the same bytes.
    """
    return {"format": "JPEG", "quality": quality, "subsampling": 0, "optimize": True, "icc_profile": _srgb_profile()}


@cache
def _srgb_profile() -> bytes:
    """Return the ICC profile of sRGB, with a fixed date (bytes 24 to 35 of its header) for reproducible files."""
    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    profile[24:36] = struct.pack(">6H", 2000, 1, 1, 0, 0, 0)
    return bytes(profile)


def write_labels(path: Path, labels: UInt16[np.ndarray, "h w"], count: int) -> None:
    """Write labels 0..count as indexed PNG with distinct colors; more than 255 as 16-bit gray."""
    image = Image.fromarray(labels)
    if count <= 255:
        image = Image.fromarray(labels.astype(np.uint8))
        colors = [(0.0, 0.0, 0.0), *(layer_color(number) for number in range(count))]
        image.putpalette([round(255 * channel) for color in colors for channel in color])
    write_image(path, image)


def _write_array(path: Path, values: Float32[np.ndarray, "..."]) -> None:
    with _new_file(path) as partial, partial.open("wb") as file:
        np.save(file, values, allow_pickle=False)


# OpenEXR


def write_exr(path: Path, frame: Frame, passes: Set[Pass]) -> None:
    """Write the passes of a frame as one EXR file, atomically.

    RGBA are half floats: linear light with sRGB primaries, premultiplied as OpenEXR requires; A alone if only alpha is
    requested. Z is a 32-bit float: meters along the view axis, 0 where empty. Compression is lossless (ZIP). Raises
    `OSError` if it can't be written.
    """
    channels: dict[str, np.ndarray] = {}
    if "color" in passes:
        channels["RGBA"] = np.ascontiguousarray(to_linear_light(frame.rgba).astype(np.float16))
    elif "alpha" in passes:
        channels["A"] = np.ascontiguousarray(frame.rgba[..., 3].astype(np.float16))
    if "depth" in passes and frame.depth is not None:
        channels["Z"] = np.ascontiguousarray(frame.depth)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with _new_file(path) as partial:
        try:
            OpenEXR.File(header, channels).write(str(partial))
        except RuntimeError as error:  # raised by OpenEXR's C++ code for I/O errors
            raise OSError(str(error)) from None


@contextmanager
def open_frame_writer(
    recording: ExportSettings, files: ExportFiles, size_px: tuple[int, int], legend: Mapping[str, Any]
) -> Generator["FrameWriter"]:
    """Open the writer for the frames of one camera; `legend` contains the meaning of the labels.

    Raises `ValueError` for an output that can't be encoded.
    """
    video = nullcontext()
    if files.is_video and "color" in files.passes:
        codec, quality = recording.format, recording.quality
        has_alpha = recording.transparent
        video = VideoWriter(files.path, *size_px, recording.fps, codec=codec, quality=quality, has_alpha=has_alpha)
    with video as opened:
        yield FrameWriter(files, legend, opened, recording.quality, is_transparent=recording.transparent)


def write_still(path: Path | str, frame: Frame) -> None:
    """Write a frame as PNG, JPEG, EXR or NPY, by suffix; byte-identical to an exported still.

    An EXR file also contains the depth if the frame has it; NPY contains premultiplied display colors and alpha.
    Creates missing folders. Raises `ValueError` for another suffix, `OSError` if it can't be written.
    """
    has_depth = frame.depth is not None and Path(path).suffix.lower() == ".exr"
    recording = ExportSettings(output=str(path), passes=("color", "depth") if has_depth else ("color",))
    if not recording.is_still:
        raise ValueError(f"{path}: expected the name of an image, which ends in .png, .jpg, .exr or .npy")
    files = export_files(recording, None, is_clear=False)
    with open_frame_writer(recording, files, (frame.rgba.shape[1], frame.rgba.shape[0]), {}) as sink:
        sink.write(0, frame)


class FrameWriter:
    """Writes the frames of one camera; still files are written atomically."""

    def __init__(
        self,
        files: ExportFiles,
        legend: Mapping[str, Any],
        video: VideoWriter | None,
        quality: int | None,
        *,
        is_transparent: bool = False,
    ) -> None:
        """`quality` applies to JPEG."""
        self._is_transparent = is_transparent
        self._files, self._legend, self._video = files, legend, video
        is_jpeg = files.format == "jpeg"
        self._image_options = _jpeg_options(DEFAULT_JPEG_QUALITY if quality is None else quality) if is_jpeg else _PNG
        self._has_legend = False

    @property
    def takes_bytes(self) -> bool:
        """True if bytes of the color are all that is written."""
        is_bytes = self._video is not None or self._files.format in ("png", "jpeg")
        return is_bytes and not self._is_transparent and self._files.passes <= {"color", "labels"}

    def write(
        self,
        number: int,
        frame: Frame | UInt8[np.ndarray, "h w 3"] | None,
        labels: UInt16[np.ndarray, "h w"] | None = None,
    ) -> None:
        """Write a frame of a sequence: depth as 16-bit PNG in cm (0 is empty, at most 655.35 m), alpha as gray PNG.

        Raises `OSError` if it can't be written.
        """
        if isinstance(frame, np.ndarray):
            self._write_bytes(number, frame)
        elif frame is not None and self._files.format == "exr":
            write_exr(self._files.color(number), frame, self._files.passes)
        elif frame is not None:
            if self._video is not None or ("color" in self._files.passes and self._files.format in ("png", "jpeg")):
                self._write_bytes(number, frame.to_rgba8() if self._is_transparent else frame.to_uint8())
            elif "color" in self._files.passes:
                _write_array(self._files.color(number), frame.rgba)
            self._write_passes(number, frame)
        if labels is not None:
            write_labels(self._files.pass_file(number, "labels"), labels, len(self._legend) - 1)
            if not self._has_legend:
                with _new_file(self._files.legend) as partial:
                    partial.write_text(json.dumps(self._legend, indent=1) + "\n", encoding="utf-8")
                self._has_legend = True

    def _write_bytes(self, number: int, image: UInt8[np.ndarray, "h w c"]) -> None:
        if self._video is not None:
            self._video.write(image)
        else:
            with _new_file(self._files.color(number)) as partial:
                Image.fromarray(image).save(partial, **self._image_options)

    def _write_passes(self, number: int, frame: Frame) -> None:
        """Write depth and alpha."""
        if "depth" in self._files.passes and frame.depth is not None:
            path = self._files.pass_file(number, "depth")
            if self._files.format == "npy":
                _write_array(path, frame.depth)
            else:
                write_png(path, np.rint(np.clip(frame.depth * 100, 0, 65535)).astype(np.uint16))
        if "alpha" in self._files.passes:
            alpha = np.rint(np.clip(frame.rgba[..., 3], 0, 1) * 255).astype(np.uint8)
            write_png(self._files.pass_file(number, "alpha"), alpha)


# Display and linear-light colors


def to_linear_light(rgba: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w 4"]:
    """Convert premultiplied display colors to premultiplied linear light; decodes the color, not the product."""
    return _straight(rgba, srgb_to_linear)


def to_display(light: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w 4"]:
    """Convert premultiplied linear light to premultiplied display colors."""
    return _straight(light, linear_to_srgb)


def _straight(rgba: Float32[np.ndarray, "h w 4"], curve: Callable[[Any], Any]) -> Float32[np.ndarray, "h w 4"]:
    alpha = np.maximum(rgba[..., 3:], np.float32(1e-6))
    return np.concatenate([curve(rgba[..., :3] / alpha) * alpha, rgba[..., 3:]], axis=-1, dtype=np.float32)


# Color maps
# The same as in common_heat.glsl.

_COEFFICIENTS = np.array([
    [0.13572138, 0.09140261, 0.10667330], [4.61539260, 2.19418839, 12.64194608],
    [-42.66032258, 4.84296658, -60.58204836], [132.13108234, -14.18503333, 110.36276771],
    [-152.94239396, 4.27729857, -89.90310912], [59.28637943, 2.82956604, 27.34824973],
], np.float32)  # fmt: skip


def turbo_colors(numbers: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n 3"]:
    """Color map "turbo" of numbers in 0..1 (Mikhailov 2019), a polynomial of degree 5 per channel."""
    t = np.clip(numbers, 0, 1)[..., None]
    color = np.broadcast_to(_COEFFICIENTS[-1], (*numbers.shape, 3))
    for coefficients in _COEFFICIENTS[-2::-1]:
        color = color * t + coefficients
    return np.clip(color, 0, 1)


def layer_color(number: int) -> tuple[float, float, float]:
    """Color of layer or actor 0, 1, 2...: hues a golden angle apart, with alternating brightness."""
    return colorsys.hsv_to_rgb((0.6 + number * 0.61803399) % 1.0, 0.65, (0.95, 0.75, 0.55)[number % 3])
