"""Record panel: format, duration, samples and passes of a video, frames or an image."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.drive import RolloutPlayer
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.recorder import RenderQueue
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.fields import field_of
from gsrain_engine.render.export_settings import (
    DEFAULT_JPEG_QUALITY,
    DEFAULT_QUALITY,
    EXPORT_PRESETS,
    LARGEST_PX,
    Codec,
    ExportSettings,
    Pass,
)

from ..commands.table import help_of
from ..widgets.draw import color
from ..widgets.fields import (
    CLAMPED,
    LOGARITHMIC,
    button,
    checkbox,
    combo,
    copy_buttons,
    disabled,
    edit_field,
    field_label,
    plain_label,
    share_of_width,
    warn,
)
from ..widgets.file_dialogs import ask_where_to_save
from ..widgets.numbers import slide_whole
from ..widgets.text import label, visible_name
from .drive import ask_where_to_render_drive

_LONG_S = 60.0
_KINDS = {"h264": "MP4{.mp4}", "vp9": "WebM{.webm}", "av1": "WebM{.webm},MP4{.mp4}"}
_FRAMES = "Folder of frames{.*}"
_FORMATS: dict[Codec, str] = {
    "h264": "MP4 (H.264)", "vp9": "WebM (VP9)", "av1": "WebM (AV1)",
    "png": "PNG frames", "jpeg": "JPEG frames", "exr": "EXR frames",
}  # fmt: skip
_SIZES = {
    (960, 640): "960 x 640", (1280, 720): "1280 x 720", (1920, 1080): "1920 x 1080", (3840, 2160): "3840 x 2160",
    None: "the rig's own",
}  # fmt: skip
_QUALITIES: dict[Codec, tuple[str, str, int, int]] = {
    "h264": ("Video quality (CRF)", "Constant rate factor, 0 to 51: lower is better, and larger.", 0, 51),
    "vp9": ("Video quality (CRF)", "Constant rate factor, 0 to 63: lower is better, and larger.", 0, 63),
    "av1": ("Video quality (CRF)", "Constant rate factor, 0 to 63: lower is better, and larger.", 0, 63),
    "jpeg": ("JPEG quality", "1 to 100: higher is better, and larger.", 1, 100),
}
"""Title and help of a format's quality, and its bounds."""

_PATH = "the camera path"
_CHECKBOX_EM = 6.2  # width of a checkbox with a word next to a field
_PASSES: dict[Pass, tuple[str, str]] = {
    "color": ("Color", "The rendered image."),
    "depth": (
        "Depth",
        "Along the view axis, without rain: PNG with 16 bit in cm, or Z in EXR in m; 0 where there is nothing.",
    ),
    "alpha": ("Alpha", "Coverage of each pixel: PNG with 8 bit, or A in EXR."),
    "labels": (
        "Layer and actor IDs",
        "Layer or actor of each pixel: PNG with a number each; labels.json lists the numbers.",
    ),
}


def record_panel(
    document: Document, files: Files, playback: Playback, rollouts: RolloutPlayer, render_queue: RenderQueue,
    status: StatusBus,
) -> None:  # fmt: skip
    if rollouts.playing is not None:
        warn("A recording shows the scene with its own traffic, not the playing roll-out.")
        why_not = rollouts.why_no_video
        if button("Render drive video...", help_of("Render drive video..."), width=-1, why_not=why_not):
            ask_where_to_render_drive(rollouts)
    can_start, half = _extent(render_queue), share_of_width(2)
    help_text = "Choose a place, then record in the background (Ctrl+R). The Jobs panel shows the progress."
    if button("Record...", help_text, width=half, enabled=can_start):
        ask_where_to_record(render_queue)
    imgui.same_line()
    help_text = "Render the present view at the present time, in this size and with these samples (Ctrl+Shift+R)."
    if button("Render image...", help_text, width=half):
        ask_where_to_render_image(render_queue)
    imgui.separator()
    _preset(render_queue)
    _format(render_queue)
    _cameras(document, render_queue)
    _size(render_queue)
    _projection(render_queue)
    _times(render_queue, playback)
    imgui.separator_text("Samples")
    _count(render_queue, "supersampling", 4, "{0} x {0} per pixel", CLAMPED)
    _count(render_queue, "motion_blur", 64, "{0} sub-frames", LOGARITHMIC)
    imgui.separator_text("Passes")
    _passes(render_queue)
    _preview(render_queue)
    imgui.separator()
    if button("Intensity sheet...", help_of("Draw intensity sheet..."), width=share_of_width(2)):
        ask_where_to_draw_sheet(render_queue)
    imgui.same_line()
    if button("Web page...", help_of("Publish web page..."), width=-1):
        ask_where_to_publish(render_queue)
    why_not = "The scene is not in a file yet: save it first." if files.source is None else None
    forms = {"command": lambda: render_queue.command, "Python": lambda: render_queue.program}
    copy_buttons("this recording", forms, status, why_not)


def ask_where_to_record(render_queue: RenderQueue) -> None:
    kinds, name = _KINDS.get(render_queue.settings.codec, _FRAMES), render_queue.proposed_name()
    record = render_queue.record_to
    ask_where_to_save("Record timeline", kinds, lambda chosen: record(chosen[0]), proposed=name, confirms=False)


def ask_where_to_render_image(render_queue: RenderQueue) -> None:
    kinds, name = "PNG{.png},JPEG{.jpg},EXR{.exr}", render_queue.proposed_name(".png")
    render = render_queue.record_still_to
    ask_where_to_save("Render image", kinds, lambda chosen: render(chosen[0]), proposed=name, confirms=False)


def ask_where_to_draw_sheet(render_queue: RenderQueue) -> None:
    draw, name = render_queue.draw_sheet_to, render_queue.proposed_name("_rain.png")
    ask_where_to_save("Intensity sheet", "PNG{.png}", lambda chosen: draw(chosen[0]), proposed=name, confirms=False)


def ask_where_to_publish(render_queue: RenderQueue) -> None:
    publish, name = render_queue.publish_to, render_queue.proposed_name(".html")
    ask_where_to_save("Publish web page", "Web page{.html}", lambda chosen: publish(chosen[0]), proposed=name,
                      confirms=False)  # fmt: skip


def _extent(render_queue: RenderQueue) -> bool:
    """Draw number of frames and duration; returns True if the recording can start."""
    extent = render_queue.extent()
    if isinstance(extent, str):
        warn(extent)
        return False
    times = f"{extent.cameras} cameras x " if extent.cameras > 1 else ""
    about = "about {} to record" if extent.is_timed else "{} or more to draw"
    rough = "" if extent.seconds is None else f"; {about.format(_minutes(extent.seconds))}"
    length = f"{extent.length_s:.2f} s" if extent.length_s < _LONG_S else _minutes(extent.length_s)
    imgui.text_wrapped(f"{times}{extent.frames:,} frames, {length}{rough}")
    if extent.is_timed:
        imgui.set_item_tooltip("From the frames of the last recording or timing (min:s).")
        return True
    imgui.set_item_tooltip("From the viewport's last image (min:s), without encoding, and while nothing else runs.")
    help_text = "Draw and write a few frames in the background, and estimate the time from them."
    if extent.frames > 1 and button("Estimate time", help_text, width=-1, enabled=not render_queue.is_timing):
        render_queue.time_frames()
    return True


def _minutes(seconds: float) -> str:
    whole = max(round(seconds), 1)
    return f"{whole // 60}:{whole % 60:02d} min"


# Settings


def _preset(render_queue: RenderQueue) -> None:
    present = render_queue.preset
    plain_label("Preset", "Settings for one purpose; cameras and times stay.")
    if not imgui.begin_combo("##preset", "custom" if present is None else present.title):
        return
    for each in EXPORT_PRESETS:
        if imgui.selectable(each.title, each is present)[0]:
            render_queue.use_preset(each)
        imgui.set_item_tooltip(each.help)
    imgui.end_combo()


def _projection(render_queue: RenderQueue) -> None:
    settings = render_queue.settings
    for name in ("projection", "transparent"):
        if (changed := edit_field(settings, name)) is not settings:
            render_queue.change(**{name: getattr(changed, name)})


def _preview(render_queue: RenderQueue) -> None:
    """Draw the last previewed frame as wide as the panel, on a checkerboard where it is transparent."""
    help_text = "Render the frame at the playhead in the background, in full size, exactly as it would be written."
    if button("Preview frame", help_text, width=-1, enabled=not render_queue.is_previewing):
        render_queue.preview_frame()
    if (texture := render_queue.preview_texture) is None:
        return
    width = imgui.get_content_region_avail().x
    low, height = imgui.get_cursor_screen_pos(), width * texture.height / max(texture.width, 1)
    high, draw = ImVec2(low.x + width, low.y + height), imgui.get_window_draw_list()
    draw.push_clip_rect(low, high, True)
    for row in range(int(height / _CHECK_PX) + 1):
        for column in range(int(width / _CHECK_PX) + 1):
            at = ImVec2(low.x + column * _CHECK_PX, low.y + row * _CHECK_PX)
            gray = _CHECKS[(row + column) % 2]
            draw.add_rect_filled(at, ImVec2(at.x + _CHECK_PX, at.y + _CHECK_PX), color((gray, gray, gray, 1.0)))
    draw.pop_clip_rect()
    draw.add_image(imgui.ImTextureRef(texture.name), low, high)
    imgui.dummy(ImVec2(width, height))
    imgui.set_item_tooltip(f"{texture.width} x {texture.height} px, as it would be written.")


_CHECK_PX, _CHECKS = 12.0, (0.55, 0.72)


def _format(render_queue: RenderQueue) -> None:
    settings = render_queue.settings
    plain_label("Format", "A video, or a folder of numbered frames.")
    if (codec := combo("##format", settings.codec, _FORMATS)) != settings.codec:
        render_queue.change(codec=codec, quality=None)
    settings = render_queue.settings
    if settings.codec not in _QUALITIES:
        return
    title, help_text, lowest, highest = _QUALITIES[settings.codec]
    plain_label(title, help_text)
    imgui.set_next_item_width(-_CHECKBOX_EM * imgui.get_font_size())
    quality, default = settings.quality, DEFAULT_QUALITY.get(settings.codec, DEFAULT_JPEG_QUALITY)
    with disabled(quality is None):
        changed, new = slide_whole("##quality", default if quality is None else quality, lowest, highest)
    if changed:
        render_queue.change(quality=new)
    imgui.same_line()
    is_default = checkbox("Default###usual", quality is None, "The format's default quality: hardly a visible loss.")
    if is_default != (quality is None):
        render_queue.change(quality=None if is_default else default)


def _size(render_queue: RenderQueue) -> None:
    present = render_queue.settings.size_px
    field_label("size_px", ExportSettings)
    if imgui.begin_combo("##size", _SIZES.get(present, "other")):
        for size, title in _SIZES.items():
            if imgui.selectable(title, size == present)[0]:
                render_queue.change(size_px=size)
        imgui.end_combo()
    if present is None:
        return
    plain_label("", "")
    changed, size = imgui.input_int2("##size_px", list(present))
    imgui.set_item_tooltip("Width and height in pixels; even numbers for a video.")
    if changed:
        width, height = (min(max(side, 1), LARGEST_PX) for side in size)
        render_queue.change(size_px=(width, height))


def _cameras(document: Document, render_queue: RenderQueue) -> None:
    field_label("cameras", ExportSettings)
    present = render_queue.settings.cameras
    if not imgui.begin_combo("##cameras", "all rig cameras" if present == ("all",) else ", ".join(present) or _PATH):
        return

    def choice(title: str, cameras: tuple[str, ...]) -> None:
        if imgui.selectable(title, present == cameras)[0]:
            render_queue.change(cameras=cameras)

    choice(_PATH, ())
    for rig, mounted in document.scene.rigs.items():
        imgui.separator_text(visible_name(rig))
        if len(mounted) > 1:
            choice(label(f"all of {rig}"), (rig,))
        for camera in mounted:
            name = f"{rig}/{camera.name}"
            choice(label(f"{camera.name}  ({camera.width} x {camera.height})", name), (name,))
    if len(document.scene.rigs) > 1:
        imgui.separator()
        choice("all rig cameras", ("all",))
    imgui.end_combo()


def _times(render_queue: RenderQueue, playback: Playback) -> None:
    settings = render_queue.settings
    help_text = "Record what the timeline plays; From and To below end that."
    if (follows := checkbox("Timeline range", render_queue.follows_range, help_text)) != render_queue.follows_range:
        render_queue.follows_range = follows
    if follows:
        imgui.same_line()
        start, end = playback.span_s
        imgui.text_disabled(f"{start:.2f} to {end:.2f} s")
    field_label("fps", ExportSettings)
    changed, fps = imgui.input_float("##fps", settings.fps, 0.0, 0.0, "%.6g")
    if changed:
        render_queue.change(fps=min(max(fps, 0.1), 1000.0))
    field_label("first_s", ExportSettings)
    changed, first_s = imgui.drag_float("##first_s", settings.first_s, 0.02, -36000.0, 36000.0, "%.2f s")
    end_s = settings.last_s or 0.0
    if changed and first_s < end_s:
        render_queue.change(first_s=first_s)
    field_label("last_s", ExportSettings)
    changed, last_s = imgui.drag_float("##last_s", end_s, 0.02, settings.first_s + 1e-3, 36000.0, "%.2f s")
    if changed and last_s > settings.first_s:
        render_queue.change(last_s=last_s)


def _passes(render_queue: RenderQueue) -> None:
    settings = render_queue.settings
    for name, (title, help_text) in _PASSES.items():
        is_on = name in settings.passes
        if checkbox(f"{title}###{name}", is_on, help_text) != is_on:
            passes = tuple(each for each in _PASSES if (each in settings.passes) != (each == name))
            if passes:
                render_queue.change(passes=passes)
        if name in ("color", "depth"):
            imgui.same_line()
    info = field_of(ExportSettings, "twin")
    titles = {None: "none", "sunny": "sunny", "overcast": "overcast"}
    plain_label(info.title, info.help)
    if (twin := combo("##twin", settings.twin, titles)) != settings.twin:
        render_queue.change(twin=twin)


def _count(render_queue: RenderQueue, name: str, highest: int, form: str, flags: int) -> None:
    field_label(name, ExportSettings)
    value = getattr(render_queue.settings, name)
    text = "off" if value == 1 else form.format(value)
    changed, value = slide_whole(f"##{name}", value, 1, highest, text, flags)
    if changed:
        render_queue.change(**{name: value})
