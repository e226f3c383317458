"""`gsrain info SCENE`: what is in a scene."""

from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from gsrain_engine.scene.bounds import bounds
from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.files.open_scene import open_scene

from .arguments import JsonFile, write_numbers
from .marked import marked, marked_text


def info(
    scene: Annotated[str, Parameter(help='Scene file or folder; "street" is the built-in one.')],
    /,
    *,
    json: JsonFile = None,
) -> None:
    """Print counts, bounds, spherical harmonics, units and memory of a scene."""
    opened = open_scene(scene)
    rows = [_member(each) for each in opened.members]
    numbers = {
        "scene": opened.name,
        "gaussians": opened.gaussian_count,
        **marked(opened.members),
        "memory_bytes": sum(row["memory_bytes"] for row in rows),
        "metres_per_unit": opened.metres_per_unit,
        "up": list(opened.up),
        "rigs": {name: [camera.name for camera in cameras] for name, cameras in opened.rigs.items()},
        "members": rows,
    }
    _print(opened, numbers)
    write_numbers(json, numbers)


def _member(member: Layer | Actor) -> dict[str, Any]:
    gaussians, marks = member.gaussians, marked([member])
    low, high = bounds(gaussians) if len(gaussians) else (np.zeros(3), np.zeros(3))
    return {
        "name": member.name,
        "kind": member.kind if isinstance(member, Layer) else member.class_name,
        "gaussians": len(gaussians) - marks["deleted"],
        **marks,
        "sh_degree": gaussians.sh_degree,
        "minimum": [round(float(v), 3) for v in low],
        "maximum": [round(float(v), 3) for v in high],
        "memory_bytes": gaussians.nbytes,
    }


def _print(scene: Scene, numbers: dict[str, Any]) -> None:
    console = Console()
    up = ", ".join(f"{v:g}" for v in scene.up)
    marks = marked_text({kind: numbers[kind] for kind in ("deleted", "hidden")})
    size = f"{numbers['memory_bytes'] / 2**20:.1f} MiB"
    console.print(f"{scene.name}: {numbers['gaussians']:,} Gaussians{marks}, {size}")
    console.print(f"1 unit = {scene.metres_per_unit:g} m, up = ({up})")
    for name, cameras in numbers["rigs"].items():
        console.print(f"rig {name}: {', '.join(cameras)}")
    table = Table("name", "kind", "Gaussians", "SH degree", "minimum", "maximum", "MiB", box=None)
    for row in numbers["members"]:
        corners = [" ".join(f"{v:g}" for v in row[key]) for key in ("minimum", "maximum")]
        size = f"{row['memory_bytes'] / 2**20:.1f}"
        table.add_row(row["name"], row["kind"], f"{row['gaussians']:,}", str(row["sh_degree"]), *corners, size)
    console.print(table)
