"""The Select panel: how much is selected, more and less of it, by attribute, and sets to come back to."""

from imgui_bundle import imgui

from gsrain_engine.session.selection import steps
from gsrain_engine.session.selection.combine import selectable_count, selected_count
from gsrain_engine.session.session import Session

from .attribute_range import attribute_range
from .selection_sets import selection_sets


def select_panel(session: Session) -> None:
    count = selected_count(session.scene)
    imgui.align_text_to_frame_padding()
    imgui.text(f"{count:,} of {selectable_count(session.scene):,} selected")
    imgui.set_item_tooltip("Gaussians that are shown, of layers and actors that are neither hidden nor locked.")
    _everything(session, count)
    _more_or_less(session, count)
    imgui.separator_text("By attribute")
    attribute_range(session)
    imgui.separator_text("Selection sets")
    selection_sets(session, count)


def _everything(session: Session, count: int) -> None:
    if imgui.button("All"):
        steps.select_all(session)
    imgui.set_item_tooltip("Select everything that is shown (Ctrl+A).")
    imgui.same_line()
    imgui.begin_disabled(count == 0)
    if imgui.button("None"):
        steps.select_none(session)
    imgui.set_item_tooltip("Let go of everything (Ctrl+Shift+A).")
    imgui.end_disabled()
    imgui.same_line()
    if imgui.button("Invert"):
        steps.invert(session)
    imgui.set_item_tooltip("Select what is shown and was not selected (Ctrl+I).")
    imgui.same_line()
    _, session.view.show_selection = imgui.checkbox("Tint", session.view.show_selection)
    imgui.set_item_tooltip("Show the selected ones tinted (Shift+S).")


def _more_or_less(session: Session, count: int) -> None:
    options = session.selecting
    imgui.begin_disabled(count == 0)
    if imgui.button("Grow"):
        steps.grow(session, options.distance_m)
    imgui.set_item_tooltip("Take in what is at most so far from a selected one (Ctrl+]).")
    imgui.same_line()
    if imgui.button("Shrink"):
        steps.shrink(session, options.distance_m)
    imgui.set_item_tooltip("Let go of what is at most so far from one that is not selected (Ctrl+[).")
    imgui.end_disabled()
    imgui.same_line()
    imgui.align_text_to_frame_padding()
    imgui.text("by")
    imgui.same_line()
    imgui.set_next_item_width(-1)
    flags = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
    _, options.distance_m = imgui.slider_float("##distance_m", options.distance_m, 0.001, 10.0, "%.3f m", flags)
    imgui.set_item_tooltip("Between centres, in metres. Ctrl+click to type.")
