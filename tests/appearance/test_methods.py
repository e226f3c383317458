import logging

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.appearance.base import ClearView, RainyView, Transfer, TransferSettings
from gsrain_engine.appearance.output_folder import ContactSheet, PrecomputedTransfer, TransferRecord, write_transferred
from gsrain_engine.appearance.registry import METHODS, find_method, open_transfer
from gsrain_engine.appearance.wet_look.environment import ImageEnvironment
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.scene.camera import Camera

NOTHING = np.zeros((20, 30), np.float32)


def clear(name: str, sensor: str = "") -> ClearView:
    grey = np.full((20, 30, 3), 0.5, np.float32)
    return ClearView(name, Camera(30, 20, 30, 30, 15, 10), 0.0, grey, NOTHING, grey * 0, NOTHING, NOTHING, sensor)


def picture(value: int, size: tuple[int, int] = (30, 20)) -> Image.Image:
    return Image.new("RGB", size, (value, value, value))


def test_every_method_has_a_name_of_its_own_and_known_settings():
    assert len({each.name for each in METHODS}) == len(METHODS) == 3
    fields = set(TransferSettings.__struct_fields__)
    assert all({*each.uses, *filter(None, [each.needs])} <= fields for each in METHODS)
    with pytest.raises(ValueError, match="no transfer method 'dry', only wet, cyclegan-turbo, images"):
        find_method("dry")


def test_a_method_is_opened_by_its_name():
    opened = open_transfer("wet", TransferSettings(), ImageEnvironment())
    assert isinstance(opened, Transfer)
    assert opened.name == "wet"
    with pytest.raises(ValueError, match="--method images needs --images"):
        open_transfer("images", TransferSettings(), ImageEnvironment())


def test_pictures_stand_in_by_the_names_of_views(tmp_path, caplog):
    (tmp_path / "CAM").mkdir()
    picture(10).save(tmp_path / "one.png")
    picture(20, (60, 40)).save(tmp_path / "CAM" / "two.jpg")
    picture(30).save(tmp_path / "other.png")
    stand_in = PrecomputedTransfer(tmp_path)
    assert isinstance(stand_in, Transfer)
    with caplog.at_level(logging.WARNING):
        made = list(stand_in.transferred([clear("one"), clear("x/two.jpg", "CAM"), clear("three")]))
    assert [round(float(each.image.mean()) * 255) for each in made] == [10, 20]
    assert all(each.image.shape == (20, 30, 3) and each.film is None for each in made)
    told = " ".join(caplog.messages)
    assert "1 views have no picture" in told and "'three' for one" in told
    assert "1 pictures" in told and "'other' for one" in told


def test_a_folder_of_a_transfer_stands_in_by_its_rainy_pictures(tmp_path, caplog):
    rainy = RainyView(clear("one"), np.full((20, 30, 3), 0.25, np.float32), NOTHING)
    list(write_transferred(tmp_path / "t", [rainy], TransferRecord("wet", "street")))
    with caplog.at_level(logging.WARNING):
        made = list(PrecomputedTransfer(tmp_path / "t").transferred([clear("one")]))
    assert made[0].image.mean() == pytest.approx(0.25, abs=0.01)
    assert caplog.messages == []  # its other files are no pictures of views


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [("other", (30, 20), "has no picture of a view; expected one.png"), ("one", (20, 20), "other proportions")],
)
def test_pictures_that_cannot_be_those_of_the_views_are_refused(tmp_path, name, size, expected):
    picture(10, size).save(tmp_path / f"{name}.png")
    with pytest.raises(CaptureError, match=expected):
        list(PrecomputedTransfer(tmp_path).transferred([clear("one")]))
    with pytest.raises(CaptureError, match="no such folder"):
        PrecomputedTransfer(tmp_path / "nowhere")


def test_views_before_and_after_stand_side_by_side():
    sheet = ContactSheet(9, at_most=3, width_px=60)
    for i in range(9):
        sheet.add(RainyView(clear(f"{i}"), np.full((20, 30, 3), i / 10, np.float32)))
    pixels = np.asarray(sheet.picture())
    assert pixels.shape == (3 * (40 + 24) + 8, 2 * 60 + 24, 3)
    rows = [8 + 16 + 20 + k * 64 for k in range(3)]
    assert [int(pixels[row, 30, 0]) for row in rows] == [128] * 3
    assert [int(pixels[row, 110, 0]) for row in rows] == [0, 102, 204]
