"""Numbers that may be left out, in the panel: a switch, and a word for what is then done."""

import pytest

from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.scene_views import ViewChoice
from gsrain_engine.rain.settings import RainSettings
from window_driver import Driver

pytest.importorskip("imgui_bundle")

from ui.widgets.fields import field_info

PANEL = "//Make it rainy/"


def test_what_a_field_says_about_being_left_out():
    tile = field_info("tile_px", TransferSettings)
    assert (tile.none, tile.initial, tile.multiple_of, tile.low, tile.high) == ("in one piece", 512, 64, 64, 4096)
    assert (field_info("side_px", TransferSettings).none, field_info("side_px", TransferSettings).initial) == (
        "as they are", 512,
    )  # fmt: skip
    assert field_info("count", ViewChoice).none is not None
    assert field_info("seed", TransferSettings).none is None and field_info("weights", TransferSettings).none is None
    assert field_info("intensity_mm_h", RainSettings).none is None


def test_a_number_is_given_and_left_out(tmp_path):
    driver = Driver(tmp_path)
    rainy = driver.editor.wet_look

    def script():
        ctx = driver.ctx
        ctx.window_focus("//Make it rainy")
        driver.frames()
        ctx.set_ref("//Make it rainy")
        ctx.combo_click("##method/CycleGAN-Turbo")
        ctx.item_open("More settings")
        assert not ctx.item_exists("More settings/##tile_px")
        ctx.item_click("More settings/##tile_px given")
        driver.frames()
        assert rainy.settings.tile_px == 512
        ctx.item_input_value("More settings/##tile_px/", 700)
        driver.frames()
        assert rainy.settings.tile_px == 704  # a multiple of 64
        ctx.item_click("More settings/##tile_px given")
        driver.frames()
        assert rainy.settings.tile_px is None
        ctx.item_click("##count given")
        driver.frames()
        assert rainy.choice.count is None
        ctx.item_click("##count given")
        driver.frames()
        assert rainy.choice.count == 24

    driver.run(script)
