"""The one table of actions, in the order of the menus."""

from .action import Action
from .file import FILE_ACTIONS
from .help import HELP_ACTIONS
from .history import HISTORY_ACTIONS
from .jobs import JOB_ACTIONS
from .view import VIEW_ACTIONS

ACTIONS: tuple[Action, ...] = (
    *FILE_ACTIONS,
    *HISTORY_ACTIONS,
    *JOB_ACTIONS,
    *VIEW_ACTIONS,
    *HELP_ACTIONS,
)
