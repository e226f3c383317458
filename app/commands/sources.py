"""What a person names on the command line: a scene, or a capture."""

from pathlib import Path

from gsrain_engine.scene.formats.gaussian_files import format_of
from gsrain_engine.scene.formats.sog import is_sog_folder
from gsrain_engine.scene.open_scene import is_built_in, scene_folder_of


def names_scene(name: str) -> bool:
    """Whether a name is that of a scene: what could be both, such as a folder with scene.json and pictures, is one."""
    path = Path(name)
    return is_built_in(name) or scene_folder_of(path) is not None or format_of(path) is not None or is_sog_folder(path)
