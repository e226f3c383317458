"""Fixtures of the tests of the window; a test that takes `driver` runs in its open window."""

import inspect

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    given = {name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.function).parameters}
    if "driver" not in given:
        return None
    given["driver"].run(lambda: pyfuncitem.obj(**given))
    return True


@pytest.fixture(autouse=True)
def _default_preferences(tmp_path, monkeypatch):
    """Give each test the default preferences, not those that the window of another one has stored."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def unopened(tmp_path):
    """A window with the small scene, for the test to open; its pictures are saved in a folder of their own."""
    from window_driver import Driver  # skips where no window can open

    (tmp_path / "shots").mkdir()
    return Driver(tmp_path / "shots")


@pytest.fixture
def driver(unopened):
    """A window in which the test runs."""
    return unopened


_DRAWING = ("text", "text_disabled", "text_colored", "text_unformatted", "button", "checkbox", "radio_button")


@pytest.fixture
def cut(monkeypatch):
    """Words by window that reach beyond what can be seen of it, or of their button, so far.

    Those that scroll into view are not cut.
    """
    from window_driver import imgui

    found = set()

    def noting(function):
        def draw(*arguments, **options):
            result = function(*arguments, **options)
            words = next(each for each in arguments if isinstance(each, str)).partition("##")[0]
            left, right = imgui.get_item_rect_min().x, imgui.get_item_rect_max().x
            is_wider = function.__name__ == "button" and imgui.calc_text_size(words).x > right - left + 1
            is_drawn = not imgui.internal.get_current_window().skip_items and imgui.get_scroll_max_x() == 0
            if is_drawn and (is_wider or right > imgui.get_window_draw_list().get_clip_rect_max().x + 1):
                found.add((imgui.internal.get_current_window().name, words))
            return result

        return draw

    for name in _DRAWING:
        monkeypatch.setattr(imgui, name, noting(getattr(imgui, name)))
    return found


@pytest.fixture
def lines(monkeypatch):
    """Rectangles of the words that the last frame has drawn over the picture, by these words."""
    from window_driver import imgui
    from window_walk import Rect

    found, frames, add_text = {}, [0], imgui.ImDrawList.add_text

    def noting(draw_list, *arguments, **options):
        if frames[0] != imgui.get_frame_count():
            frames[0] = imgui.get_frame_count()
            found.clear()
        if imgui.internal.get_current_window().name == "View":
            with_font = len(arguments) > 3
            at, words, wrap = (arguments[2], *arguments[4:6]) if with_font else (arguments[0], arguments[2], -1.0)
            size = imgui.calc_text_size(words, False, wrap)
            found[words] = Rect(at.x, at.y, at.x + size.x, at.y + size.y)
        return add_text(draw_list, *arguments, **options)

    monkeypatch.setattr(imgui.ImDrawList, "add_text", noting)
    return found
