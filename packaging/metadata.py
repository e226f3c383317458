"""Write the metadata that an installation of a checkout has, so that it runs from Python's path without one.

python packaging/metadata.py FOLDER [CHECKOUT]; then PYTHONPATH=FOLDER:CHECKOUT.
"""

import sys
import tomllib
from pathlib import Path


def write_metadata(folder: Path, checkout: Path) -> None:
    """Write name, version, requirements and entry points of the program."""
    project = tomllib.loads((checkout / "pyproject.toml").read_text("utf-8"))["project"]
    info = folder / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    needed = [each.partition(";") for each in project["dependencies"]]
    needed += [
        (name, ";", f'{f"({marker}) and " if (marker := condition.strip()) else ""}extra == "{extra}"')
        for extra, extras in project["optional-dependencies"].items()
        for name, _, condition in (each.partition(";") for each in extras)
    ]
    lines = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    lines += "".join(f"Requires-Dist: {''.join(each)}\n" for each in needed)
    (info / "METADATA").write_text(lines, "utf-8")
    groups = {"console_scripts": project["scripts"], **project.get("entry-points", {})}
    lines = "".join(
        f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in rows.items())
        for group, rows in groups.items()
    )
    (info / "entry_points.txt").write_text(lines, "utf-8")


if __name__ == "__main__":
    write_metadata(Path(sys.argv[1]), Path(*sys.argv[2:3]))
