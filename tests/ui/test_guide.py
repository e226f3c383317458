"""The guide in the window: its pages, and the one that each panel leads to."""

import re

import pytest

from gsrain_engine.editor.guide import FIRST_PAGE, blocks_of, guide_page, guide_pages
from ui.commands.keys import chord
from ui.panels.registry import BUILT_IN_PANELS
from window_driver import imgui

KEY = imgui.Key
GUIDE = chord(KEY.mod_shift, KEY.f1)


def test_markdown_becomes_blocks_of_plain_text():
    text = """# Rain

A *first* line with [a link](x.md),
`code` and **bold** words: 2 * 3 * 4.

* An item
  in two lines
  1. below it

![Picture](a.jpg)

    gsrain street

| tool | does | |
|---|---|---|
| Box (X) | selects | ![](b.jpg) |
"""
    assert [tuple(each) for each in blocks_of(text)] == [
        ("heading", "Rain", 1),
        ("paragraph", "A first line with a link, code and bold words: 2 * 3 * 4.", 0),
        ("item", "An item in two lines", 0),
        ("item", "below it", 1),
        ("code", "gsrain street", 0),
        ("item", "Box (X): selects", 0),
    ]


@pytest.mark.parametrize("page", guide_pages())
def test_every_page_has_a_title_and_leaves_no_marks(page):
    blocks = guide_page(page)
    assert blocks[0].kind == "heading" and blocks[0].text == guide_pages()[page]
    words = [each.text for each in blocks if each.kind != "code"]
    assert len(words) > 5 and not [each for each in words if "](" in each or "**" in each or "`" in each]


@pytest.mark.parametrize("panel", BUILT_IN_PANELS, ids=lambda panel: panel.title)
def test_the_page_and_the_heading_of_each_panel_exist(panel):
    page, _, anchor = panel.page.partition("#")
    assert page in guide_pages()
    assert not anchor or anchor in [each.anchor for each in guide_page(page) if each.kind == "heading"]
    assert any(re.search(rf"\b{panel.title}\b", each.text, re.IGNORECASE) for each in guide_page(page))


def test_each_panel_leads_to_its_page_and_the_window_lists_all(driver):
    options = driver.editor.viewport.options
    assert options.guide == "" and options.guide_of_focus.partition("#")[0] in guide_pages()
    for title, page in {each.title: each.page for each in BUILT_IN_PANELS}.items():
        driver.panel(title)
        driver.press(GUIDE)
        assert options.guide == page and driver.is_open("Guide"), title
        options.guide = ""
        driver.frames()
    driver.panel("Record")
    driver.tap("//**/###guide Record")
    assert options.guide == "timeline_and_recording.md#recording"
    scrolled = [each.scroll.y for each in imgui.get_current_context().windows if each.name.startswith("Guide/page")]
    assert max(scrolled) > 100  # at its heading
    driver.ctx.window_close("//Guide")
    driver.press(chord(KEY.mod_ctrl, KEY.p))
    driver.ctx.key_chars("help: wet look")
    driver.press(KEY.enter)
    assert options.guide == "wet_colors.md#wet-look"
    options.guide = ""
    driver.frames()
    driver.menu("Help/Guide")
    assert driver.is_open("Guide")
    driver.choose("//Guide/##page", guide_pages()[FIRST_PAGE])
    assert options.guide == FIRST_PAGE
    driver.ctx.window_close("//Guide")
    driver.frames()
    assert options.guide == ""
    driver.ctx.window_focus("//View")
    driver.frames()
    driver.press(GUIDE)
    assert options.guide == "looking_around.md"
