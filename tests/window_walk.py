"""Words and rectangles of all that a window shows, for tests that look for what is cut or lies on something else."""

from typing import NamedTuple

from msgspec.structs import replace

from window_driver import hello_imgui, imgui


class Rect(NamedTuple):
    """A rectangle on the screen."""

    left: float
    top: float
    right: float
    bottom: float

    @classmethod
    def of(cls, rect):
        return cls(rect.min.x, rect.min.y, rect.max.x, rect.max.y)

    def meets(self, other):
        """Return whether more than the edges of both are at the same place."""
        across = min(self.right, other.right) - max(self.left, other.left)
        return across > 1 and min(self.bottom, other.bottom) - max(self.top, other.top) > 1

    def holds(self, other):
        is_across = self.left - 1 <= other.left and other.right <= self.right + 1
        return is_across and self.top - 1 <= other.top and other.bottom <= self.bottom + 1


def windows(parent=None):
    """Rectangles of the windows on the screen by name, or of those in one of them, whose names are short."""
    found = {}
    for each in imgui.get_current_context().windows:
        folder, _, name = each.name.rpartition("/")
        if each.active and not each.hidden and (parent is None or folder == parent):
            found[name.rpartition("_")[0] if parent else each.name] = Rect.of(each.rect())
    return found


def screen():
    """Rectangle of the window of the program."""
    low, size = imgui.get_main_viewport().pos, imgui.get_main_viewport().size
    return Rect(low.x, low.y, low.x + size.x, low.y + size.y)


def meetings(rects):
    """Pairs of names whose rectangles lie on each other."""
    names = sorted(rects)
    return {(a, b) for number, a in enumerate(names) for b in names[number + 1 :] if rects[a].meets(rects[b])}


def resize(driver, size_px, font_scale):
    """Change the size of the window, in points of its screen, and that of its text."""
    wide, tall = (round(side * driver.dpi_scale) for side in size_px)
    preferences = driver.editor.preferences
    preferences.value = replace(preferences.value, font_scale=font_scale)
    hello_imgui.change_window_size((wide, tall))

    def is_there():
        size = imgui.get_main_viewport().size
        return (round(size.x), round(size.y)) == (wide, tall)

    driver.until(is_there)
    driver.frames(4)
