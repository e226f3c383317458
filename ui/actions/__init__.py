"""The one table of actions, in the order of the menus."""

from .action import Action

ACTIONS: tuple[Action, ...] = ()
