"""Scene files: readers, writers, and the table of formats."""

from ._common import Format, check_room, checked_gaussians, gunzip, printable_name
from .registry import FORMATS
from .scene_files import read_scene, write_scene

__all__ = [
    "FORMATS",
    "Format",
    "check_room",
    "checked_gaussians",
    "gunzip",
    "printable_name",
    "read_scene",
    "write_scene",
]
