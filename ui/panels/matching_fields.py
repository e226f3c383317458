"""Fields of the Capture panel: matching what is looked at with another view."""

from imgui_bundle import imgui

from gsrain_engine.session.matching.mode import MODES, Mode
from gsrain_engine.session.matching.other_view import AGAINST, Against
from gsrain_engine.session.session import Session

_AGAINST: dict[Against, str] = {
    "next": "the next view",
    "previous": "the view before",
    "beside": "the camera beside",
    "chosen": "the chosen view",
}
_MODES: dict[Mode, str] = {"picture": "that view, from here", "difference": "difference", "pixels": "which match"}


def matching_fields(session: Session) -> None:
    matching = session.matching
    _, matching.is_on = imgui.checkbox("Show matches", matching.is_on)
    imgui.set_item_tooltip(
        "Find each pixel in another view, by its depth (eq. 13-15): of the recorded view that is looked from, else of "
        "the live view of a scene that was made from the capture (Shift+M)."
    )
    imgui.begin_disabled(not matching.is_on)
    imgui.same_line()
    _, matching.lines = imgui.checkbox("Lines", matching.lines)
    imgui.set_item_tooltip(
        "Draw lines from where pixels are to where the other view has them, as shares of the picture."
    )
    imgui.set_next_item_width(-6.5 * imgui.get_font_size())
    changed, at = imgui.combo("With", AGAINST.index(matching.against), [_AGAINST[each] for each in AGAINST])
    if changed:
        matching.against = AGAINST[at]
    imgui.set_item_tooltip(
        "Of the same camera, or of the one that looks most nearly the same way at that time. The live view is always "
        "matched with the chosen view."
    )
    imgui.set_next_item_width(-6.5 * imgui.get_font_size())
    changed, at = imgui.combo("As", MODES.index(matching.mode), [_MODES[each] for each in MODES])
    if changed:
        matching.mode = MODES[at]
    imgui.set_item_tooltip(
        "That view warped onto this one; or how much they differ, from black (not at all) to white (a quarter of full "
        "scale); or only which pixels match, and why others do not."
    )
    imgui.end_disabled()
