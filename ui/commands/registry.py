"""Table of all commands, in the order of the menus."""

from .base import Command
from .edit import EDIT_ACTIONS, SELECTION_ACTIONS
from .file import (
    HELP_ACTIONS,
    HISTORY_ACTIONS,
    IMPORT_ACTIONS,
    JOB_ACTIONS,
    LEAVING_ACTIONS,
    OPEN_ACTIONS,
    RECORD_ACTIONS,
    SAVING_ACTIONS,
)
from .rain import INTENSITY_ACTIONS, RAIN_ACTIONS, WEATHER_ACTIONS
from .view import (
    CAMERA_KEY_ACTIONS,
    CAPTURE_ACTIONS,
    CAPTURE_FILE_ACTIONS,
    DRIVE_ACTIONS,
    PATH_ACTIONS,
    ROLLOUT_ACTIONS,
    TIME_ACTIONS,
    VIEW_ACTIONS,
)

ACTION_GROUPS: tuple[tuple[Command, ...], ...] = (
    OPEN_ACTIONS,
    IMPORT_ACTIONS,
    SAVING_ACTIONS,
    CAPTURE_FILE_ACTIONS,
    RECORD_ACTIONS,
    HISTORY_ACTIONS,
    EDIT_ACTIONS,
    SELECTION_ACTIONS,
    INTENSITY_ACTIONS,
    RAIN_ACTIONS,
    WEATHER_ACTIONS,
    DRIVE_ACTIONS,
    ROLLOUT_ACTIONS,
    TIME_ACTIONS,
    CAMERA_KEY_ACTIONS,
    PATH_ACTIONS,
    VIEW_ACTIONS,
    JOB_ACTIONS,
    CAPTURE_ACTIONS,
    HELP_ACTIONS,
    LEAVING_ACTIONS,
)
"""Groups of commands; menus draw a line between two groups."""

ACTIONS = tuple(action for group in ACTION_GROUPS for action in group)
