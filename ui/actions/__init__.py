"""The one table of actions, in the order of the menus."""

from .action import Action
from .capture import CAPTURE_ACTIONS, CAPTURE_FILE_ACTIONS
from .drive import DRIVE_ACTIONS, ROLLOUT_ACTIONS
from .edits import EDIT_ACTIONS
from .file import IMPORT_ACTIONS, LEAVING_ACTIONS, OPEN_ACTIONS, SAVING_ACTIONS
from .help import HELP_ACTIONS
from .history import HISTORY_ACTIONS
from .jobs import JOB_ACTIONS
from .rain import INTENSITY_ACTIONS, RAIN_ACTIONS, WEATHER_ACTIONS
from .record import RECORD_ACTIONS
from .selection import SELECTION_ACTIONS
from .timeline import CAMERA_KEY_ACTIONS, PATH_ACTIONS, TIME_ACTIONS
from .view import VIEW_ACTIONS

ACTION_GROUPS: tuple[tuple[Action, ...], ...] = (
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
"""A menu draws a line between two of them."""
ACTIONS = tuple(action for group in ACTION_GROUPS for action in group)
