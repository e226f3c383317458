"""Image files of datasets: listing, size, completeness, and decoding as color, labels or masks."""

import io
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Shaped, UInt8
from PIL import Image, ImageOps, UnidentifiedImageError

from ...safe_io.file_kinds import kind_of_bytes, kind_of_file
from ...safe_io.limits import InputError, check_expansion, open_file
from ..capture import CaptureError

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
"""Suffixes of readable images, in lowercase."""

_UNREAD_SUFFIXES = (
    ".heic", ".heif", ".avif", ".gif", ".jxl", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2",
)  # fmt: skip
"""Suffixes of images that must be converted first."""

CONVERT = "of formats that can't be read (convert them to JPEG or PNG)"
"""Description of such images in messages."""

_MAX_BYTES, _TAIL_BYTES = 1 << 31, 1 << 16
_ENDS = {"JPEG": b"\xff\xd9", "PNG": b"IEND"}
_BYTES_OF_A_PIXEL = {"1": 1, "L": 1, "P": 1, "I;16": 2, "I;16B": 2, "I;16L": 2}
"""Bytes a pixel of Pillow's modes; all others have four."""

_LONGEST_PX = 16384  # maximum side of a camera image, as for all cameras
_WITH_EXIF = ("JPEG", "MPO", "WEBP", "TIFF")
"""Formats that store the orientation before the pixels; a PNG would have to be read to its end."""

_BACKGROUND = "white"
"""Background of transparent images, as in viewers and in nerfstudio's reader of NeRF's synthetic scenes."""

_EXIF_ORIENTATION, _SIDEWAYS = 0x0112, (5, 6, 7, 8)


def is_image(path: Path, suffixes: tuple[str, ...] = SUFFIXES) -> bool:
    return path.suffix.lower() in suffixes and not path.name.startswith(".")


def images_in(folder: Path) -> list[Path]:
    """Images directly in a folder, by name; empty if the folder does not exist."""
    return sorted(file for file in folder.iterdir() if is_image(file) and file.is_file()) if folder.is_dir() else []


def unread_images_in(folder: Path) -> list[Path]:
    """Images directly in a folder, by name, of unreadable formats: HEIC of phones, raw files of cameras."""
    return sorted(file for file in folder.iterdir() if is_image(file, _UNREAD_SUFFIXES)) if folder.is_dir() else []


def name_on_disk(folder: Path, name: str) -> str:
    """Name of a file below a folder for a name that another system wrote; the name itself if there is none.

    Backslashes separate folders; of an absolute path of another machine, the longest end that exists counts;
    images may have another suffix (.JPG for .jpg or .png), or lack it in the name, as Blender's do.
    """
    if "\0" in name or _is_file(folder / name):
        return name
    parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
    is_absolute = name.startswith(("/", "\\")) or bool(parts and parts[0].endswith(":"))
    for start in range(len(parts) if is_absolute else min(len(parts), 1)):
        below = "/".join(parts[start:])
        stem, dot, suffix = below.rpartition(".")
        is_suffixed = f"{dot}{suffix}".lower() in SUFFIXES
        bare = stem if is_suffixed else below
        spellings = sorted(SUFFIXES, key=lambda each: each != f".{suffix}".lower())  # the stated format first
        guesses = [below, *(f"{bare}{each}" for own in spellings for each in (own, own.upper()))]
        found = next((guess for guess in guesses if _is_file(folder / guess)), None)
        if found is not None:
            return found
    return name


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # name too long
        return False


def oriented_size(file: Path, size: tuple[int, int], tolerance: float = 0.0) -> tuple[tuple[int, int], bool]:
    """Width and height of an image for a camera of (width, height), and whether its EXIF orientation applies.

    It does if only then the proportions are the camera's, to a pixel or relative `tolerance`: programs that turn the
    image calibrate the upright one. Raises `CaptureError`.
    """

    def fits(found: tuple[int, int]) -> bool:
        off = abs(found[0] * size[1] - found[1] * size[0])
        return off <= max(*size, tolerance * found[0] * size[1])

    stored = image_size(file)
    if fits(stored):
        return stored, False
    upright = image_size(file, upright=True)
    return (upright, True) if fits(upright) else (stored, False)


def image_size(file: Path, upright: bool = False) -> tuple[int, int]:
    """Width and height in pixels from the file's header; also checks the file's end to detect truncation.

    `upright` applies the EXIF orientation. Raises `CaptureError` for an incomplete image.
    """
    with opened_image(file, str(file)) as picture:
        width, height = picture.size
        whole = _ends(file, picture.format)
        turned = upright and picture.format in _WITH_EXIF and picture.getexif().get(_EXIF_ORIENTATION) in _SIDEWAYS
    if not whole:
        raise CaptureError(f"{file}: the picture is cut off; its end is missing")
    return (height, width) if turned else (width, height)


def read_color(file: Path, upright: bool = False) -> UInt8[np.ndarray, "h w 3"]:
    """Read an image as display color, in sensor orientation unless `upright`, with transparent pixels over white.

    Raises `CaptureError` if it can't be read.
    """
    with opened_image(file, str(file)) as opened:
        picture = ImageOps.exif_transpose(opened) if upright and opened.format in _WITH_EXIF else opened
        if picture.mode.startswith(("I", "F")):
            values = np.asarray(picture).astype(np.float64)  # 16-bit gray
            gray = (np.clip(np.nan_to_num(values), 0, 65535) / 257 + 0.5).astype(np.uint8)
            return np.repeat(gray[..., None], 3, axis=2)
        if picture.has_transparency_data:  # fully transparent pixels may have any color
            clear = picture.convert("RGBA")
            picture = Image.alpha_composite(Image.new("RGBA", clear.size, _BACKGROUND), clear)
        return np.array(picture.convert("RGB"), np.uint8)


def read_labels(file: Path) -> UInt8[np.ndarray, "h w"]:
    """Read an image of one channel (or the first of several) as stored, palettes as their indices."""
    stored = read_stored(file)
    first = stored if stored.ndim == 2 else stored[..., 0]
    if first.dtype != np.bool_ and (first.min(initial=0) < 0 or first.max(initial=0) > 255):
        raise CaptureError(f"{file}: holds values outside 0..255")
    return first.astype(np.uint8)


def read_stored(file: Path) -> Shaped[np.ndarray, "h w ..."]:
    """Read an image's stored numbers: 16-bit depth, palette indices, all channels."""
    with opened_image(file, str(file)) as picture:
        return np.array(picture)


def read_mask(file: Path) -> Bool[np.ndarray, "h w"]:
    """Read a black and white image: True if not black."""
    return read_labels(file) > 0


@contextmanager
def opened_image(source: Path | bytes, name: str) -> Generator[Image.Image]:
    """Open an image file or its bytes; pixels are decoded in the block, and `name` is used in errors.

    Raises `CaptureError` if it can't be read, or claims an impossible size for its bytes.
    """
    try:
        with (
            io.BytesIO(source) if isinstance(source, bytes) else open_file(source, _MAX_BYTES) as stream,
            Image.open(stream) as picture,
        ):
            size = len(source) if isinstance(source, bytes) else os.fstat(stream.fileno()).st_size
            width, height = picture.size
            if max(width, height) > _LONGEST_PX:
                raise CaptureError(f"{name}: {width}x{height} px; at most {_LONGEST_PX} a side can be used")
            check_expansion(name, width * height * _BYTES_OF_A_PIXEL.get(picture.mode, 4), size, is_uniform=True)
            yield picture
    except FileNotFoundError:
        raise CaptureError(f"{name}: no such picture") from None
    except CaptureError:
        raise
    except InputError as error:
        raise CaptureError(f"{name}: {error.strerror}") from None
    except UnidentifiedImageError:
        kind = kind_of_bytes(source) if isinstance(source, bytes) else kind_of_file(source, named_rightly=True)
        kind = kind or "of no format that is known"
        raise CaptureError(f"{name}: not a readable picture: it is {kind}") from None
    except Exception:  # damaged images raise different exceptions for each format
        raise CaptureError(f"{name}: not a readable picture: it is damaged, or cut off") from None


def _ends(file: Path, kind: str | None) -> bool:
    end = _ENDS.get(kind or "")
    if end is None:
        return True
    with open_file(file, _MAX_BYTES) as stream:
        size = stream.seek(0, 2)
        stream.seek(max(size - _TAIL_BYTES, 0))
        if end in stream.read():
            return True
        stream.seek(0)
        return kind == "JPEG" and end in stream.read()  # phones append a video to the image
