"""Words in the window: none are cut at the edge of their panel, and numbers are written as people write them."""

import pytest
from msgspec.structs import replace

from gsrain_engine.fields import short_number
from gsrain_engine.scene.progress import figure_text
from ui.panels.registry import BUILT_IN_PANELS
from ui.widgets.fields import error_color, warning_color
from ui.widgets.numbers import plain_form
from ui.widgets.text import shortened
from window_driver import imgui

SIZES = {
    "1100x720": ((1100, 720), 1.0, 1.0),
    "420x300": ((420, 300), 1.0, 1.0),
    "1366x768, text 150 %": ((1366, 768), 1.0, 1.5),
    "1600x1000, two pixels a point": ((1600, 1000), 2.0, 1.0),
    "1920x1080, text 80 %": ((1920, 1080), 1.0, 0.8),
}
"""Size of the window, scale of its screen, and of its text."""


@pytest.fixture(params=SIZES)
def driver(unopened, request):
    unopened.size_px, unopened.dpi_scale, font_scale = SIZES[request.param]
    preferences = unopened.editor.preferences
    preferences.value = replace(preferences.value, font_scale=font_scale)
    return unopened


def test_no_words_are_cut_at_the_edge_of_a_panel(driver, cut):
    driver.editor.viewport.backend_reason = "a measured time of 12 ms a picture, where the other back end takes 14 ms"
    found = {}
    for panel in BUILT_IN_PANELS:
        folded = driver.window.workspace.folded
        if panel.title in folded.hidden:
            folded.open = panel.title  # by the strip, or by a menu where the strip has to be scrolled
            driver.frames()
        else:
            driver.panel(panel.title)
        driver.frames()
        cut.clear()  # the first frames of a panel find its layout
        driver.frames()
        found |= {panel.title: set(cut)} if cut else {}
    assert found == {}


def test_words_without_room_end_in_an_ellipsis(driver):
    words, width_px = "1 waiting, 62 %  Record street.mp4", 120.0
    shown = shortened(words, width_px)
    kept = shown.removesuffix("\u2026")
    assert kept != shown and words.startswith(kept) and imgui.calc_text_size(shown).x <= width_px
    assert imgui.calc_text_size(f"{words[: len(kept) + 2]}\u2026").x > width_px
    assert shortened(words, 1000.0) == words and shortened(words, 1.0) == "\u2026"


def test_numbers_have_units_and_no_exponents():
    figures = {"gaussians": 65960.0, "seconds per frame": 0.91784, "loss": 0.01234, "residual": 5.2e-5}
    assert [figure_text(*each) for each in figures.items()] == [
        "65,960 Gaussians", "0.918 s per frame", "loss 0.0123", "residual 0.000052",
    ]  # fmt: skip
    assert figure_text("psnr_held_out_db", 27.3149) == "held-out views 27.3 dB"
    assert figure_text("cycle_clear", float("nan")) == "cycle clear not finite"
    assert [short_number(each) for each in (0.0, -0.5, 99.6, 999.6, 1e7, -65960.4)] == [
        "0", "-0.5", "99.6", "1,000", "10,000,000", "-65,960",
    ]  # fmt: skip
    numbers = (0.0, 5e-5, 1234.56, 9999.4, 65960.123, 1e7)
    assert [plain_form(each) % each for each in numbers] == ["0", "0.00005000", "1235", "9999", "65960", "10000000"]


GROUNDS = (
    "window_bg", "popup_bg", "menu_bar_bg", "frame_bg", "frame_bg_hovered", "button", "button_hovered", "button_active",
    "header", "header_hovered", "tab", "tab_selected", "tab_dimmed", "tab_dimmed_selected", "title_bg",
    "title_bg_active", "table_header_bg", "table_row_bg_alt",
)  # fmt: skip
BELOW = {"text": GROUNDS, "text_disabled": ("window_bg", "popup_bg", "table_row_bg_alt", "title_bg", "title_bg_active")}
"""Colors below words by their color; warnings and errors are on those of panels and cards."""


def luminance(color):
    """Relative luminance of WCAG 2.2 of a color from 0 to 1."""
    linear = [each / 12.92 if each <= 0.04045 else ((each + 0.055) / 1.055) ** 2.4 for each in color]
    return sum(weight * each for weight, each in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(first, second):
    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_words_have_the_contrast_of_wcag_aa(unopened, theme):
    found = {}

    def look():
        preferences = unopened.editor.preferences
        preferences.value = replace(preferences.value, theme=theme)
        unopened.frames()
        style = imgui.get_style()

        def over(name, below):
            color = style.color_(getattr(imgui.Col_, name))
            return [color.w * a + (1 - color.w) * b for a, b in zip((color.x, color.y, color.z), below, strict=True)]

        window = over("window_bg", (0.0, 0.0, 0.0))
        inks = {"text": over("text", window), "text_disabled": over("text_disabled", window)}
        inks |= {each.__name__: (each().x, each().y, each().z) for each in (warning_color, error_color)}
        for ink, color in inks.items():
            for ground in BELOW.get(ink, ("window_bg", "popup_bg")):
                if (ratio := contrast(color, over(ground, window))) < 4.5:
                    found[ink, ground] = round(ratio, 2)

    unopened.run(look)
    assert found == {}
