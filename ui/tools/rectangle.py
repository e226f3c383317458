"""Select by a rectangle drawn over the picture."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.selection import image_shapes
from gsrain_engine.session.session import Session

from ..widgets.viewport import Viewport
from . import outline
from .left_drag import LeftDrag
from .selecting import MODIFIERS, shape_options, take_shape


class RectangleTool:
    """Drag from corner to corner."""

    name = "Rectangle"
    icon = icons_fontawesome_6.ICON_FA_VECTOR_SQUARE
    key: imgui.Key | None = imgui.Key.b
    help = f"Drag from corner to corner. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Session, viewport: Viewport) -> bool:
        state = self._drag.follow(viewport)
        if state in ("pressed", "dragged"):
            outline.box(viewport, self._drag.points[0], self._drag.points[-1])
        elif state == "released":
            if self._drag.has_moved:
                ends = self._drag.points[0], self._drag.points[-1]
                pixels = image_shapes.rectangle(*ends, viewport.width, viewport.height)
                take_shape(session, viewport, pixels, "rectangle")
            self._drag.drop()
        return True

    def options(self, session: Session) -> None:
        shape_options(session)
