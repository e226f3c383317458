"""Record panel: format, extent and start of a clip."""

from collections.abc import Callable
from pathlib import Path

from imgui_bundle import ImVec2, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.render.export import LONGEST_DEFAULT_S
from gsrain_engine.render.export_settings import DEFAULT_QUALITY, LARGEST_PX, Codec, ExportSettings, Pass

from ..widgets.fields import FieldInfo, ask_where_to_save, field_info, plain_label
from ..widgets.text import label, visible_name
from .drive import VIDEO_HELP, ask_where_to_video
from .rain import WARNING

_LONG_S = 60.0

_KINDS = {
    "h264": "MP4{.mp4}",
    "vp9": "WebM{.webm}",
    "av1": "WebM{.webm},MP4{.mp4}",
    "png": "Folder of frames{.*}",
    "jpeg": "Folder of frames{.*}",
    "exr": "Folder of frames{.*}",
}


def record_panel(session: Editor) -> None:
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
        _video_instead(session)
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


def _video_instead(session: Editor) -> None:
    """Explain that a clip doesn't show the active roll-out, and offer a video of that."""
    imgui.push_style_color(imgui.Col_.text, WARNING)
    imgui.text_wrapped("A clip shows the scene with its own traffic, not the drive that plays.")
    imgui.pop_style_color()
    why_not = session.drives.why_no_video(session)
    imgui.begin_disabled(why_not is not None)
    if imgui.button("Film the drive...", ImVec2(-1, 0)):
        ask_where_to_video(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(why_not or VIDEO_HELP)


def ask_where_to_record(session: Editor) -> None:
    kinds = _KINDS[session.recorder.settings.codec]
    ask_where_to_save("Record the timeline", kinds, lambda chosen: session.recorder.record_to(_plain(chosen[0])))


def ask_where_to_record_still(session: Editor) -> None:
    kinds = "PNG{.png},JPEG{.jpg},EXR{.exr}"
    ask_where_to_save("Record a still", kinds, lambda chosen: session.recorder.record_still_to(chosen[0]))


def _plain(path: Path) -> Path:
    """Remove the suffix that the dialog's filter appends to a folder's name."""
    return path.with_suffix("") if path.suffix == ".*" else path


def _extent(session: Editor) -> bool:
    """Draw length and size of the clip; returns True if the recording can start."""
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


# Clip settings

_FORMATS: dict[str, Codec] = {
    "MP4 (H.264)": "h264",
    "WebM (VP9)": "vp9",
    "WebM (AV1)": "av1",
    "PNG frames": "png",
    "JPEG frames": "jpeg",
    "EXR frames": "exr",
}

_SIZES = {
    "960 x 640": (960, 640),
    "1280 x 720": (1280, 720),
    "1920 x 1080": (1920, 1080),
    "3840 x 2160": (3840, 2160),
    "the rig's own": None,
}

_OTHER = "other"
_PATH = "the camera path"
_CHECKBOX_EM = 5.2  # width of a checkbox with a word next to a field

_PASS_HELP: dict[Pass, str] = {
    "color": "The picture.",
    "depth": "Along the view axis, without rain: PNG with 16 bit in cm, or Z in EXR in m; 0 is nothing.",
    "alpha": "How much of each pixel is covered: PNG with 8 bit, or A in EXR.",
    "labels": "Which layer or actor a pixel shows: PNG with a number each, and labels.json says which is which.",
}


def format_fields(session: Editor) -> None:
    wanted = session.recorder.settings
    titles = list(_FORMATS)
    plain_label("Format", "What is written: a video, or a folder of numbered frames.")
    changed, picked = imgui.combo("##format", list(_FORMATS.values()).index(wanted.codec), titles)
    if changed:
        session.recorder.change(codec=_FORMATS[titles[picked]], quality=None)
    if not session.recorder.settings.is_video:
        return
    _label("quality")
    highest = 51 if wanted.codec == "h264" else 63
    imgui.set_next_item_width(-_CHECKBOX_EM * imgui.get_font_size())
    imgui.begin_disabled(wanted.quality is None)
    usual = DEFAULT_QUALITY.get(wanted.codec, 0)
    changed, quality = imgui.slider_int("##quality", usual if wanted.quality is None else wanted.quality, 0, highest)
    imgui.end_disabled()
    if changed:
        session.recorder.change(quality=quality)
    imgui.same_line()
    changed, is_usual = imgui.checkbox("usual", wanted.quality is None)
    imgui.set_item_tooltip("The codec's usual quality: hardly a difference to be seen.")
    if changed:
        session.recorder.change(quality=None if is_usual else usual)


def size_fields(session: Editor) -> None:
    present, titles = session.recorder.settings.size_px, list(_SIZES)
    shown = next((title for title, size in _SIZES.items() if size == present), _OTHER)
    _label("size_px")
    if imgui.begin_combo("##size", shown):
        for title in titles:
            if imgui.selectable(title, title == shown)[0]:
                session.recorder.change(size_px=_SIZES[title])
        imgui.end_combo()
    if present is None:
        return
    plain_label("", "")
    changed, size = imgui.input_int2("##size_px", list(present))
    imgui.set_item_tooltip("Width and height in pixels; even numbers for a video.")
    if changed:
        width, height = (min(max(side, 1), LARGEST_PX) for side in size)
        session.recorder.change(size_px=(width, height))


def camera_field(session: Editor) -> None:
    _label("cameras")
    wanted = session.recorder.settings.cameras
    shown = ", ".join(wanted) or _PATH
    if not imgui.begin_combo("##cameras", "all rig cameras" if wanted == ("all",) else shown):
        return
    if imgui.selectable(_PATH, not wanted)[0]:
        session.recorder.change(cameras=())
    for rig, mounted in session.scene.rigs.items():
        imgui.separator_text(visible_name(rig))
        if len(mounted) > 1 and imgui.selectable(label(f"all of {rig}"), wanted == (rig,))[0]:
            session.recorder.change(cameras=(rig,))
        for camera in mounted:
            name = f"{rig}/{camera.name}"
            words = label(f"{camera.name}  ({camera.width} x {camera.height})", name)
            if imgui.selectable(words, wanted == (name,))[0]:
                session.recorder.change(cameras=(name,))
    if len(session.scene.rigs) > 1:
        imgui.separator()
        if imgui.selectable("all rig cameras", wanted == ("all",))[0]:
            session.recorder.change(cameras=("all",))
    imgui.end_combo()


def moment_fields(session: Editor) -> None:
    wanted = session.recorder.settings
    _label("fps")
    changed, fps = imgui.input_float("##fps", wanted.fps, 0.0, 0.0, "%.6g")
    if changed:
        session.recorder.change(fps=min(max(fps, 0.1), 1000.0))
    _label("first_s")
    changed, first_s = imgui.drag_float("##first_s", wanted.first_s, 0.02, -36000.0, 36000.0, "%.3f")
    if changed and (wanted.last_s is None or first_s < wanted.last_s):
        session.recorder.change(first_s=first_s)
    _label("last_s")
    ends_itself = wanted.last_s is None
    imgui.set_next_item_width(-_CHECKBOX_EM * imgui.get_font_size())
    imgui.begin_disabled(ends_itself)
    end_s = session.recorder.end_s
    changed, last_s = imgui.drag_float("##last_s", end_s, 0.02, wanted.first_s + 1e-3, 36000.0, "%.3f")
    imgui.end_disabled()
    if changed and last_s > wanted.first_s:
        session.recorder.change(last_s=last_s)
    imgui.same_line()
    changed, ends_itself = imgui.checkbox("its end", ends_itself)
    imgui.set_item_tooltip(
        "Record until the camera path or the rig's drive ends. "
        f"Without camera keys of your own a clip of the view's way has at most {LONGEST_DEFAULT_S:g} s."
    )
    if changed:
        session.recorder.change(last_s=None if ends_itself else end_s)


def sample_fields(session: Editor) -> None:
    _count(session, "supersampling", 4, lambda n: "off" if n == 1 else f"{n} x {n} a pixel")
    _count(session, "motion_blur", 64, lambda n: "off" if n == 1 else f"{n} sub-frames")


def pass_fields(session: Editor) -> None:
    wanted = session.recorder.settings
    for name, words in _PASS_HELP.items():
        changed, on = imgui.checkbox(name, name in wanted.passes)
        imgui.set_item_tooltip(words)
        passes = tuple(each for each in _PASS_HELP if (on if each == name else each in wanted.passes))
        if changed and passes:
            session.recorder.change(passes=passes)
        if name != "labels":
            imgui.same_line()
    changed, twin = imgui.checkbox(_info("twin").title, wanted.twin)
    imgui.set_item_tooltip(_info("twin").help)
    if changed:
        session.recorder.change(twin=twin)


def _count(session: Editor, name: str, most: int, words: Callable[[int], str]) -> None:
    _label(name)
    value = getattr(session.recorder.settings, name)
    flags = imgui.SliderFlags_.always_clamp | (imgui.SliderFlags_.logarithmic if most > 8 else 0)
    changed, value = imgui.slider_int(f"##{name}", value, 1, most, words(value), flags)
    if changed:
        session.recorder.change(**{name: value})


def _info(name: str) -> FieldInfo:
    return field_info(name, ExportSettings)


def _label(name: str) -> None:
    info = _info(name)
    plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)
