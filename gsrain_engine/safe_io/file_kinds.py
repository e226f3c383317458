"""Kinds of files that people of this field hold, recognized by content, with what to do with them here."""

from pathlib import Path
from typing import NamedTuple

from .limits import open_file

_HEAD_BYTES = 1 << 14  # JSON of others has its telling fields in its first kilobytes


class FileSignature(NamedTuple):
    """A kind of file; it needs all of its conditions, and one without `starts` and `holds` only a suffix."""

    words: str
    """The kind, and advice for such a file, for the end of a sentence that begins with "it is"."""
    starts: tuple[bytes, ...] = ()
    """Alternative magic bytes, in lower case."""
    at: int = 0
    """Byte offset of the magic."""
    holds: tuple[bytes, ...] = ()
    """Words of the first bytes, all of them, in lower case; fields of JSON stand in quotes."""
    suffixes: tuple[str, ...] = ()
    """Suffixes of rightly named files of the kind."""
    named: tuple[str, ...] = ("",)
    """Alternative suffixes without which a file is not of the kind, for content that tells too little."""
    is_used: bool = False
    """True if a command other than `info` takes such a file; the advice names it."""
    is_stand_in: bool = False
    """True if it takes the place of a file that is missing, under the name of that file."""
    has_poses: bool = False
    """True if it has camera poses of another program, which are not read."""


_IMAGE = "a picture: give the folder that it is in"
_ARCHIVE = "an archive: unpack it, and give what was in it"
_VIDEO = "a video: write its frames into a folder (ffmpeg -i VIDEO FOLDER/%05d.jpg), and give that"
_MESH = "a mesh or a point cloud, no Gaussians"
_HEIC = "an HEIC or AVIF picture: convert it to JPEG or PNG"
_CHECKPOINT = (
    "a checkpoint of PyTorch: a scene of a training is named .pth, .pt or .ckpt; of programs that are not read, export "
    "its Gaussians as a PLY, and give that"
)
_CAMERA_PATH = "a camera path: gsrain render SCENE --camera-path FILE -o VIDEO.mp4"
_COLMAP = "a part of a COLMAP model: give the folder that images and sparse are in"
_UNREAD_POSES = "which is not read: write its poses as those of COLMAP or nerfstudio"
_LINEAR = "a picture in linear light (HDR), such as an environment map: convert it to JPEG or PNG"
_ZIP = (b"pk\x03\x04",)
_OBJECT = (b"{",)
_PICKLE = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")  # the protocol follows the first byte


def _poses(
    program: str, advice: str, *starts: bytes, holds: tuple[bytes, ...] = (), named: tuple[str, ...] = ("",)
) -> FileSignature:
    words = f"poses of {program}, which are not read: {advice}"
    by_name = not starts and not holds
    return FileSignature(words, starts, holds=holds, suffixes=named if by_name else (), named=named, has_poses=True)


_PROCESS = "nerfstudio's ns-process-data {0} makes a capture of them and their pictures"
_TO_COLMAP = "{0} writes them as COLMAP's files"
_OPENSFM = f"{_TO_COLMAP.format('opensfm export_colmap')}, and nerfstudio's ns-process-data odm reads ODM's projects"
_ANEW = "run COLMAP on their pictures"

_POSES = (
    _poses("RealityCapture", _PROCESS.format("realitycapture"), holds=(b"#name,x,y,alt",)),
    _poses("RealityCapture", _PROCESS.format("realitycapture"), holds=(b"#name;x;y;alt",)),
    _poses("RealityCapture", "export them as COLMAP's text files", holds=(b"xcr:",), named=(".xmp",)),
    _poses("Metashape", _PROCESS.format("metashape"), holds=(b"<document version", b"<chunk")),
    _poses("Polycam", _PROCESS.format("polycam"), *_OBJECT, holds=(b'"t_00"',)),
    _poses("Record3D", _PROCESS.format("record3d"), *_OBJECT, holds=(b'"poses"',), named=("metadata",)),
    _poses("OpenSfM", _OPENSFM, b"[", holds=(b'"cameras"', b'"shots"')),
    _poses("OpenSfM", _OPENSFM, named=("reconstruction.json",)),
    _poses("OpenMVG", _TO_COLMAP.format("openMVG_main_openMVG2Colmap"), *_OBJECT, holds=(b"sfm_data_version",)),
    _poses("Meshroom", _TO_COLMAP.format("aliceVision_exportColmap"), *_OBJECT, holds=(b'"views"', b'"intrinsicid"')),
    _poses("Meshroom", _TO_COLMAP.format("aliceVision_exportColmap"), named=(".sfm",)),
    _poses("OpenMVS", _TO_COLMAP.format("InterfaceCOLMAP"), b"mvsi"),
    _poses("Bundler", _ANEW, b"# bundle file"),
    _poses("VisualSFM", _ANEW, b"nvm_v3"),
    _poses(
        "MMDetection3D",
        "info files are read of nuScenes, with samples/ or pictures named by camera beside them",
        *_PICKLE,
        named=tuple(f"infos{part}.pkl" for part in ("", "_train", "_val", "_trainval", "_test")),
    ),
)
"""Files with camera poses of other programs."""

FILE_KINDS = (
    # text and pointers
    FileSignature("a bag of ROS 1: rosbags-convert turns it into one of ROS 2", (b"#rosbag v",), suffixes=(".bag",)),
    FileSignature("the list of a ROS 2 bag's files: give its folder", (b"rosbag2_bagfile_information",)),
    FileSignature(
        "a pointer of Git LFS, not the file itself: run git lfs pull where it was cloned",
        (b"version https://git-lfs",),
        is_stand_in=True,
    ),
    FileSignature(
        "a web page or an answer of a server, not the file: the download went wrong",
        (b"<!doctype html", b"<html", b"404: not found", b"not found"),
        is_stand_in=True,
    ),
    # cameras, paths and descriptions of scenes, as JSON, XML and text
    FileSignature(
        "the description of a streamed SOG scene: give it as lod-meta.json, in its folder with the parts that it names",
        _OBJECT,
        holds=(b'"lodlevels"', b'"filenames"'),
        suffixes=(".json",),
    ),
    FileSignature(
        "a scene of XGRIDS (LCC), which is not read: export it as a PLY or SOG, as splat-transform does",
        _OBJECT,
        holds=(b'"totalsplats"',),
    ),
    FileSignature(
        "a tileset of 3D Tiles, which is not read: give a .glb or .gltf with Gaussians that it names",
        _OBJECT,
        holds=(b'"geometricerror"', b'"root"'),
    ),
    FileSignature(
        "the settings of SuperSplat's viewer: give the scene that it shows",
        _OBJECT,
        holds=(b'"tonemapping"', b'"camera'),
    ),
    FileSignature(_CAMERA_PATH, _OBJECT, holds=(b'"camera_path"', b'"camera_type"'), is_used=True),
    FileSignature(_CAMERA_PATH, _OBJECT, holds=(b'"keyframes"', b'"quaternion_wxyz"'), is_used=True),
    FileSignature(
        f"the cameras of a training of 3DGS, {_CAMERA_PATH}", (b"[",), holds=(b'"rotation"', b'"fy"'), is_used=True
    ),
    FileSignature(
        "the cameras of a capture (transforms.json): give its folder, or gsrain render SCENE --camera-path FILE",
        _OBJECT,
        holds=(b'"frames"', b'"transform_matrix"'),
        is_used=True,
    ),
    FileSignature(
        "a camera: gsrain render SCENE --camera FILE -o IMAGE.png", _OBJECT, holds=(b'"world_to_camera"',), is_used=True
    ),
    FileSignature(
        "the placement of a nerfstudio training, no scene: give the PLY of ns-export gaussian-splat",
        _OBJECT,
        holds=(b'"transform"', b'"scale"'),
    ),
    FileSignature(
        "the description of a glTF file: name it .gltf",
        _OBJECT,
        holds=(b'"asset"', b'"accessors"'),
        suffixes=(".gltf",),
    ),
    FileSignature(
        "the settings of a 3DGS training: give point_cloud/iteration_N/point_cloud.ply of its folder", (b"namespace(",)
    ),
    FileSignature(_COLMAP, (b"# camera list with one", b"# image list with two", b"# 3d point list with one")),
    *_POSES,
    FileSignature(f"a trajectory of TUM RGB-D, {_UNREAD_POSES}", (b"#",), holds=(b"tx ty tz qx qy qz qw",)),
    FileSignature(f"a trajectory of EuRoC, {_UNREAD_POSES}", (b"#timestamp",), holds=(b"p_rs_r_x",)),
    FileSignature(f"a trajectory of Open3D, {_UNREAD_POSES}", _OBJECT, holds=(b'"pinholecameratrajectory"',)),
    FileSignature(_COLMAP, suffixes=("cameras.bin", "images.bin", "points3d.bin", "frames.bin", "rigs.bin")),
    FileSignature("a scenario: gsrain drive FILE", holds=(b"<openscenario",), is_used=True),
    FileSignature(
        "a map of roads (OpenDRIVE), which a scenario (.xosc) names: gsrain drive SCENARIO.xosc", holds=(b"<opendrive",)
    ),
    FileSignature("a map of roads of Argoverse 2, which is not read", _OBJECT, holds=(b'"pedestrian_crossings"',)),
    # archives, the ones with a known content first
    FileSignature("a part of a scene of HUGSIM: give its folder", suffixes=("scene.pth", "ground.pth", "gs.pth")),
    FileSignature("a SOG scene: name it .sog", _ZIP, holds=(b"means_l.webp",), suffixes=(".sog",)),
    FileSignature(_CHECKPOINT, _ZIP, holds=(b"/data.pkl",), suffixes=(".pth", ".pt", ".ckpt")),
    FileSignature("a project of SuperSplat: open it there, and export a PLY", _ZIP, holds=(b"document.json",)),
    FileSignature("a file of arrays", suffixes=(".npz", ".npy")),
    FileSignature(_ARCHIVE, (*_ZIP, b"pk\x05\x06"), suffixes=(".sog", ".usdz", ".zip")),
    FileSignature(_ARCHIVE, (b"7z\xbc\xaf\x27\x1c", b"rar!\x1a")),
    FileSignature(_ARCHIVE, (b"ustar",), at=257),
    FileSignature(_ARCHIVE, (b"\x1f\x8b",), suffixes=(".spz",)),
    FileSignature("an SPZ scene: name it .spz", (b"ngsp",), suffixes=(".spz",)),
    FileSignature(
        "a Python pickle, which may run code and is not opened: export its Gaussians as a PLY",
        _PICKLE,
    ),
    # pictures and videos
    FileSignature(_IMAGE, (b"\xff\xd8\xff",), suffixes=(".jpg", ".jpeg")),
    FileSignature(_IMAGE, (b"\x89png\r\n",), suffixes=(".png",)),
    FileSignature(_IMAGE, (b"gif87a", b"gif89a"), suffixes=(".gif",)),
    FileSignature(_IMAGE, (b"ii*\0", b"mm\0*"), suffixes=(".tif", ".tiff")),
    FileSignature(_IMAGE, (b"webpvp8",), at=8, suffixes=(".webp",)),
    FileSignature(_LINEAR, (b"#?radiance", b"#?rgbe", b"v/1\x01")),
    FileSignature(_HEIC, (b"ftyphei", b"ftyphev", b"ftypmif", b"ftypmsf", b"ftypavi"), at=4),
    FileSignature(_VIDEO, (b"ftyp", b"moov", b"mdat"), at=4),
    FileSignature(_VIDEO, (b"\x1a\x45\xdf\xa3",)),
    FileSignature(_VIDEO, (b"avi list",), at=8),
    # geometry
    FileSignature("a binary glTF file: a mesh, a point cloud or Gaussians", (b"gltf",), suffixes=(".glb",)),
    FileSignature("a USD stage: pack it as .usdz (usdzip scene.usdz STAGE), and give that", (b"#usda", b"pxr-usdc")),
    FileSignature(_MESH, (b"kaydara fbx", b"lasf", b"# .pcd", b"astm-e57")),
    FileSignature("a PLY file: a scene, a mesh or a point cloud", (b"ply\n", b"ply\r\n"), suffixes=(".ply",)),
    # other files
    FileSignature("a PDF", (b"%pdf-",)),
    FileSignature("a table of a data set (Parquet): give the data set's folder", (b"par1",)),
    FileSignature("a table of a data set (Feather); of Argoverse 2, give the folder of the log", (b"arrow1",)),
    FileSignature("a database, such as COLMAP's: give the folder with the model (sparse/0)", (b"sqlite format 3",)),
    # by name alone: their first bytes tell nothing
    FileSignature(_CHECKPOINT, suffixes=(".pt", ".ckpt")),
    FileSignature(
        "a neural network (ONNX), such as a detector: gsrain evaluate detection --detector FILE",
        suffixes=(".onnx",),
        is_used=True,
    ),
    FileSignature(
        "weights or Gaussians as safetensors, which are no scene: export its Gaussians as a PLY",
        suffixes=(".safetensors",),
    ),
    FileSignature(
        "a scene of Spark (RAD), which is not read: give the PLY, SPZ or SOG that it was made of", suffixes=(".rad",)
    ),
    FileSignature("a volume of NuRec, which is not read: give a .usdz or PLY of Gaussians", suffixes=(".nurec",)),
    FileSignature(_MESH, suffixes=(".obj", ".stl", ".fbx", ".dae", ".las", ".laz", ".e57", ".pcd", ".pts", ".xyz")),
    FileSignature(_VIDEO, suffixes=(".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")),
)
"""Kinds in order of precedence: the first row whose conditions a file meets is its kind."""


def kind_of_file(path: Path, *, named_rightly: bool = False) -> str | None:
    """Describe a file's actual kind ("an archive: unpack it, and give what was in it"), for the end of an error.

    Returns None if no kind matches, if the file can't be opened, or, with `named_rightly`, if the kind matches the
    suffix.
    """
    found = find_file_kind(path)
    return None if found is None or (named_rightly and _is_named_rightly(found, path.name.lower())) else found.words


def kind_of_bytes(head: bytes, name: str = "") -> str | None:
    """Describe the kind of a file by its first bytes and its name or suffix, as `kind_of_file` does."""
    found = _kind_of(head, name.lower())
    return None if found is None else found.words


def find_file_kind(path: Path) -> FileSignature | None:
    """Find the row of a file in the table; None if there is none, or if the file can't be opened."""
    try:
        with open_file(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return None
    return _kind_of(head, path.name.lower())


_EMPTY = FileSignature("an empty file")


def _kind_of(head: bytes, name: str) -> FileSignature | None:
    if not head:
        return _EMPTY
    head = head[:_HEAD_BYTES].lower().removeprefix(b"\xef\xbb\xbf")
    text = head.lstrip() if head[:1].isspace() else head
    return next((kind for kind in FILE_KINDS if _is_of_kind(head, text, name, kind)), None)


def _is_of_kind(head: bytes, text: bytes, name: str, kind: FileSignature) -> bool:
    if not name.endswith(kind.named):
        return False
    if not kind.starts and not kind.holds:
        return name.endswith(kind.suffixes)
    start = head[kind.at :] if kind.at else text
    return start.startswith(kind.starts or b"") and all(word in head for word in kind.holds)


def _is_named_rightly(kind: FileSignature, name: str) -> bool:
    return bool(kind.starts or kind.holds) and name.endswith(kind.suffixes or "\0")
