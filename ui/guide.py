"""Window with the user's guide; it stays open beside what it describes."""

from imgui_bundle import imgui

from gsrain_engine.editor.guide import Block, guide_page, guide_pages
from gsrain_engine.editor.viewport_state import ViewportState

from .widgets.fields import combo, faint
from .widgets.popups import place_dialog

_WIDTH_EM, _HEIGHT_EM = 42.0, 40.0


def draw_guide(viewport: ViewportState) -> None:
    """Draw the page that `viewport.options.guide` names, if any, and the list of all pages."""
    options = viewport.options
    if not options.guide:
        return
    place_dialog(_WIDTH_EM, _HEIGHT_EM, imgui.Cond_.appearing)
    imgui.set_next_window_bg_alpha(1.0)
    flags = imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_collapse
    is_drawn, stays = imgui.begin("Guide", True, flags)
    if is_drawn:
        try:
            pages, blocks = guide_pages(), guide_page(options.guide)
        except OSError as error:
            imgui.text_wrapped(f"The guide can't be read: {error.strerror or error}")
        else:
            imgui.set_next_item_width(-1)
            options.guide = combo("##page", options.guide, pages, "Pages of the guide.")
            if imgui.begin_child(f"page##{options.guide}"):
                for block in blocks:
                    _draw(block)
            imgui.end_child()
    if imgui.is_window_focused(imgui.FocusedFlags_.root_and_child_windows) and imgui.is_key_pressed(imgui.Key.escape):
        stays = False
    imgui.end()
    if not stays:
        options.guide = ""


def _draw(block: Block) -> None:
    em = imgui.get_font_size()
    if block.kind == "heading":
        imgui.separator_text(block.text)
    elif block.kind == "code":
        faint(block.text or " ")
    elif block.kind == "item":
        shift = block.level * em
        imgui.indent(shift + 0.01)
        imgui.bullet()
        imgui.text_wrapped(block.text)
        imgui.unindent(shift + 0.01)
    else:
        imgui.text_wrapped(block.text)
        imgui.spacing()
