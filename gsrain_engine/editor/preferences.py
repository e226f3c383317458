"""Preferences and the folders of per-user files."""

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import platformdirs
from msgspec import Meta

from ..safe_io.errors import convert_checked
from ..safe_io.files import lock_path, whole_file
from ..safe_io.text_files import read_whole, yaml_values
from ..settings import Settings
from .background import Background, Task
from .status import Answer, Question, StatusBus, describe_error


class PreferencesStore:
    """Preferences in memory; each change is saved in `background`, one write at a time."""

    def __init__(self, background: Background, status: StatusBus) -> None:
        self.value, trouble = load_preferences()
        if trouble is not None:
            aside = preferences_file().with_name("preferences.bad.yaml")
            with suppress(OSError):
                preferences_file().replace(aside)
                trouble += f" (kept as {aside.name}; the usual settings are used)"
            status.ask(Question("Preferences", trouble, (Answer("OK"),)))
        self._background, self._status = background, status
        self._changed: dict[str, Any] = {}
        self._saving: Task[Preferences] | None = None

    def set(self, **fields: Any) -> None:
        """Change and save preferences; a value out of bounds is reported."""
        try:
            self.value = checked(msgspec.structs.replace(self.value, **fields))
        except msgspec.ValidationError as error:
            self._status.report(error, "That can't be preferred")
        else:
            self._changed.update(fields)

    def poll(self) -> None:
        """Write changes, unless a write is in progress. Once a frame."""
        if self._changed and (self._saving is None or self._saving.state != "running"):
            save, self._changed = partial(save_preferences, **self._changed), {}
            fail = partial(describe_error, "The preferences can't be saved")
            self._saving = self._background.start(save, lambda _: None, fail)

    def close(self) -> None:
        if self._changed:
            self._background.submit(partial(save_preferences, **self._changed))


# Folders


def state_folder() -> Path:
    """Folder for recent files, autosaves of never-saved scenes, and locks."""
    return Path(platformdirs.user_state_dir("gsrain", appauthor=False))


def config_folder() -> Path:
    """Folder for preferences and the window's layout."""
    return Path(platformdirs.user_config_dir("gsrain", appauthor=False))


# Preferences file, shared by all windows


class WindowPlace(Settings, frozen=True, kw_only=True):
    """Place of the window on the desktop."""

    position: tuple[int, int] | None
    """Left and upper edge of its content in pixels; None where the desktop does not tell it."""
    size: tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]]
    """Width and height of its content in pixels of a screen of scale 1."""
    is_maximized: bool
    """True if it was maximized: position and size are those from before."""


class Preferences(Settings, frozen=True, kw_only=True):
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
    known_version: str = ""
    """Last version whose changes were offered; empty before the first one."""
    hint: Annotated[bool, Meta(title="First steps", description="Show the first steps in the viewport.")] = True
    desktop_dialogs: Annotated[
        bool,
        Meta(
            title="System file dialogs",
            description="Choose files in the desktop's own dialogs (zenity or kdialog) where it has them.",
        ),
    ] = True
    front_panels: tuple[str, ...] = ()
    """Panels that were in front when the last window was closed; empty for the first ones of each side."""
    hidden_panels: tuple[str, ...] = ()
    window: WindowPlace | None = None
    """Place of the window that was closed last."""
    recording: dict[str, Any] = msgspec.field(default_factory=dict)
    """Settings of the Record panel that are not the default, by field of `ExportSettings`."""
    records_range: bool = True
    """True if the Record panel records the timeline's range."""


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


def save_preferences(**fields: Any) -> Preferences:
    """Change some preferences, keeping concurrent changes of other windows; return all of them.

    Raises as `checked` does, and OSError if the file can't be written.
    """
    path = preferences_file()
    path.parent.mkdir(parents=True, exist_ok=True)
    with lock_path(path.parent):
        changed = checked(msgspec.structs.replace(load_preferences()[0], **fields))
        with whole_file(path) as file:
            file.write_bytes(msgspec.yaml.encode(changed))
    return changed


def checked(preferences: Preferences) -> Preferences:
    """Return the preferences; raises `msgspec.ValidationError`, which names a value that is out of bounds."""
    return msgspec.convert(msgspec.to_builtins(preferences), Preferences)


def preferences_file() -> Path:
    return config_folder() / "preferences.yaml"
