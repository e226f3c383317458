"""What a tool of the viewport is: it draws over the picture and may take the left mouse button for itself."""

from typing import Protocol, runtime_checkable

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from ..widgets.viewport import Viewport


@runtime_checkable
class Tool(Protocol):
    """One tool; `session.view.tool` names the one that is in use, "" is plain navigation."""

    name: str
    """As on its button and in the command palette, such as "Lasso"."""
    icon: str
    """One symbol of the icon font for the tool bar."""
    key: imgui.Key | None
    """Picks it."""
    help: str
    """What it does and which keys it knows, for the tooltip."""

    def draw(self, session: Session, viewport: Viewport) -> bool:
        """Draw over the picture and act on the mouse, each frame; returns whether the left button is its own now."""
        ...

    def options(self, session: Session) -> None:
        """Draw its few settings into the bar above the picture."""
        ...
