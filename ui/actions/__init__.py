"""The one table of actions, in the order of the menus."""

from .action import Action
from .capture import CAPTURE_ACTIONS, CAPTURE_FILE_ACTIONS
from .drive import DRIVE_ACTIONS
from .edits import EDIT_ACTIONS
from .file import FILE_ACTIONS, LEAVING_ACTIONS
from .help import HELP_ACTIONS
from .history import HISTORY_ACTIONS
from .jobs import JOB_ACTIONS
from .rain import RAIN_ACTIONS
from .record import RECORD_ACTIONS
from .selection import SELECTION_ACTIONS
from .timeline import TIMELINE_ACTIONS
from .view import VIEW_ACTIONS

ACTIONS: tuple[Action, ...] = (
    *FILE_ACTIONS,
    *CAPTURE_FILE_ACTIONS,
    *RECORD_ACTIONS,
    *HISTORY_ACTIONS,
    *EDIT_ACTIONS,
    *SELECTION_ACTIONS,
    *RAIN_ACTIONS,
    *JOB_ACTIONS,
    *DRIVE_ACTIONS,
    *TIMELINE_ACTIONS,
    *VIEW_ACTIONS,
    *CAPTURE_ACTIONS,
    *HELP_ACTIONS,
    *LEAVING_ACTIONS,
)
