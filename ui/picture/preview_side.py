"""A transferred view beside the live one: it stands right of the divider while it shows what the viewport shows."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

LABELS = "now", "preview, soaked"


def preview_side(session: Session, corner: ImVec2, width: int, height: int) -> tuple[str, str] | None:
    """Lay the preview over the right part of the picture; returns the labels of both sides, or None."""
    rainy = session.rainy
    rainy.viewport_px = width, height
    if session.view.split != "now | preview" or rainy.texture is None or not rainy.fits(session):
        return None
    at = session.view.divider
    low, high = ImVec2(corner.x + at * width, corner.y), ImVec2(corner.x + width, corner.y + height)
    imgui.get_window_draw_list().add_image(imgui.ImTextureRef(rainy.texture.name), low, high, ImVec2(at, 0))
    return LABELS
