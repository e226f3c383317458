"""Says of a file that can't be read as what its name promises what it is instead, by its first bytes."""

from pathlib import Path
from typing import NamedTuple

from .limits import open_file

_HEAD_BYTES = 512
"""The mark of a tar archive stands at byte 257."""


class _Kind(NamedTuple):
    words: str
    """The kind, and what can be done with such a file."""
    starts: tuple[bytes, ...] = ()
    """First bytes, any of them."""
    at: int = 0
    """Byte at which they stand."""
    suffixes: tuple[str, ...] = ()
    """Names that such a file rightly has: it is no surprise there. A kind without first bytes goes by them alone."""


_PICTURE = "a picture: give the folder that it is in"
_ARCHIVE = "an archive: unpack it, and give what was in it"
_VIDEO = "a video: write its frames into a folder (ffmpeg -i VIDEO FOLDER/%05d.jpg), and give that"
_MESH = "a mesh or a point cloud, no Gaussians"
_HEIC = "an HEIC or AVIF picture: convert it to JPEG or PNG"
_KINDS = (
    _Kind(
        "a pointer of Git LFS, not the file itself: run git lfs pull where it was cloned", (b"version https://git-lfs",)
    ),
    _Kind("a web page, not the file: the download went wrong", (b"<!doctype html", b"<html")),
    _Kind("a file of arrays", suffixes=(".npz", ".npy")),
    _Kind(_ARCHIVE, (b"pk\x03\x04", b"pk\x05\x06"), suffixes=(".sog",)),
    _Kind(_ARCHIVE, (b"7z\xbc\xaf\x27\x1c", b"rar!\x1a")),
    _Kind(_ARCHIVE, (b"ustar",), at=257),
    _Kind(_ARCHIVE, (b"\x1f\x8b",), suffixes=(".spz",)),
    _Kind(_PICTURE, (b"\xff\xd8\xff",), suffixes=(".jpg", ".jpeg")),
    _Kind(_PICTURE, (b"\x89png\r\n",), suffixes=(".png",)),
    _Kind(_PICTURE, (b"gif87a", b"gif89a"), suffixes=(".gif",)),
    _Kind(_PICTURE, (b"ii*\0", b"mm\0*"), suffixes=(".tif", ".tiff")),
    _Kind(_PICTURE, (b"webpvp8",), at=8, suffixes=(".webp",)),
    _Kind(_HEIC, (b"ftyphei", b"ftyphev", b"ftypmif", b"ftypmsf", b"ftypavi"), at=4),
    _Kind(_VIDEO, (b"ftyp", b"moov", b"mdat"), at=4),
    _Kind(_VIDEO, (b"\x1a\x45\xdf\xa3",)),
    _Kind(_VIDEO, (b"avi list",), at=8),
    _Kind(_MESH, (b"gltf", b"kaydara fbx", b"lasf", b"# .pcd")),
    _Kind("a PLY file: a scene, a mesh or a point cloud", (b"ply\n", b"ply\r\n"), suffixes=(".ply",)),
    _Kind("a PDF", (b"%pdf-",)),
    _Kind("a table of a data set (Parquet): give the data set's folder", (b"par1",)),
    _Kind("a database, such as COLMAP's: give the folder with the model (sparse/0)", (b"sqlite format 3",)),
    _Kind(_MESH, suffixes=(".obj", ".stl", ".fbx", ".gltf", ".glb", ".dae", ".las", ".laz", ".e57", ".pcd")),
    _Kind(_VIDEO, suffixes=(".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")),
)
"""The first that fits is right. Letters are compared as small ones."""


def kind_of_file(path: Path, *, named_rightly: bool = False) -> str | None:
    """Say what a file is ("an archive: unpack it, and give what was in it"), for the end of a refusal.

    None for what no kind fits, for what can't be opened, and, where the reader goes by names and is `named_rightly`,
    for what its name says that it is.
    """
    try:
        with open_file(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return None
    return kind_of_bytes(head, path.suffix.lower(), named_rightly=named_rightly)


def kind_of_bytes(head: bytes, suffix: str = "", *, named_rightly: bool = False) -> str | None:
    """Say what the first bytes of a file, whose name ends so in small letters, belong to, as `kind_of_file` does."""
    if not head:
        return "an empty file"
    head = head[:_HEAD_BYTES].lower().removeprefix(b"\xef\xbb\xbf")
    for kind in _KINDS:
        if head[kind.at :].startswith(kind.starts) if kind.starts else suffix in kind.suffixes:
            return None if kind.starts and named_rightly and suffix in kind.suffixes else kind.words
    return None
