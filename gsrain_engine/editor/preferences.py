"""Preferences and the folders of per-user files."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import platformdirs
from msgspec import Meta

from ..safe_io.errors import convert_checked
from ..safe_io.text_files import read_whole, yaml_values
from ..scene.files import lock_path, whole_file
from .notifications import describe_error


class PreferencesStore:
    """Preferences in memory; each change is saved in `thread`, one write at a time."""

    def __init__(self, thread: ThreadPoolExecutor) -> None:
        self.value, self.trouble = load_preferences()
        """Present preferences, and one sentence if the file could not be used, shown once."""
        if self.trouble is not None and (aside := set_aside()) is not None:
            self.trouble += f" (kept as {aside.name}; the usual settings are used)"
        self._thread = thread
        self._changed: dict[str, Any] = {}
        self._saving: Future[Preferences] | None = None

    def change(self, **fields: Any) -> None:
        """Change preferences.

        Raises:
            msgspec.ValidationError: If a value is out of bounds; the message names it.
        """
        self.value = checked(msgspec.structs.replace(self.value, **fields))
        self._changed.update(fields)

    def poll(self) -> None:
        """Write changes, unless a write is in progress. Once a frame."""
        if self._saving is not None and self._saving.done():
            saving, self._saving = self._saving, None
            if (error := saving.exception()) is not None:
                describe_error("The preferences can't be saved", Exception(str(error)))
        if self._changed and self._saving is None:
            changed, self._changed = self._changed, {}
            self._saving = self._thread.submit(save_preferences, **changed)

    def close(self) -> None:
        if self._changed:
            self._thread.submit(save_preferences, **self._changed)


# Folders


def state_folder() -> Path:
    """Folder for recent files, autosaves of never-saved scenes, and locks."""
    return Path(platformdirs.user_state_dir("gsrain", appauthor=False))


def config_folder() -> Path:
    """Folder for preferences and the window's layout."""
    return Path(platformdirs.user_config_dir("gsrain", appauthor=False))


# Preferences file, shared by all windows

logger = logging.getLogger("gsrain")


class Preferences(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the program. Unknown fields of other versions are ignored."""

    theme: Annotated[Literal["dark", "light"], Meta(title="Theme", description="Colors of panels and menus.")] = "dark"
    font_scale: Annotated[
        float, Meta(ge=0.5, le=3, title="Text size", description="Times the default size.", extra={"unit": "x"})
    ] = 1.0
    ui_scale: Annotated[
        float,
        Meta(ge=0.5, le=3, title="Spacing", description="Size of buttons and gaps.", extra={"unit": "x"}),
    ] = 1.0
    autosave_s: Annotated[
        float,
        Meta(
            ge=5,
            le=600,
            title="Autosave",
            description="Changes are autosaved next to the scene after this time; a crash loses later ones.",
            extra={"unit": "s"},
        ),
    ] = 20.0


def load_preferences() -> tuple[Preferences, str | None]:
    """Read the preferences, or defaults if there are none; and one sentence if the file can't be used."""
    path = preferences_file()
    try:
        return convert_checked(yaml_values(read_whole(path)), Preferences), None
    except FileNotFoundError:
        return Preferences(), None
    except OSError as error:
        return Preferences(), f"{path}: the preferences can't be read: {error.strerror or error}"
    except ValueError as error:
        return Preferences(), f"{path}: the preferences can't be used: {error}"


def set_aside() -> Path | None:
    """Rename an unusable preferences file so that its content is kept; return the new path."""
    aside = preferences_file().with_name("preferences.bad.yaml")
    try:
        return preferences_file().replace(aside)
    except OSError:
        return None


def save_preferences(**fields: Any) -> Preferences:
    """Change some preferences, keeping concurrent changes of other windows; return all of them.

    Raises:
        msgspec.ValidationError: If a value is out of bounds; the message names it.
        OSError: If the file can't be written.
    """
    path = preferences_file()
    path.parent.mkdir(parents=True, exist_ok=True)
    with lock_path(path.parent):
        changed = checked(msgspec.structs.replace(load_preferences()[0], **fields))
        with whole_file(path) as beside:
            beside.write_bytes(msgspec.yaml.encode(changed))
    return changed


def checked(preferences: Preferences) -> Preferences:
    """Validate and return the preferences.

    Raises:
        msgspec.ValidationError: If a value is out of bounds; the message names it.
    """
    return msgspec.convert(msgspec.to_builtins(preferences), Preferences)


def preferences_file() -> Path:
    return config_folder() / "preferences.yaml"
