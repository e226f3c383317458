"""Icon, menu entry and file types: what desktops are told agrees with the program."""

import configparser
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from gsrain_engine.scene.formats.registry import scene_suffixes
from ui.window import SIZES_PX, read_icon

PACKAGING = Path(__file__).resolve().parents[2] / "packaging"


def test_icons_have_their_sizes_and_show_a_drop():
    for size in SIZES_PX:
        icon = read_icon(size)
        assert icon.shape == (size, size, 4)
        drop, corner = icon[size // 2, size // 2], icon[0, 0]
        assert drop[2] > 150 and drop[3] == 255 and corner[3] < 128  # a drop in the middle, round corners


def test_the_entry_opens_what_the_program_reads_and_is_removed(tmp_path):
    script, share = [sys.executable, str(PACKAGING / "install_desktop.py")], tmp_path / "share"
    environment = {
        **os.environ,
        "PREFIX": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([*sys.path, str(PACKAGING.parent)]),
    }
    subprocess.run(script, env=environment, check=True)
    assert {str(each.relative_to(share)) for each in tmp_path.rglob("gsrain*")} == {
        "applications/gsrain.desktop",
        "mime/packages/gsrain-mime.xml",
        "icons/hicolor/scalable/apps/gsrain.svg",
        *(f"icons/hicolor/{size}x{size}/apps/gsrain.png" for size in SIZES_PX),
    }
    entry = configparser.ConfigParser(interpolation=None)
    entry.optionxform = str
    entry.read(share / "applications" / "gsrain.desktop")
    types = {each for each in entry["Desktop Entry"]["MimeType"].split(";") if each}
    space = "{http://www.freedesktop.org/standards/shared-mime-info}"
    declared = ElementTree.parse(share / "mime" / "packages" / "gsrain-mime.xml").getroot()
    assert types == {each.get("type") for each in declared.iter(f"{space}mime-type")}
    known = {f"*{suffix}" for suffix in scene_suffixes() if suffix[0] == "."}
    assert {each.get("pattern") for each in declared.iter(f"{space}glob")} == known - {"*.ply"}  # by its first bytes
    assert [each.get("value") for each in declared.iter(f"{space}match")][:2] == ["ply\\n", "f_dc_0"]
    assert entry["Desktop Entry"]["StartupWMClass"] == "GSRAIN"
    subprocess.run([*script, "--remove"], env=environment, check=True)
    assert not list(tmp_path.rglob("gsrain*"))
