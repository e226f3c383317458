"""`gsrain info SCENE|CAPTURE|FILE`: what is in a scene, a capture or a disdrometer's file."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from gsrain_engine.datasets.open_capture import capture_format, hint
from gsrain_engine.scene.bounds import bounds
from gsrain_engine.scene.formats.scene_files import INNER_SCENE
from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.scene.open_scene import open_scene, scene_folder_of
from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.view.home_camera import scene_core

from ..console import Table, wide_console
from .arguments import AllowOutside, JsonFile, let_names_lead_outside, write_numbers
from .capture_info import capture_info
from .disdrometer_info import Columns, disdrometer_info
from .marked import marked, marked_text
from .outputs import check_picture, check_writable
from .sources import names_scene


def info(
    scene: Annotated[
        str, Parameter(help='Scene file or folder, a capture, or a disdrometer file; "street" is the built-in scene.')
    ],
    /,
    *,
    check: Annotated[bool, Parameter(negative="", help="Capture: read all pictures, and check the poses.")] = False,
    overlay: Annotated[
        Path | None, Parameter(help="Capture: draw points and boxes into some views, and write the picture here.")
    ] = None,
    columns: Columns = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Print what a scene holds (counts, bounds, harmonics, memory) or a capture (cameras, lidar, boxes, problems).

    Of a disdrometer's file: instrument, records, drops, rain, what is rejected and why, and how well its rates agree.
    """
    check_picture("--overlay", overlay)
    check_writable(overlay, json)
    let_names_lead_outside(allow_outside)
    is_scene, inner = names_scene(scene), scene_folder_of(Path(scene) / INNER_SCENE)
    if not is_scene and capture_format(scene) is not None:
        numbers = capture_info(Path(scene), check, overlay)
        if inner is not None:  # what gsrain street writes holds a scene too
            numbers |= _scene_info(scene)
        write_numbers(json, numbers)
        return
    if check or overlay is not None:
        raise ValueError(f"{scene}: --check and --overlay are for captures, and this is none that is known")
    if not is_scene and inner is None and Path(scene).is_dir():
        told = "neither a scene (scene.json, or meta.json of SOG) nor a capture that is known"
        raise ValueError(f"{scene}: {told}{hint(Path(scene))}")
    if columns is not None or (not is_scene and Path(scene).is_file()):
        write_numbers(json, disdrometer_info(Path(scene), columns))
        return
    write_numbers(json, _scene_info(scene))


def _scene_info(scene: str) -> dict[str, Any]:
    """Print what a scene holds; returns the printed numbers."""
    opened = open_scene(scene)
    rows = [_member(each) for each in opened.members]
    numbers = {
        "scene": opened.name,
        "gaussians": opened.gaussian_count,
        **marked(opened.members),
        "memory_bytes": sum(row["memory_bytes"] for row in rows),
        "metres_per_unit": opened.metres_per_unit,
        "metres_per_unit_is_assumed": opened.unit_is_assumed,
        "up": list(opened.up),
        "rigs": {name: [camera.name for camera in cameras] for name, cameras in opened.rigs.items()},
        "members": rows,
        **_extent(opened),
    }
    _print(opened, numbers)
    return numbers


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
        "wet_colors": member.wet_sh is not None,
        "memory_bytes": gaussians.nbytes + (member.wet_sh.nbytes if member.wet_sh is not None else 0),
    }


def _extent(scene: Scene) -> dict[str, Any]:
    """Numbers of the dense core and of the shell around it, in the world (metres, z up)."""
    core = scene_core(scene)
    low, high = ([round(float(v), 3) for v in corner] for corner in (core.low, core.high))
    numbers: dict[str, Any] = {"core_m": {"minimum": low, "maximum": high}, "shell": None}
    if core.shell is not None:
        count = sum(int(np.count_nonzero(core.shell.holds(part))) for part in scene.parts())
        share = count / max(scene.gaussian_count, 1)
        radius_m = round(core.shell.radius_m, 3)
        numbers["shell"] = {"gaussians": count, "share": round(share, 4), "radius_m": radius_m}
    return numbers


def _print(scene: Scene, numbers: dict[str, Any]) -> None:
    console = wide_console()
    up = ", ".join(f"{v + 0.0:g}" for v in scene.up)  # no -0
    marks = marked_text({kind: numbers[kind] for kind in ("deleted", "hidden")})
    size = f"{numbers['memory_bytes'] / 2**20:.1f} MiB"
    console.print(f"{scene.name}: {numbers['gaussians']:,} Gaussians{marks}, {size}")
    assumed = " (assumed)" if scene.unit_is_assumed else ""
    console.print(f"1 unit = {scene.metres_per_unit:g} m{assumed}, up = ({up})")
    low, high = numbers["core_m"]["minimum"], numbers["core_m"]["maximum"]
    sides = ", ".join(f"{axis} {a + 0.0:.4g} to {b + 0.0:.4g}" for axis, a, b in zip("xyz", low, high, strict=True))
    console.print(f"most of it lies at {sides} m")
    shell = numbers["shell"]
    if shell is not None:
        console.print(
            f"far shell, such as a sky: {shell['gaussians']:,} Gaussians ({100 * shell['share']:.2g} %), "
            f"{shell['radius_m']:.4g} m from the middle"
        )
    for name, cameras in numbers["rigs"].items():
        console.print(f"rig {name}: {', '.join(cameras)}")
    table = Table(box=None)
    for title in ("name", "kind", "Gaussians", "SH degree", "wet", "minimum", "maximum", "MiB"):
        table.add_column(title, no_wrap=True)
    for row in numbers["members"]:
        corners = [" ".join(f"{v + 0.0:g}" for v in row[key]) for key in ("minimum", "maximum")]
        size = f"{row['memory_bytes'] / 2**20:.1f}"
        wet = "yes" if row["wet_colors"] else "no"
        table.add_row(row["name"], row["kind"], f"{row['gaussians']:,}", str(row["sh_degree"]), wet, *corners, size)
    console.print(table)
