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
            page, _, anchor = options.guide.partition("#")
            pages, blocks = guide_pages(), guide_page(page)
        except OSError as error:
            imgui.text_wrapped(f"The guide can't be read: {error.strerror or error}")
        else:
            imgui.set_next_item_width(-1)
            if (chosen := combo("##page", page, pages, "Pages of the guide.")) != page:
                options.guide = chosen
            if imgui.begin_child(f"page##{options.guide}"):
                for block in blocks:
                    if anchor and block.kind == "heading" and block.anchor == anchor and imgui.is_window_appearing():
                        imgui.set_scroll_here_y(0.0)
                    _draw(block)
            imgui.end_child()
    if imgui.is_window_focused(imgui.FocusedFlags_.root_and_child_windows) and imgui.is_key_pressed(imgui.Key.escape):
        stays = False
    imgui.end()
    if not stays:
        options.guide = ""


def draw_guide_mark(viewport: ViewportState, title: str, page: str) -> None:
    """Draw a faint ? at the end of the tabs or the title of the window of a panel, which is drawn now.

    A click opens the panel's page of the guide.
    """
    no_color = imgui.ImVec4(0, 0, 0, 0)
    imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(imgui.Col_.text_disabled))
    if imgui.is_window_docked():
        clicked = False
        for color in _TAB_COLORS:
            imgui.push_style_color(color, no_color)
        if imgui.internal.dock_node_begin_amend_tab_bar(imgui.internal.get_window_dock_node()):
            clicked = imgui.tab_item_button(f"?###guide {title}", imgui.TabItemFlags_.trailing)
            imgui.set_item_tooltip(_HELP.format(title))
            imgui.internal.dock_node_end_amend_tab_bar()
        imgui.pop_style_color(len(_TAB_COLORS))
    else:
        clicked = _title_mark(title)
    imgui.pop_style_color()
    if clicked:
        viewport.options.guide = page


_HELP = "The guide about {} (Shift+F1)."
_TAB_COLORS = imgui.Col_.tab, imgui.Col_.tab_dimmed


def _title_mark(title: str) -> bool:
    """Draw the mark into the title bar, left of the button that closes the window; returns True if it is clicked."""
    bar, place = imgui.internal.get_current_window().title_bar_rect(), imgui.get_cursor_screen_pos()
    side = bar.max.y - bar.min.y
    imgui.push_clip_rect(bar.min, bar.max, False)
    imgui.set_cursor_screen_pos(imgui.ImVec2(bar.max.x - 2.2 * side, bar.min.y))
    imgui.push_style_color(imgui.Col_.button, imgui.ImVec4(0, 0, 0, 0))
    clicked = imgui.button(f"?###guide {title}", imgui.ImVec2(side, side))
    imgui.set_item_tooltip(_HELP.format(title))
    imgui.pop_style_color()
    imgui.pop_clip_rect()
    imgui.set_cursor_screen_pos(place)
    return clicked


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
