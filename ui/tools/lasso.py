"""Select by a line drawn freely around things."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.selection import image_shapes
from gsrain_engine.session.session import Session

from ..widgets.viewport import Viewport
from . import outline
from .left_drag import LeftDrag
from .selecting import MODIFIERS, shape_options, take_shape


class LassoTool:
    """Drag around what is meant."""

    name = "Lasso"
    icon = icons_fontawesome_6.ICON_FA_PENCIL
    key: imgui.Key | None = imgui.Key.l
    help = f"Drag around what to select. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Session, viewport: Viewport) -> bool:
        state = self._drag.follow(viewport)
        if state in ("pressed", "dragged"):
            outline.line(viewport, self._drag.points)
            outline.faint(viewport, self._drag.points[-1], self._drag.points[0])
        elif state == "released":
            if self._drag.has_moved:
                pixels = image_shapes.polygon(self._drag.points, viewport.width, viewport.height)
                take_shape(session, viewport, pixels, "lasso")
            self._drag.drop()
        return True

    def options(self, session: Session) -> None:
        shape_options(session)
