"""Scene files: readers, writers, and the table of formats."""

from ._common import Format
from .registry import FORMATS
from .scene_files import read_scene, write_scene

__all__ = ["FORMATS", "Format", "read_scene", "write_scene"]
