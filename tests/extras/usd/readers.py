"""Readers of NuRec and SplatSim that are tried with damaged files."""

from pathlib import Path

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene, write_scene
from tests.fuzz.mutations import damaged_bytes, damaged_json, inside_zip
from tests.fuzz.reader import Reader, one_file
from tests.scene.formats.sample_files import assert_valid

from .test_nurec import state, volume
from .test_splatsim import driven_street


def _read(path: Path) -> None:
    for each in read_scene(path).members:
        assert_valid(each.gaussians)


def _scene(folder: Path) -> Path:
    write_scene(driven_street(), folder / "a.splatsim.usdz")
    return folder / "a.splatsim.usdz"


READERS = (
    Reader(
        "nurec",
        one_file("a.nurec", lambda path: path.write_bytes(volume(state()))),
        _read,
        SceneFormatError,
        (("*", damaged_bytes),),
    ),
    Reader(
        "splatsim",
        _scene,
        _read,
        SceneFormatError,
        (("*", inside_zip(lambda name: damaged_json if name.endswith(".json") else damaged_bytes)),),
    ),
)
