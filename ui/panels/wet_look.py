"""Wet look panel: method, views, preview, job and result."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.registry import usable_methods
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import JobRunner
from gsrain_engine.editor.jobs.make_rainy import MAKE_RAINY_TITLE, PreviewPicture
from gsrain_engine.editor.live_rain import LiveRain
from gsrain_engine.editor.make_rainy import SOURCES, TITLES, WetLookController
from gsrain_engine.editor.viewport.options import Texture
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.rain.settings import CALIBRATED_UP_TO_MM_H

from ..widgets import fields
from ..widgets.fields import button, combo, edit_choice, edit_field, faint, warn
from ..widgets.file_dialogs import ALL_FILES, path_field
from .jobs import job_fields
from .rain import wetness_fields
from .training import transfer_training_fields

_ICONS = icons_fontawesome_6
_WEIGHTS = f"Weights{{.pkl,.safetensors,.ckpt,.pt}},{ALL_FILES}"
_PATHS = {"weights": _WEIGHTS, "images": "", "base": "", "normals_weights": _WEIGHTS, "normals_checkout": ""}
"""Settings that are paths, with their file types; "" for folders."""

_LABELS = {"normals_weights": "Normals weights", "normals_checkout": "DSINE code"}
_MAX_PREVIEW_EM = 7.0  # small, since the viewport shows the preview at full size
_ENLARGED_EM = 28.0  # longer side of an image under the mouse
_PICTURES: dict[PreviewPicture, tuple[str, str]] = {
    "clear": ("before", "The clear view."),
    "framed": ("input", "The view at the size and proportions in which the network saw it."),
    "guide": ("guide", "The network's fourth channel, from the normals."),
    "rainy": ("after", "The transferred view, soaked."),
}
"""Caption and help of the images of a preview."""
_SOURCE_HELP = (
    "Views to transfer. The best are those of the rig if the scene has a recorded drive,\n"
    "else those of its camera path, else views around its middle.\n"
    "The computed wet look needs none: it only previews some."
)
_MAKE_HELP = (
    "Make the scene's wet colors in the background: computed, or solved for so that they reproduce the views.\n"
    "The clear colors stay: the rain's intensity blends the wet ones in. One undo step."
)
_PREVIEW_HELP = (
    "Transfer the present view within seconds, and show it right of the live image.\n"
    "It is soaked (wetness 1), like the wet colors that the job creates."
)
_COMPARE_HELP = "Show the clear scene left and the rainy scene right of a line that can be dragged."


def wet_look_panel(editor: Editor) -> None:
    viewport, wet_look, jobs = editor.viewport, editor.wet_look, editor.jobs
    _method(wet_look)
    _views(wet_look)
    imgui.spacing()
    _preview(wet_look, jobs)
    _make(viewport, wet_look, jobs)
    if editor.document.scene.has_wet_colors:
        _result(editor.document, viewport, editor.live_rain, wet_look)
    if imgui.collapsing_header("Train transfer"):
        transfer_training_fields(viewport, editor.finetune, jobs)


def _method(wet_look: WetLookController) -> None:
    fields.plain_label("Method", "Method of the transfer from clear to rainy views.")
    wet_look.method = combo(
        "##method", wet_look.method, {each.name: each.title for each in usable_methods()}, wet_look.row.help
    )
    names = [name for name in wet_look.row.uses if _applies(name, wet_look.settings)]
    for name in names[:1]:
        _setting(wet_look, name)
    if names[1:] and imgui.tree_node("More settings"):
        for name in names[1:]:
            _setting(wet_look, name)
        imgui.tree_pop()
    faint(wet_look.training)
    warn(wet_look.why_no_transfer)


def _applies(name: str, settings: TransferSettings) -> bool:
    if name == "normals_weights":
        return settings.normals in ("dsine", "marigold")
    if name == "normals_checkout":
        return settings.normals == "dsine"
    return (name != "guide" or settings.normals != "none") and (name != "neighbours" or settings.mutual_attention)


def _setting(wet_look: WetLookController, name: str) -> None:
    settings, label = wet_look.settings, _LABELS.get(name)
    if name in _PATHS:
        is_folder = name == "normals_weights" and settings.normals == "marigold"
        path_field(settings, name, "" if is_folder else _PATHS[name], partial(_take, wet_look, name), label=label)
    else:
        wet_look.settings = edit_field(settings, name, label=label)


def _take(wet_look: WetLookController, name: str, path: Path | None) -> None:
    wet_look.change(**{name: path})


def _views(wet_look: WetLookController) -> None:
    choice = edit_choice(wet_look.choice, "source", {each: TITLES[each] for each in SOURCES}, _SOURCE_HELP)
    choice = edit_field(choice, "count", label="Number of views")
    wet_look.choice = edit_field(choice, "width_px", label="Width (px)", step=16)
    warn(wet_look.why_no_views(choice.source))


def _preview(wet_look: WetLookController, jobs: JobRunner) -> None:
    title = f"{_ICONS.ICON_FA_EYE}  Preview this view###preview"
    if button(title, _PREVIEW_HELP, width=-1, why_not=wet_look.why_no_preview):
        wet_look.preview()
    previewed, stale = wet_look.previewed, wet_look.what_is_stale
    if previewed is None or not wet_look.textures or jobs.running:
        return  # a running job shows its own previews
    _pictures(wet_look.textures, 1.0 if stale is None else 0.5)
    faint(previewed.images.note)
    if stale is not None:
        imgui.align_text_to_frame_padding()
        imgui.text_disabled(stale)
        if not wet_look.fits:
            imgui.same_line()
            if imgui.small_button("Return to it"):
                wet_look.look_from_preview()
            imgui.set_item_tooltip("Look from the camera of the preview.")


def _pictures(textures: Mapping[PreviewPicture, Texture], opacity: float) -> None:
    """Draw the images in a row of equal heights, each above its name, and the one under the mouse enlarged."""
    em, gap = imgui.get_font_size(), imgui.get_style().item_spacing.x
    aspects = {name: each.width / each.height for name, each in textures.items()}
    free = imgui.get_content_region_avail().x - gap * (len(textures) - 1)
    height = min(free / sum(aspects.values()), _MAX_PREVIEW_EM * em)
    for number, (name, texture) in enumerate(textures.items()):
        if number:
            imgui.same_line()
        caption, help_text = _PICTURES[name]
        width = height * aspects[name]
        imgui.begin_group()
        tint = (1.0, 1.0, 1.0, opacity)
        imgui.image_with_bg(imgui.ImTextureRef(texture.name), ImVec2(width, height), tint_col=tint)
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(0.0, (width - imgui.calc_text_size(caption).x) / 2))
        imgui.text_disabled(caption)
        imgui.end_group()
        if imgui.begin_item_tooltip():
            imgui.text_unformatted(f"{help_text}\n{texture.width} x {texture.height} px")
            size = _ENLARGED_EM * em / max(texture.width, texture.height)
            imgui.image(imgui.ImTextureRef(texture.name), ImVec2(size * texture.width, size * texture.height))
            imgui.end_tooltip()


def _make(viewport: ViewportState, wet_look: WetLookController, jobs: JobRunner) -> None:
    title, height = f"{_ICONS.ICON_FA_CLOUD_SHOWERS_HEAVY}  {MAKE_RAINY_TITLE}###make", imgui.get_frame_height()
    if button(title, _MAKE_HELP, width=-1, height=1.5 * height, why_not=wet_look.why_not):
        wet_look.make()
    if (newest := jobs.newest("make rainy", "preview")) is not None:
        imgui.separator_text(newest.title)
        job_fields(viewport, jobs, newest)


def _result(document: Document, viewport: ViewportState, live_rain: LiveRain, wet_look: WetLookController) -> None:
    """Draw the blending of wet colors, and the comparison with the clear ones."""
    imgui.separator_text("Wet colors")
    if live_rain.wetness_now == 0:
        imgui.text_wrapped("The scene is dry now: the wetness follows the rain.")
    high = max(CALIBRATED_UP_TO_MM_H, document.rain_now.intensity_mm_h)
    fields.slider(document, "intensity_mm_h", high=high, label="Scene rain (mm/h)")
    wetness_fields(document, live_rain, label="Scene wetness")
    is_compared = viewport.options.split == "clear | rainy"
    title = (
        f"{_ICONS.ICON_FA_TABLE_COLUMNS}  {'Stop comparing' if is_compared else 'Compare clear and rainy'}###compare"
    )
    why_not = None if is_compared else wet_look.why_no_comparison
    if button(title, _COMPARE_HELP, width=-1, why_not=why_not):
        if is_compared:
            viewport.options.split = "off"
        else:
            wet_look.compare()
