"""Panels and edits of other packages in the real window: those of docs/extending.md, and a panel that fails."""

import pytest

from extension_package import installed, titled_blocks
from repository import REPOSITORY
from ui.commands.keys import chord
from window_driver import imgui

_SULKS = """
from imgui_bundle import imgui
from ui.panels.registry import Panel

calls = []

def sulk(editor):
    calls.append(editor)
    imgui.push_id("never popped")
    imgui.begin_group()
    imgui.begin_disabled()
    if len(calls) == 1:
        raise RuntimeError("not today")
    imgui.end_disabled()
    imgui.end_group()
    imgui.pop_id()
    imgui.text("better")

PANEL = Panel("Sulks", "left bottom", sulk)
TAKEN = Panel("Rain", "right", sulk)
ASIDE = Panel("Aside", "top", sulk)
"""
_ENTRIES = {
    "cloudburst": "rain_lab.cloudburst:PANEL", "sulks": "sulky:PANEL", "taken": "sulky:TAKEN", "aside": "sulky:ASIDE",
}  # fmt: skip


@pytest.fixture
def packages(tmp_path):
    page = titled_blocks(REPOSITORY / "docs" / "extending.md")
    files = {name: page[name] for name in ("rain_lab/cloudburst.py", "rain_lab/fade.py")} | {"sulky.py": _SULKS}
    entries = {"gsrain.panels": _ENTRIES, "gsrain.scene_edits": {"fade": "rain_lab.fade:EDIT"}}
    with installed(tmp_path / "site", "rain-lab", files, entries):
        yield


def test_panels_of_packages_are_drawn_and_one_that_fails_takes_nothing_with_it(packages, driver, caplog):
    driver.click("//Cloudburst/Cloudburst")
    assert driver.editor.document.rain.intensity_mm_h == 100
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.z))
    assert driver.editor.document.rain.intensity_mm_h != 100
    import sulky

    driver.ctx.window_focus("//Sulks")
    driver.frames(4)
    assert len(sulky.calls) == 1
    assert driver.editor.status.problem.endswith("(sulky:PANEL of rain-lab): line 13 of sulky.py: not today")
    driver.click("//Sulks/Try again")
    driver.frames(4)
    assert len(sulky.calls) > 2
    driver.click("//Cloudburst/Cloudburst")  # the window lives on
    assert driver.editor.document.rain.intensity_mm_h == 100
    left_out = [each for each in caplog.messages if "left out" in each]
    for words in ("panel 'Rain'", "side 'top'"):
        assert any(words in each for each in left_out)


def test_edits_of_packages_are_in_menu_and_palette(packages, driver):
    document, jobs = driver.editor.document, driver.editor.jobs
    before = driver.picture()
    driver.menu("Scene/Fade colors")
    driver.until(lambda: not jobs.is_running("scene edit"))
    assert document.history.undo_label == "Fade colors"
    assert driver.picture().std() < before.std()
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.p))
    driver.ctx.key_chars("thin fog")
    driver.press(imgui.Key.enter)
    driver.until(lambda: not jobs.is_running("scene edit"))
    assert document.history.labels[-2:] == ["Fade colors", "Fade colors"]
