"""Sheets of rain intensities: numbers and images of the small scene."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from PIL import Image

from app.main import run
from gsrain_engine.editor.jobs import record
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render import intensity_sheet as sheets
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.render.intensity_sheet import SheetCell, intensity_sheet, write_sheet
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.progress import run_to_end
from small_scene import small_scene

SIZE = 160, 120


def cells_of(intensities, path, **changes):
    scene, rain = small_scene(), msgspec.structs.replace(load_preset("8.5"), **changes)
    sequence = FrameSequence(scene, RainSimulation.start(rain), default_path(scene, *SIZE), *SIZE, start_s=1.0)
    return run_to_end(write_sheet(CpuRenderer(), {"front": sequence, "rear": sequence}, intensities, path))


def test_harder_rain_changes_more_and_no_rain_nothing(tmp_path):
    clear, light, heavy, *others = cells_of([0.0, 2.0, 50.0], tmp_path / "sheet.png")
    assert [(each.view, each.intensity_mm_h) for each in (clear, light, heavy)] == [
        ("front", 0.0), ("front", 2.0), ("front", 50.0)
    ]  # fmt: skip
    assert (clear.mean_change, clear.visible_share, clear.streaks_drawn, clear.visible_streaks) == (0, 0, 0, 0)
    assert 0 < light.mean_change < heavy.mean_change
    assert light.visible_share < heavy.visible_share <= 1
    assert light.streaks_drawn < heavy.streaks_drawn and 0 < heavy.visible_streaks <= heavy.streaks_drawn
    for own, other in zip((clear, light, heavy), others, strict=True):
        np.testing.assert_array_equal(own.image, other.image)


def test_fog_is_no_change_by_rain(tmp_path):
    clear, light = cells_of([0.0, 2.0], tmp_path / "clear.png")[:2]
    dry, foggy = cells_of([0.0, 2.0], tmp_path / "fog.png", visibility_m=50.0)[:2]
    assert np.abs(dry.image.astype(int) - clear.image).mean() > 2 * light.mean_change  # fog is far more than that
    assert (dry.mean_change, dry.visible_share) == (0, 0)
    assert 0 < foggy.mean_change < 2 * light.mean_change


def test_each_image_is_the_still_of_the_scene_in_that_rain(tmp_path, monkeypatch):
    """Cells of the command and of the window's job, of a scene that is saved dry, with wet colors and keyframes."""
    scene = small_scene()
    layers = tuple(replace(each, wet_sh=0.5 * each.gaussians.sh) for each in scene.layers)
    keys = {"keys": [{"time_s": 0.0, "intensity_mm_h": 0.0, "wind_m_s": [3, 0]}, {"time_s": 9.0, "wind_m_s": [0, 9]}]}
    write_scene(replace(scene, layers=layers, rain={"intensity_mm_h": 0.0}, weather=keys), tmp_path / "scene")
    command, rates = ["render", str(tmp_path / "scene"), "--size", "96x64", "--time", "1"], (0.0, 20.0)
    stills = []
    for rate in rates:
        assert run([*command, "--rain", str(rate), "-o", str(tmp_path / "still.png")]) == 0
        stills.append(np.asarray(Image.open(tmp_path / "still.png")))
    assert not np.array_equal(*stills)

    cells = []
    monkeypatch.setattr(sheets, "intensity_sheet", lambda found: cells.append(found) or found[0].image)
    monkeypatch.setattr(record, "SHEET_MM_H", rates)
    assert run([*command, "--sheet", "0,20", "-o", str(tmp_path / "sheet.png")]) == 0
    settings = ExportSettings(output=str(tmp_path / "sheet.png"), size_px=(96, 64), first_s=1.0)
    run_to_end(record.sheet_in_worker(tmp_path / "scene", settings))
    assert len(cells) == 2
    for found in cells:
        for cell, still in zip(found, stills, strict=True):
            np.testing.assert_array_equal(cell.image, still)


def test_the_close_up_has_the_largest_change():
    clear = np.full((100, 150, 3), 90, np.uint8)
    rainy = clear.copy()
    rainy[20:40, 60:90] = 140
    cells = [SheetCell("", rate, image, 0.0, 0.0, 0, 0) for rate, image in ((0.0, clear), (8.5, rainy))]
    sheet = intensity_sheet(cells)
    gap = (sheet.shape[1] - 150) // 2
    assert (sheet[gap + 62 : gap + 98, gap + 92 : gap + 148] == 90).all()  # the enlargement of the dry image
    red = (sheet[..., 0].astype(int) - sheet[..., 1]) > 100
    assert red[gap + 20, gap + 60 : gap + 90].all() and red[gap + 20 : gap + 40, gap + 60].all()


@pytest.mark.parametrize("width", [480, 640, 960])
def test_words_are_wrapped_to_the_width_of_the_image(width):
    image = np.full((width // 2, width, 3), 90, np.uint8)
    cells = [SheetCell(view, 12.0, image, 1.23, 0.567, 1_234, 567) for view in ("FRONT", "REAR")]
    found = intensity_sheet(cells)
    one = intensity_sheet([SheetCell("", 0.0, image, 0, 0, 0, 0)])
    gap = (one.shape[1] - width) // 2
    paper = found[0, 0]
    for column in (slice(0, gap), slice(gap + width, 3 * gap + width), slice(-gap, None)):  # no ink on the margins
        assert (found[:, column] == paper).all()
    below = (found[gap + width // 2 :] != paper).any(axis=(1, 2))
    assert below[-6 * gap :].any() and not below[-gap // 2 :].any()  # the last line is whole, and near the end
    assert (found.shape[0] > one.shape[0]) == (width == 480)  # more lines only where they are needed


@pytest.mark.parametrize("wet", ["--wet", "--no-wet"])
def test_cells_are_the_stills_of_their_intensities_at_0_mm_h_too(tmp_path, monkeypatch, wet):
    scene = small_scene()
    layers = tuple(replace(each, wet_sh=0.5 * each.gaussians.sh) for each in scene.layers)
    write_scene(replace(scene, layers=layers), tmp_path / "scene")
    command = ["render", str(tmp_path / "scene"), wet, "--size", "96x64", "--backend", "cpu"]
    cells = []
    monkeypatch.setattr(sheets, "intensity_sheet", lambda found: cells.append(found) or found[0].image)
    assert run([*command, "--sheet", "0,12", "-o", str(tmp_path / "sheet.png")]) == 0
    for cell in cells[0]:
        still = tmp_path / f"{cell.intensity_mm_h:g}.png"
        assert run([*command, "--rain", f"{cell.intensity_mm_h:g}", "-o", str(still)]) == 0
        with Image.open(still) as image:
            np.testing.assert_array_equal(cell.image, np.asarray(image.convert("RGB")))


def test_the_command_writes_the_sheet_and_its_numbers(tmp_path, capsys):
    write_scene(small_scene(), tmp_path / "scene")
    sheet = tmp_path / "sheet.png"
    arguments = ["render", str(tmp_path / "scene"), "--sheet", "0,12", "--size", "96x64", "--backend", "cpu"]
    assert run([*arguments, "-o", str(sheet)]) == 0
    with Image.open(sheet) as image:
        assert image.width >= 96 and image.height >= 2 * 64
    assert "12 mm/h: change" in capsys.readouterr().out
    for wrong in (["-o", str(tmp_path / "clip.mp4")], ["-o", str(sheet), "--frame", "3"]):
        assert run([*arguments, *wrong]) == 2


@pytest.mark.parametrize("text", ["", "a", "0,200"])
def test_wrong_intensities_are_refused(tmp_path, text):
    assert run(["render", "--sheet", text, "-o", str(tmp_path / "sheet.png")]) == 2
