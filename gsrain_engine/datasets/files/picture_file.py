"""Reads pictures of a data set, and tells cheaply whether one is there, whole, and of which size."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Shaped, UInt8
from PIL import Image, ImageOps, UnidentifiedImageError

from ..capture import CaptureError

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
"""Names of pictures end with one of these, in small or capital letters."""

_TAIL_BYTES = 1 << 16
_JPEG_END, _PNG_END = b"\xff\xd9", b"IEND"
_BROKEN = (OSError, UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError)
_WITH_EXIF = ("JPEG", "MPO", "WEBP", "TIFF")
"""Formats whose turn stands before the pixels: a PNG would have to be read to its end."""
_EXIF_ORIENTATION, _SIDEWAYS = 0x0112, (5, 6, 7, 8)


def is_picture(path: Path) -> bool:
    """Whether a name is that of a picture."""
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".")


def pictures_in(folder: Path) -> list[Path]:
    """Pictures directly in a folder, by name; none where there is no such folder."""
    return sorted(file for file in folder.iterdir() if is_picture(file) and file.is_file()) if folder.is_dir() else []


def picture_size(file: Path, upright: bool = False) -> tuple[int, int]:
    """Width and height in pixels, from the file's head; its end is looked at, too, so that a cut file is found.

    `upright` gives the size as a person looks at it (EXIF). Raises `CaptureError` for what is no whole picture.
    """
    try:
        with Image.open(file) as picture:
            width, height = picture.size
            whole = _ends(file, picture.format)
            turned = upright and picture.format in _WITH_EXIF and picture.getexif().get(_EXIF_ORIENTATION) in _SIDEWAYS
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such picture") from None
    except _BROKEN as error:
        raise CaptureError(f"{file}: not a readable picture ({error})") from None
    if not whole:
        raise CaptureError(f"{file}: the picture is cut off; its end is missing")
    return (height, width) if turned else (width, height)


def read_color(file: Path, upright: bool = False) -> UInt8[np.ndarray, "h w 3"]:
    """Read a picture as display colour, as the sensor lay unless `upright`; `CaptureError` where it can't be read."""
    try:
        with Image.open(file) as opened:
            picture = ImageOps.exif_transpose(opened) if upright and opened.format in _WITH_EXIF else opened
            if picture.mode.startswith(("I", "F")):
                return np.repeat(_eight_bits(np.asarray(picture))[..., None], 3, axis=2)
            return np.array(picture.convert("RGB"), np.uint8)
    except _BROKEN as error:
        raise CaptureError(f"{file}: not a readable picture ({error})") from None


def read_labels(file: Path) -> UInt8[np.ndarray, "h w"]:
    """Read a picture of one channel (of several, the first) as it is stored, palettes as their indices."""
    stored = read_stored(file)
    first = stored if stored.ndim == 2 else stored[..., 0]
    if first.dtype != np.bool_ and (first.min(initial=0) < 0 or first.max(initial=0) > 255):
        raise CaptureError(f"{file}: holds values outside 0..255")
    return first.astype(np.uint8)


def read_stored(file: Path) -> Shaped[np.ndarray, "h w ..."]:
    """Read the numbers of a picture as they are stored: 16-bit depth, palette indices, all channels."""
    try:
        with Image.open(file) as picture:
            return np.array(picture)
    except _BROKEN as error:
        raise CaptureError(f"{file}: not a readable picture ({error})") from None


def read_mask(file: Path) -> Bool[np.ndarray, "h w"]:
    """Read a black and white picture: True where it is not black."""
    return read_labels(file) > 0


def _eight_bits(values: np.ndarray) -> UInt8[np.ndarray, "h w"]:
    """The upper byte of 16-bit grey."""
    return (np.clip(values.astype(np.float64), 0, 65535) / 257 + 0.5).astype(np.uint8)


def _ends(file: Path, kind: str | None) -> bool:
    end = {"JPEG": _JPEG_END, "PNG": _PNG_END}.get(kind or "")
    if end is None:
        return True
    with file.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(size - _TAIL_BYTES, 0))
        if end in stream.read():
            return True
        stream.seek(0)
        return kind == "JPEG" and end in stream.read()  # phones put a film behind the picture
