"""Panels in small windows: docks fold to a strip of their names, and a click opens one panel over the viewport."""

from collections.abc import Collection

from imgui_bundle import ImVec2, hello_imgui, imgui

from .widgets.text import visible_name

_MIN_WIDTH, _MIN_HEIGHT = 1100.0, 700.0  # of a window with docks, in pixels at text size 1 and DPI 1
_SIDES = ("LeftSpace", "LeftBottomSpace", "RightSpace", "RightBottomSpace")
_BOTTOM = ("BottomSpace",)
_OPEN_EM = 24.0  # width of the open panel, unless it is one of those below
_LOW = 0.6  # height of one of those, as a share of the viewport's
_GAP = 4.0
_APPEAR_FRAMES = 2  # from the unfolding of docks until all their windows are there


class FoldedPanels:
    """Folds the panels at the sides of a narrow window, and those below in a low one; unfolds them in a larger one."""

    def __init__(self) -> None:
        self.open: str = ""
        """Label of the panel that is open over the viewport; empty for none."""
        self.hidden: list[str] = []
        """Labels of the folded panels, in the order of the strip."""
        self._folded: tuple[str, ...] = ()
        self._known: set[str] = set()
        self._front = frozenset[str]()
        """Labels of the panels that were in front when docks were folded."""
        self._until_front = 0

    def update(self, front: Collection[str]) -> None:
        """Fold or unfold by the window's size. Once a frame, before panels are drawn; `front`: labels in front."""
        size, style = imgui.get_main_viewport().size, imgui.get_style()
        scale = style.font_scale_main * style.font_scale_dpi
        is_narrow, is_low = size.x < _MIN_WIDTH * scale, size.y < _MIN_HEIGHT * scale
        folded = (*(_SIDES if is_narrow else ()), *(_BOTTOM if is_low else ()))
        if folded != self._folded:
            if not self._folded:
                self._front = frozenset(front)
            self.unfold()
            self._folded = folded
            self._known = set()
            self._until_front = _APPEAR_FRAMES
        elif self._until_front:  # windows that appear take the front of their dock
            self._until_front -= 1
            for each in panel_windows() if not self._until_front else ():
                each.focus_window_at_next_frame = each.is_visible and each.label in self._front
        visible = [each for each in panel_windows() if each.is_visible and each.dock_space_name in folded]
        for each in visible:
            each.is_visible = each.focus_window_at_next_frame = False
            if each.label in self._known:  # a menu or a button asks for it
                self.open = each.label
        shown = {*self.hidden, *(each.label for each in visible)}
        self.hidden = [each.label for each in panel_windows() if each.label in shown]
        self._known = {each.label for each in panel_windows()}

    def unfold(self) -> None:
        """Put all folded panels back into their docks."""
        for each in panel_windows():
            each.is_visible = each.is_visible or each.label in self.hidden
        self._folded, self.hidden, self.open = (), [], ""

    @property
    def width(self) -> float:
        """Width of the strip in pixels; 0 if no panel is folded."""
        if not self.hidden:
            return 0.0
        widest = max(imgui.calc_text_size(visible_name(_title(each))).x for each in self.hidden)
        return widest + 2 * imgui.get_style().frame_padding.x + 2 * _GAP + imgui.get_style().scrollbar_size

    def draw(self, corner: ImVec2, height: float) -> None:
        """Draw the strip at a place in the viewport, and the open panel to its left."""
        if not self.hidden:
            return
        imgui.set_cursor_screen_pos(ImVec2(corner.x + _GAP, corner.y))
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(_GAP, 2.0))
        if imgui.begin_child("folded panels", ImVec2(self.width - _GAP, height)):
            for label in self.hidden:
                is_open = label == self.open
                color = imgui.Col_.button_active if is_open else imgui.Col_.button
                imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(color))
                if imgui.button(f"{visible_name(_title(label))}###fold {label}", ImVec2(-1, 0)):
                    self.open = "" if is_open else label
                imgui.set_item_tooltip("Close it." if is_open else "Open it over the view.")
                imgui.pop_style_color()
        imgui.end_child()
        imgui.pop_style_var()
        panel = next((each for each in panel_windows() if each.label == self.open), None)
        if panel is not None:
            self._draw_open(panel, corner, height)

    def _draw_open(self, panel: hello_imgui.DockableWindow, corner: ImVec2, height: float) -> None:
        room = corner.x - imgui.get_window_pos().x
        is_wide = panel.dock_space_name in _BOTTOM
        wide = room if is_wide else min(_OPEN_EM * imgui.get_font_size(), room)
        tall = _LOW * height if is_wide else height
        imgui.set_next_window_pos(ImVec2(corner.x - wide, corner.y + height - tall))
        imgui.set_next_window_size(ImVec2(wide, tall))
        imgui.set_next_window_bg_alpha(1.0)
        flags = imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_docking
        flags |= imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_collapse
        is_drawn, stays = imgui.begin(f"{_title(panel.label)}###open panel", True, flags)
        if is_drawn and panel.gui_function is not None:
            imgui.push_id(panel.label)
            panel.gui_function()
            imgui.pop_id()
        imgui.end()
        if not stays:
            self.open = ""


# Windows of panels


def show_panel(label: str) -> None:
    """Bring a panel to the front, wherever it is."""
    for each in panel_windows():
        if each.label == label:
            bring_to_front(each)


def bring_to_front(window: hello_imgui.DockableWindow) -> None:
    """Show a panel in front of those docked at the same place."""
    window.is_visible = window.focus_window_at_next_frame = True


def panel_windows() -> list[hello_imgui.DockableWindow]:
    """Return all windows except the viewport, which is always open."""
    windows = hello_imgui.get_runner_params().docking_params.dockable_windows
    return [each for each in windows if each.include_in_view_menu]


def _title(label: str) -> str:
    return label.partition("###")[0]
