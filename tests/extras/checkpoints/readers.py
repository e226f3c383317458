"""Readers of checkpoints that are tried with damaged ones."""

from pathlib import Path

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene
from tests.fuzz.mutations import damaged_bytes
from tests.fuzz.reader import Reader, one_file
from tests.scene.formats.sample_files import assert_valid

from .written import SMALL


def _read(path: Path) -> None:
    for each in read_scene(path).members:
        assert_valid(each.gaussians)


READERS = tuple(
    Reader(f"checkpoint-{name.split('.')[0]}", one_file(name, write), _read, SceneFormatError, (("*", damaged_bytes),))
    for name, write in SMALL.items()
)
