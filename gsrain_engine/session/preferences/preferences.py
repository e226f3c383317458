"""What a person prefers, whatever the scene: one small file that several windows share."""

import logging
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.file_lock import locked
from gsrain_engine.untrusted.explained_errors import converted
from gsrain_engine.untrusted.plain_values import read_whole, yaml_values

from .places import config_folder

logger = logging.getLogger("gsrain")


class Preferences(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the program. What an older or newer program has written besides is passed over."""

    theme: Annotated[
        Literal["dark", "light"], Meta(title="Theme", description="Colours of panels and menus; the picture stays.")
    ] = "dark"
    font_scale: Annotated[
        float, Meta(ge=0.5, le=3, title="Text size", description="Times the usual size.", extra={"unit": "x"})
    ] = 1.0
    ui_scale: Annotated[
        float,
        Meta(ge=0.5, le=3, title="Spacing", description="Size of buttons and gaps, times usual.", extra={"unit": "x"}),
    ] = 1.0
    autosave_s: Annotated[
        float,
        Meta(
            ge=5,
            le=600,
            title="Autosave",
            description="A change is kept beside the scene after so long; a crash loses what is younger.",
            extra={"unit": "s"},
        ),
    ] = 20.0


def load_preferences() -> tuple[Preferences, str | None]:
    """Read the preferences, or defaults where there are none; and one sentence when the file can't be used."""
    path = preferences_file()
    try:
        return converted(yaml_values(read_whole(path)), Preferences), None
    except FileNotFoundError:
        return Preferences(), None
    except OSError as error:
        return Preferences(), f"{path}: the preferences can't be read: {error.strerror or error}"
    except ValueError as error:
        return Preferences(), f"{path}: the preferences can't be used: {error}"


def set_aside() -> Path | None:
    """Move preferences that can't be used out of the way, so that what is in them is not lost; returns where to."""
    aside = preferences_file().with_name("preferences.bad.yaml")
    try:
        return preferences_file().replace(aside)
    except OSError:
        return None


def save_preferences(**fields: Any) -> Preferences:
    """Change some preferences, whatever other windows have changed meanwhile; returns them all.

    Raises:
        msgspec.ValidationError: When a value is out of its bounds; the message names it.
        OSError: When the file can't be written.
    """
    path = preferences_file()
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.parent):
        changed = checked(msgspec.structs.replace(load_preferences()[0], **fields))
        with whole_file(path) as beside:
            beside.write_bytes(msgspec.yaml.encode(changed))
    return changed


def checked(preferences: Preferences) -> Preferences:
    """Return the same preferences.

    Raises:
        msgspec.ValidationError: When a value is out of its bounds; the message names it.
    """
    return msgspec.convert(msgspec.to_builtins(preferences), Preferences)


def preferences_file() -> Path:
    return config_folder() / "preferences.yaml"
