"""Scene files: readers, writers, and the one table of formats."""

from .gaussian_files import FORMATS, Format
from .scene_files import read_scene, write_scene

__all__ = ["FORMATS", "Format", "read_scene", "write_scene"]
