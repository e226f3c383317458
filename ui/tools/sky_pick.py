"""The tool "Pick sky colour": drops take the colour of what is clicked on, or of a rectangle."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.session import Session
from gsrain_engine.session.view.sky_pick import SkyPick

from ..panels.drop_color import PICK_TOOL
from ..widgets.markers import draw_hint
from ..widgets.viewport import Viewport
from . import outline
from .left_drag import LeftDrag


class SkyPickTool:
    """Click, or drag from corner to corner."""

    name = PICK_TOOL
    icon = icons_fontawesome_6.ICON_FA_CLOUD_SUN
    key: imgui.Key | None = None
    help = "Give drops the colour of the sky you show: click a pixel, or drag a rectangle (mean in linear light)."

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Session, viewport: Viewport) -> bool:
        """Draw the rectangle, and ask for its colour when it is let go."""
        state = self._drag.follow(viewport)
        if state in ("pressed", "dragged") and self._drag.has_moved:
            outline.box(viewport, self._drag.points[0], self._drag.points[-1])
        elif state == "released":
            start, end = self._drag.points[0], self._drag.points[-1] if self._drag.has_moved else self._drag.points[0]
            size = viewport.width, viewport.height
            session.sky_pick = SkyPick.between(
                (start[0] / size[0], start[1] / size[1]), (end[0] / size[0], end[1] / size[1])
            )
            self._drag.drop()
        draw_hint(viewport, "Click the sky, or drag a rectangle over it")
        return True

    def options(self, session: Session) -> None:
        own = session.rain.drop_color
        red, green, blue = own or session.sky
        imgui.color_button("##drops now", (red, green, blue, 1.0))
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text("picked" if own is not None else "from the scene's sky")
        imgui.same_line()
        imgui.begin_disabled(own is None)
        if imgui.button("From the sky again"):
            session.change_rain("Drop colour from the sky", drop_color=None)
        imgui.end_disabled()
        imgui.set_item_tooltip("Take the mean of the scene's own sky in linear light, as at first (eq. 3).")
