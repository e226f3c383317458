"""Scene files: readers, writers, and the table of formats."""

from ._common import Format, check_room, checked_gaussians
from .registry import FORMATS
from .scene_files import read_scene, write_scene

__all__ = ["FORMATS", "Format", "check_room", "checked_gaussians", "read_scene", "write_scene"]
