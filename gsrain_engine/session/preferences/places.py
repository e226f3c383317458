"""Where the program keeps what belongs to a person and to no scene."""

from pathlib import Path

import platformdirs


def state_folder() -> Path:
    """Recent files, autosaves of scenes that have no folder yet, and locks."""
    return Path(platformdirs.user_state_dir("gsrain", appauthor=False))


def config_folder() -> Path:
    """Preferences and the window's layout."""
    return Path(platformdirs.user_config_dir("gsrain", appauthor=False))
