"""Icon, menu entry and file types: what desktops are told agrees with the program."""

import configparser
import os
import subprocess
from pathlib import Path
from xml.etree import ElementTree

from gsrain_engine.scene.formats.registry import FORMATS
from ui.window import SIZES_PX, read_icon

PACKAGING = Path(__file__).resolve().parents[2] / "packaging"


def test_icons_have_their_sizes_and_show_a_drop():
    for size in SIZES_PX:
        icon = read_icon(size)
        assert icon.shape == (size, size, 4)
        drop, corner = icon[size // 2, size // 2], icon[0, 0]
        assert drop[2] > 150 and drop[3] == 255 and corner[3] < 128  # a drop in the middle, round corners


def test_the_desktop_entry_opens_what_the_program_reads():
    entry = configparser.ConfigParser(interpolation=None)
    entry.optionxform = str
    entry.read(PACKAGING / "gsrain.desktop")
    types = {each for each in entry["Desktop Entry"]["MimeType"].split(";") if each}
    space = "{http://www.freedesktop.org/standards/shared-mime-info}"
    declared = ElementTree.parse(PACKAGING / "gsrain-mime.xml").getroot()
    assert types == {each.get("type") for each in declared.iter(f"{space}mime-type")}
    known = {f"*{each.suffix}" for each in FORMATS if each.suffix[0] == "."}
    assert {each.get("pattern") for each in declared.iter(f"{space}glob")} == known - {"*.ply"}  # by its first bytes
    assert entry["Desktop Entry"]["StartupWMClass"] == "GSRAIN"


def test_the_entry_is_put_into_the_menu_and_taken_out_of_it(tmp_path):
    script, environment = str(PACKAGING / "install_desktop.sh"), {**os.environ, "PREFIX": str(tmp_path)}
    subprocess.run(["sh", script], env=environment, check=True)
    placed = {str(each.relative_to(tmp_path / "share")) for each in tmp_path.rglob("gsrain*")}
    assert placed == {
        "applications/gsrain.desktop",
        "mime/packages/gsrain-mime.xml",
        "icons/hicolor/scalable/apps/gsrain.svg",
        *(f"icons/hicolor/{size}x{size}/apps/gsrain.png" for size in SIZES_PX),
    }
    subprocess.run(["sh", script, "--remove"], env=environment, check=True)
    assert not list(tmp_path.rglob("gsrain*"))
