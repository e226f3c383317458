"""Select what is like the Gaussian under the mouse: everywhere, or as far as it hangs together."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.selection.candidates import is_editable
from gsrain_engine.session.selection.colors import alike, base_color
from gsrain_engine.session.selection.flood import flooded
from gsrain_engine.session.selection.steps import select
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.picking import Picked, pick

from ..widgets.markers import is_clicked
from ..widgets.viewport import Viewport
from .selecting import MODIFIERS, beside, mode_now, mode_options, tolerance_option


class FloodTool:
    """Click on a thing."""

    name = "Flood"
    icon = icons_fontawesome_6.ICON_FA_FILL_DRIP
    key: imgui.Key | None = imgui.Key.g
    help = f"Click on what to select as far as it hangs together and looks alike. {MODIFIERS}"

    def draw(self, session: Session, viewport: Viewport) -> bool:
        options, picked = session.selecting, _clicked(session, viewport)
        if picked is not None:
            moment = viewport.shot.time_s
            found = flooded(session.scene, moment, picked.key, picked.gaussian, options.tolerance, options.flood_reach)
            select(session, found, mode_now(session), "flood")
        return False

    def options(self, session: Session) -> None:
        options = session.selecting
        mode_options(session)
        beside(9)
        tolerance_option(session)
        beside(9)
        imgui.set_next_item_width(9 * imgui.get_font_size())
        flags = imgui.SliderFlags_.always_clamp
        _, options.flood_reach = imgui.drag_float(
            "##reach", options.flood_reach, 0.05, 0.5, 20.0, "reach %.1f spacings", flags
        )
        imgui.set_item_tooltip(
            "Over how wide a gap the flood runs, in spacings: the distance to the eighth nearest alike Gaussian there."
        )


class ColorPickTool:
    """Click on a colour."""

    name = "Colour pick"
    icon = icons_fontawesome_6.ICON_FA_EYE_DROPPER
    key: imgui.Key | None = imgui.Key.i
    help = f"Click on a colour to select it everywhere. {MODIFIERS}"

    def draw(self, session: Session, viewport: Viewport) -> bool:
        picked = _clicked(session, viewport)
        if picked is not None:
            part = session.scene.part(session.scene.member(picked.key), viewport.shot.time_s)
            assert part is not None, "what was picked is there"
            color = base_color(part, picked.gaussian)
            found = alike(session.scene, viewport.shot.time_s, color, session.selecting.tolerance)
            select(session, found, mode_now(session), "colour")
        return False

    def options(self, session: Session) -> None:
        mode_options(session)
        beside(9)
        tolerance_option(session)


def _clicked(session: Session, viewport: Viewport) -> Picked | None:
    """What a click has hit that has just been let go, among what can be selected."""
    return pick(session.scene, viewport.shot, *viewport.mouse_px, is_editable) if is_clicked(viewport) else None
