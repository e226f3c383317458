"""Widgets for the roll-outs that are open: which one plays, where the camera goes, jumps to what matters."""

from pathlib import Path
from typing import get_args

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.session.drive.drives import Drives
from gsrain_engine.session.drive.opened_rollout import OpenedRollout
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.chase import ChaseMode

from ..widgets.colors import color
from ..widgets.file_dialogs import ask_what_to_open, ask_where_to_save
from ..widgets.square_button import square_button
from ..widgets.struct_fields import ALL_FILES
from .drive_colors import curve_colors
from .rain_panel import WARNING

_ICONS = icons_fontawesome_6
_KINDS = "Roll-outs{.jsonl,.parquet}"
_FILMS = "MP4{.mp4},WebM{.webm}"
FILM_HELP = (
    "Film the drive that plays, as `gsrain drive` does: what the front camera sees, figures, and all from above.\n"
    "In the background, with the Record panel's frame rate, at most 60 a second."
)
_MODES: dict[ChaseMode, str] = {
    "behind": "8 m behind the ego vehicle and 3 m up; look around as you like, click again to come back.",
    "front camera": "Through the rig's camera that looks ahead; a drag leaves it.",
    "free": "Where you fly.",
}


def rollout_fields(session: Session) -> None:
    drives = session.drives
    third = (imgui.get_content_region_avail().x - 2 * imgui.get_style().item_spacing.x) / 3
    if imgui.button(f"{_ICONS.ICON_FA_FOLDER_OPEN}  Open...###open roll-out", (third, 0)):
        ask_for_rollout(session)
    imgui.set_item_tooltip("Open a finished drive (JSON lines), such as `gsrain drive` writes; or drop it here.")
    imgui.same_line()
    imgui.begin_disabled(drives.playing is None)
    if imgui.button(f"{_ICONS.ICON_FA_FLOPPY_DISK}  Save as...###save roll-out", (third, 0)):
        ask_where_to_save_rollout(session)
    imgui.set_item_tooltip("Write the one that plays as JSON lines or Parquet.")
    imgui.end_disabled()
    imgui.same_line()
    why_not = drives.why_no_film(session)
    imgui.begin_disabled(why_not is not None)
    if imgui.button(f"{_ICONS.ICON_FA_FILM}  Film...###film roll-out", (third, 0)):
        ask_where_to_film(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(why_not or FILM_HELP)
    if not drives.opened:
        imgui.text_wrapped("None is open. Drive, or open a finished drive: it plays in the view, on the timeline.")
        return
    colors = curve_colors(drives.opened)
    for number, (opened, hue) in enumerate(zip(drives.opened, colors, strict=True)):
        _row(session, number, opened, color(hue))
    if drives.trouble is not None:
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(drives.trouble)
        imgui.pop_style_color()
    _jumps(session)
    _camera(session)
    _shown(drives)


def ask_for_rollout(session: Session) -> None:
    """Ask for a roll-out's file."""
    kinds = f"{_KINDS},{ALL_FILES}"

    def take(chosen: list[Path]) -> None:
        for path in chosen:
            session.drives.open(path)

    ask_what_to_open("Open a roll-out", kinds, take, several=True)


def ask_where_to_save_rollout(session: Session) -> None:
    ask_where_to_save("Save the roll-out", _KINDS, lambda chosen: session.drives.save_as(session, chosen[0]))


def ask_where_to_film(session: Session) -> None:
    ask_where_to_save("Film the drive", _FILMS, lambda chosen: session.drives.film_to(session, chosen[0]))


def _row(session: Session, number: int, opened: OpenedRollout, hue: int) -> None:
    drives, height = session.drives, imgui.get_frame_height()
    imgui.push_id(number)
    at, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
    room = width - height - imgui.get_style().item_spacing.x
    if imgui.selectable("##play", opened is drives.playing, size=ImVec2(room, height))[0]:
        drives.play(session, opened)
    where = "not saved" if opened.path is None else str(opened.path)
    imgui.set_item_tooltip(
        f"{opened.title}, seed {opened.rollout.seed}, in {opened.rollout.scene!r}\n{where}\nClick: play it in the view."
    )
    draw, low = imgui.get_window_draw_list(), at.y + (height - imgui.get_text_line_height()) / 2
    side = 0.55 * imgui.get_text_line_height()
    top = at.y + (height - side) / 2
    draw.add_rect_filled(ImVec2(at.x + 4, top), ImVec2(at.x + 4 + side, top + side), hue, 2.0)
    draw.push_clip_rect(at, ImVec2(at.x + room, at.y + height), True)
    draw.add_text(ImVec2(at.x + side + 12, low), imgui.get_color_u32(imgui.Col_.text), opened.title)
    draw.pop_clip_rect()
    imgui.same_line()
    if square_button(_ICONS.ICON_FA_XMARK, "close"):
        drives.close(session, opened)
    imgui.set_item_tooltip("Close it; after the last one the scene comes back.")
    imgui.pop_id()


def _jumps(session: Session) -> None:
    drives = session.drives
    playing = drives.playing
    if playing is None:
        return
    half = (imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2
    hit = playing.collision_s
    imgui.begin_disabled(hit is None)
    if imgui.button(f"{_ICONS.ICON_FA_CAR_BURST}  Collision###collision", (half, 0)) and hit is not None:
        drives.jump(session, hit)
    imgui.end_disabled()
    words = "Nothing was hit." if hit is None else f"Go to {hit:.2f} s, where {playing.metrics.collided_with} was hit."
    imgui.set_item_tooltip(words)
    imgui.same_line()
    critical = playing.curves.most_critical_s
    if imgui.button(f"{_ICONS.ICON_FA_STOPWATCH}  Smallest TTC###smallest ttc", (half, 0)):
        drives.jump(session, critical)
    least = float(playing.curves.ttc_s.min())
    imgui.set_item_tooltip(f"Go to {critical:.2f} s, where the time to collision is {least:.2f} s (from 0 to 10 s).")


def _camera(session: Session) -> None:
    chase = session.drives.chase
    imgui.align_text_to_frame_padding()
    imgui.text("Camera")
    for mode in get_args(ChaseMode):
        imgui.same_line()
        if imgui.radio_button(mode, chase.mode == mode):
            session.drives.follow(session, mode)
        imgui.set_item_tooltip(_MODES[mode])


def _shown(drives: Drives) -> None:
    _, drives.show_boxes = imgui.checkbox("Boxes", drives.show_boxes)
    imgui.set_item_tooltip(
        "Draw everybody's box with its name and its speed in m/s; red is who is hit.\n"
        "From the front camera also what the agent has detected, with the distance (m) of whom it follows."
    )
    imgui.same_line()
    _, drives.show_plan = imgui.checkbox("Plan", drives.show_plan)
    imgui.set_item_tooltip("Draw the planned points of the present step on the road, 0.5 s apart, and the driven way.")
    imgui.same_line()
    _, drives.show_ego_car = imgui.checkbox("Ego car", drives.show_ego_car)
    imgui.set_item_tooltip("Show a body for the ego vehicle; its own cameras never see it.")
    imgui.same_line()
    _, drives.rain_as_driven = imgui.checkbox("Its rain", drives.rain_as_driven)
    imgui.set_item_tooltip("On: the rain that was driven in. Off: the scene's own, as the Rain panel sets it.")
