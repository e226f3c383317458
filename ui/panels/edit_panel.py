"""The Edit panel: what can be done with the selection, and with the layer or actor that is picked, by numbers."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.session.edits.compacting import compact, deleted_count
from gsrain_engine.session.edits.marking import (
    delete_selected,
    hide_selected,
    isolate_selected,
    selected_count,
    show_all,
)
from gsrain_engine.session.session import Session

from .actor_fields import actor_fields
from .floater_fields import floater_fields
from .grading_fields import grading_fields
from .place_fields import place_fields


def edit_panel(session: Session) -> None:
    _selection(session)
    member = next((each for each in session.scene.members if each.key == session.view.member), None)
    if member is None:
        imgui.separator_text("Layer")
        imgui.text_disabled("Pick a layer or an actor in Layers.")
    else:
        _member(session, member)
    if imgui.collapsing_header("Floaters", imgui.TreeNodeFlags_.default_open):
        floater_fields(session)


def _selection(session: Session) -> None:
    scene = session.scene
    count, deleted = selected_count(scene), deleted_count(scene)
    imgui.separator_text(f"{count:,} selected" if count else "Nothing selected")
    wide = ImVec2((imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2, 0)
    imgui.begin_disabled(not count)
    if imgui.button("Delete", wide):
        session.edit("Delete the selection", delete_selected)
    imgui.set_item_tooltip("Delete what is selected (Delete); undo brings it back.")
    imgui.same_line()
    if imgui.button("Hide", wide):
        session.edit("Hide the selection", hide_selected)
    imgui.set_item_tooltip("Do not draw what is selected (H).")
    if imgui.button("Isolate", wide):
        session.edit("Isolate the selection", isolate_selected)
    imgui.set_item_tooltip("Hide everything else; locked layers stay as they are.")
    imgui.end_disabled()
    imgui.same_line()
    imgui.begin_disabled(not any(each.marks.hidden for each in scene.members))
    if imgui.button("Show all", wide):
        session.edit("Show all", show_all)
    imgui.set_item_tooltip("Draw everything again that was hidden (Shift+H).")
    imgui.end_disabled()
    if deleted:
        if imgui.button(f"Remove {deleted:,} deleted for good", ImVec2(-1, 0)):
            session.edit("Remove what is deleted", compact)
        imgui.set_item_tooltip(
            "Make new arrays without them, and smaller files. Frames hardly get faster: deleted ones are not drawn.\n"
            "Undo still has the old ones."
        )


def _member(session: Session, member: Layer | Actor) -> None:
    imgui.separator_text(member.name)
    if member.locked:
        imgui.text_disabled("It is locked.")
    imgui.begin_disabled(member.locked)
    if imgui.collapsing_header("Place", imgui.TreeNodeFlags_.default_open):
        place_fields(session, member)
    if isinstance(member, Actor) and imgui.collapsing_header("Drive", imgui.TreeNodeFlags_.default_open):
        actor_fields(session, member)
    if imgui.collapsing_header("Colour", imgui.TreeNodeFlags_.default_open):
        grading_fields(session, member)
    imgui.end_disabled()
