"""What a person can do, with a name and a key: menus, keys, command palette and keyboard page show the same list."""

from collections.abc import Callable
from dataclasses import dataclass

from gsrain_engine.session.session import Session


def always(session: Session) -> bool:
    """Whether it can be done: at any time."""
    return True


@dataclass(frozen=True)
class Action:
    """One thing to do."""

    name: str
    """As in menu and palette: a verb first. Unique."""
    run: Callable[[Session], None]
    menu: str = ""
    """Title of the menu that it stands in; "" is in none, only in palette and keys."""
    keys: int | tuple[int, ...] = ()
    """Key chords, the first one shown; see `chord`."""
    help: str = ""
    """One sentence, with units where there are numbers."""
    is_possible: Callable[[Session], bool] = always
    is_on: Callable[[Session], bool] | None = None
    """For what is switched on and off: whether it is on."""
