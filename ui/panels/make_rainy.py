"""Panel "Make it rainy": method, views, preview, job and result."""

from functools import partial
from pathlib import Path

import msgspec
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.registry import usable_methods
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.make_rainy import MAKE_RAINY_TITLE
from gsrain_engine.editor.make_rainy import SOURCES, TITLES, why_no_views
from gsrain_engine.rain.settings import CALIBRATED_UP_TO_MM_H

from ..widgets import fields
from ..widgets.fields import ALL_FILES, edit_field, path_field
from .jobs import job_fields
from .rain import WARNING, wetness_fields
from .training import transfer_training_fields

_ICONS = icons_fontawesome_6
_WEIGHTS = f"Weights{{.pkl,.safetensors,.ckpt,.pt}},{ALL_FILES}"
_PLACES = {"weights": _WEIGHTS, "images": "", "base": "", "normals_weights": _WEIGHTS, "normals_checkout": ""}
"""Settings that are paths, with their file types; "" for folders."""

_LABELS = {"normals_weights": "Their weights", "normals_checkout": "Its program"}
_FIRST = 1  # number of a method's settings that are always visible
_HIGHEST_PREVIEW_EM = 7.0  # small, since the viewport shows the preview at full size

_MAKE_HELP = (
    "Transfer the views, then solve for the wet colours in which the scene looks like them, in the background.\n"
    "The clear colours stay: the rain's intensity blends the wet ones in. One step; undo takes it back."
)

_PREVIEW_HELP = (
    "Transfer what the view shows, in seconds, and lay it beside the live picture.\n"
    "It is soaked (wetness 1), as the wet colours are that the job makes."
)


def wet_look_panel(session: Editor) -> None:
    _method(session)
    _views(session)
    imgui.spacing()
    _preview(session)
    _make(session)
    _result(session)
    if imgui.collapsing_header("Train the transfer"):
        transfer_training_fields(session)


def _method(session: Editor) -> None:
    rainy = session.rainy
    fields.plain_label("Method", "What makes a view look rainy.")
    methods = usable_methods()
    names = [each.name for each in methods]
    changed, at = imgui.combo("##method", names.index(rainy.method), [each.title for each in methods])
    imgui.set_item_tooltip(rainy.row.help)
    if changed:
        rainy.method = names[at]
    shown = [name for name in rainy.row.uses if _concerns(name, rainy.settings)]
    for name in shown[:_FIRST]:
        _setting(session, name)
    if shown[_FIRST:] and imgui.tree_node("More settings"):
        for name in shown[_FIRST:]:
            _setting(session, name)
        imgui.tree_pop()
    if (why_not := rainy.why_no_transfer) is not None:
        _warn(why_not)


def _concerns(name: str, settings: TransferSettings) -> bool:
    if name == "normals_weights":
        return settings.normals in ("dsine", "marigold")
    if name == "normals_checkout":
        return settings.normals == "dsine"
    return (name != "guide" or settings.normals != "none") and (name != "neighbours" or settings.mutual_attention)


def _setting(session: Editor, name: str) -> None:
    rainy = session.rainy
    if name in _PLACES:
        take = partial(_take, session, name)
        is_folder = name == "normals_weights" and rainy.settings.normals == "marigold"
        path_field(rainy.settings, name, "" if is_folder else _PLACES[name], take, label=_LABELS.get(name))
    else:
        rainy.settings = edit_field(rainy.settings, name, label=_LABELS.get(name))


def _take(session: Editor, name: str, text: str) -> None:
    session.rainy.change(**{name: Path(text).expanduser() if text.strip() else None})


def _views(session: Editor) -> None:
    rainy = session.rainy
    choice = rainy.choice
    fields.plain_label("Views", fields.field_info("source", type(choice)).help)
    changed, at = imgui.combo("##source", SOURCES.index(choice.source), [TITLES[each] for each in SOURCES])
    imgui.set_item_tooltip(
        "Where the views are taken that become rainy: the best are the rig's where the scene has a drive,\n"
        "else those of its camera path, else from around its middle."
    )
    if changed:
        choice = msgspec.structs.replace(choice, source=SOURCES[at])
    choice = edit_field(choice, "count", label="How many")
    rainy.choice = edit_field(choice, "width_px", label="Width (px)", step=16)
    if (why_not := why_no_views(session, choice.source)) is not None:
        _warn(why_not)


def _preview(session: Editor) -> None:
    rainy = session.rainy
    why_not = rainy.why_no_preview(session)
    imgui.begin_disabled(why_not is not None)
    if imgui.button(f"{_ICONS.ICON_FA_EYE}  Preview this view###preview", (-1, 0)):
        rainy.preview(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(_PREVIEW_HELP if why_not is None else why_not)
    texture, stale = rainy.texture, rainy.what_is_stale(session)
    if texture is None or session.running_jobs:
        return  # a running job shows its own previews
    highest = _HIGHEST_PREVIEW_EM * imgui.get_font_size()
    width = min(imgui.get_content_region_avail().x, highest * texture.width / texture.height)
    faint = (1.0, 1.0, 1.0, 1.0 if stale is None else 0.5)
    size = ImVec2(width, width * texture.height / texture.width)
    imgui.image_with_bg(imgui.ImTextureRef(texture.name), size, tint_col=faint)
    imgui.set_item_tooltip("The view after its transfer, soaked.")
    if stale is not None:
        imgui.align_text_to_frame_padding()
        imgui.text_disabled(stale)
        if not rainy.fits(session):
            imgui.same_line()
            if imgui.small_button("Go back to it"):
                rainy.look_from_preview(session)
            imgui.set_item_tooltip("Look from where the preview was made.")


def _make(session: Editor) -> None:
    rainy, newest = session.rainy, session.newest_job("make rainy", "preview")
    if newest is not None and newest[1].state == "running":
        imgui.separator_text(newest[1].title)
        job_fields(session, newest[1], newest[0])
        return
    why_not = rainy.why_not(session)
    imgui.begin_disabled(why_not is not None)
    if imgui.button(
        f"{_ICONS.ICON_FA_CLOUD_SHOWERS_HEAVY}  {MAKE_RAINY_TITLE}###make", (-1, 1.5 * imgui.get_frame_height())
    ):
        rainy.make(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(_MAKE_HELP if why_not is None else why_not)
    if newest is not None:
        imgui.separator_text(newest[1].title)
        job_fields(session, newest[1], newest[0])


def _result(session: Editor) -> None:
    """Draw the blending of wet colors, and the comparison with the clear ones."""
    if not session.scene.has_wet_colors:
        return
    imgui.separator_text("Wet colours")
    if session.wetness_now == 0:
        imgui.text_wrapped("The scene is dry now: wet colours come with the rain.")
    fields.slider(session, "intensity_mm_h", high=max(CALIBRATED_UP_TO_MM_H, session.rain_now.intensity_mm_h))
    wetness_fields(session)
    is_compared = session.view.split == "clear | rainy"
    label = "Stop comparing" if is_compared else "Compare"
    if imgui.button(f"{_ICONS.ICON_FA_TABLE_COLUMNS}  {label}###compare", (-1, 0)):
        if is_compared:
            session.view.split = "off"
        else:
            session.rainy.compare(session)
    imgui.set_item_tooltip(
        "Lay the clear scene left of a line that can be dragged, the rainy one right of it.\n"
        "Where it does not rain, the intensity becomes 8.5 mm/h, as a step."
    )


def _warn(words: str) -> None:
    imgui.push_style_color(imgui.Col_.text, WARNING)
    imgui.text_wrapped(words)
    imgui.pop_style_color()
