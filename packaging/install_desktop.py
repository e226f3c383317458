"""Puts GSRAIN into the desktop's menu, with icons, and file types from the table of scene formats; --remove undoes it.

PREFIX=~/.local (default) or /usr/local. Run it with the Python in which gsrain is installed.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from gsrain_engine.scene.formats.registry import scene_suffixes

_HERE = Path(__file__).resolve().parent
_ICONS = _HERE.parent / "app" / "icons"
_ENTRY = """\
[Desktop Entry]
Type=Application
Version=1.4
Name=GSRAIN
GenericName=Rain in Gaussian Splatting scenes
Comment=View, edit and rain on captured 3D Gaussian Splatting driving scenes
Keywords=3DGS;gaussian;splat;rain;driving;ply;spz;
Exec=gsrain %f
TryExec=gsrain
Icon=gsrain
Terminal=false
Categories=Graphics;3DGraphics;Viewer;
MimeType={types}
StartupWMClass=GSRAIN
StartupNotify=true
"""
_TYPES = """\
<?xml version="1.0" encoding="UTF-8"?>
<mime-info xmlns="http://www.freedesktop.org/standards/shared-mime-info">
{types}</mime-info>
"""
# None of the formats has a registered media type.
_TYPE = """\
  <mime-type type="{type}">
    <comment>3D Gaussian Splatting scene ({name})</comment>
    <icon name="gsrain"/>
{marks}  </mime-type>
"""
_GLOB = '    <glob pattern="*{suffix}"/>\n'
_MAGIC = {
    # Meshes end so, too: a .ply is recognized by its Gaussians.
    ".ply": """\
    <magic priority="60">
      <match type="string" offset="0" value="ply\\n">
        <match type="string" offset="4:2048" value="f_dc_0"/>
        <match type="string" offset="4:2048" value="packed_position"/>
      </match>
    </magic>
"""
}
"""First bytes of files whose suffix does not identify them."""


def media_types() -> dict[str, str]:
    """Media types of scene files, each with its description in shared-mime-info's XML."""
    marks: dict[str, list[str]] = {}
    for suffix in scene_suffixes():
        if suffix.startswith("."):  # else it is a file's whole name, which says nothing to a desktop
            mark = _MAGIC.get(suffix) or _GLOB.format(suffix=suffix)
            marks.setdefault(suffix.rpartition(".")[2], []).append(mark)
    return {
        f"application/vnd.gsrain.{name}": _TYPE.format(
            type=f"application/vnd.gsrain.{name}", name=name.upper(), marks="".join(lines)
        )
        for name, lines in marks.items()
    }


def main() -> None:
    """Place all files, or remove them."""
    share = Path(os.environ.get("PREFIX") or "~/.local").expanduser() / "share"
    types = media_types()
    texts = {
        share / "applications" / "gsrain.desktop": _ENTRY.format(types="".join(f"{each};" for each in types)),
        share / "mime" / "packages" / "gsrain-mime.xml": _TYPES.format(types="".join(types.values())),
    }
    icons = share / "icons" / "hicolor"
    images = {icons / f"{each.stem}x{each.stem}" / "apps" / "gsrain.png": each for each in _ICONS.glob("*.png")}
    images[icons / "scalable" / "apps" / "gsrain.svg"] = _HERE / "gsrain.svg"
    for file in (*texts, *images):
        if "--remove" in sys.argv[1:]:
            file.unlink(missing_ok=True)
            continue
        file.parent.mkdir(parents=True, exist_ok=True)
        if file in texts:
            file.write_text(texts[file], encoding="utf-8")
        else:
            shutil.copyfile(images[file], file)
    # Desktops without these tools look into the folders themselves.
    for tool, folder in (("update-mime-database", share / "mime"), ("update-desktop-database", share / "applications")):
        if shutil.which(tool) and folder.is_dir():
            subprocess.run([tool, folder], check=True)


if __name__ == "__main__":
    main()
