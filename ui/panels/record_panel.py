"""The Record panel: what a clip looks like, how much it is, and the way to it."""

from pathlib import Path

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

from ..widgets.file_dialogs import ask_where_to_save
from .rain_panel import WARNING
from .record_fields import camera_field, format_fields, moment_fields, pass_fields, sample_fields, size_fields
from .rollout_fields import FILM_HELP, ask_where_to_film

_LONG_S = 60.0
_KINDS = {
    "h264": "MP4{.mp4}",
    "vp9": "WebM{.webm}",
    "av1": "WebM{.webm},MP4{.mp4}",
    "png": "Folder of frames{.*}",
    "jpeg": "Folder of frames{.*}",
    "exr": "Folder of frames{.*}",
}


def record_panel(session: Session) -> None:
    format_fields(session)
    camera_field(session)
    size_fields(session)
    moment_fields(session)
    imgui.separator_text("Samples")
    sample_fields(session)
    imgui.separator_text("Passes")
    pass_fields(session)
    imgui.separator()
    if session.drives.playing is not None:
        _film_instead(session)
    can_begin = _extent(session)
    imgui.begin_disabled(not can_begin)
    half = (imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2
    if imgui.button("Record...", ImVec2(half, 0)):
        ask_where_to_record(session)
    imgui.set_item_tooltip("Ask where to, then record in the background (Ctrl+R). Jobs shows how far it is.")
    imgui.end_disabled()
    imgui.same_line()
    imgui.begin_disabled(session.recorder.is_recording)
    if imgui.button("Record a still...", ImVec2(half, 0)):
        ask_where_to_record_still(session)
    imgui.set_item_tooltip("The moment and the place that the view shows, in this size and with these samples.")
    imgui.end_disabled()


def _film_instead(session: Session) -> None:
    """Say that a drive which plays is not in the clip, and how it is filmed."""
    imgui.push_style_color(imgui.Col_.text, WARNING)
    imgui.text_wrapped("A clip shows the scene with its own traffic, not the drive that plays.")
    imgui.pop_style_color()
    why_not = session.drives.why_no_film(session)
    imgui.begin_disabled(why_not is not None)
    if imgui.button("Film the drive...", ImVec2(-1, 0)):
        ask_where_to_film(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(why_not or FILM_HELP)


def ask_where_to_record(session: Session) -> None:
    """Show the dialog for the timeline's clip."""
    kinds = _KINDS[session.recorder.wanted.codec]
    ask_where_to_save("Record the timeline", kinds, lambda chosen: session.recorder.record_to(_plain(chosen[0])))


def ask_where_to_record_still(session: Session) -> None:
    kinds = "PNG{.png},JPEG{.jpg},EXR{.exr}"
    ask_where_to_save("Record a still", kinds, lambda chosen: session.recorder.record_still_to(chosen[0]))


def _plain(path: Path) -> Path:
    """A folder is named without what the dialog's filter puts behind its name."""
    return path.with_suffix("") if path.suffix == ".*" else path


def _extent(session: Session) -> bool:
    """Say how much it is; returns whether it can begin."""
    extent = session.recorder.extent()
    if isinstance(extent, str):
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(extent)
        imgui.pop_style_color()
        return False
    times = f"{extent.cameras} cameras x " if extent.cameras > 1 else ""
    rough = "" if extent.rough_s is None else f"; {_minutes(extent.rough_s)} or more to draw"
    length = f"{extent.length_s:.2f} s" if extent.length_s < _LONG_S else _minutes(extent.length_s)
    imgui.text_wrapped(f"{times}{extent.frames:,} frames, {length}{rough}")
    imgui.set_item_tooltip(
        "The time is a guess from the viewport's last picture (min:s); reading the scene and encoding come on top."
    )
    return not session.recorder.is_recording


def _minutes(seconds: float) -> str:
    whole = max(round(seconds), 1)
    return f"{whole // 60}:{whole % 60:02d} min"
