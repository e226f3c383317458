"""`gsrain bench loading`: how fast this machine writes and reads scenes."""

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from gsrain_engine.render.machine import machine
from gsrain_engine.scene.formats.loading_times import WRITTEN, LoadingTimes, time_loading

from ..console import Console, Table
from .arguments import JsonFileOrScreen, listed, words_go_to, write_numbers
from .bench import timed_scene
from .outputs import check_writable
from .progress import progress_bar

_FOLDER = "folder"


def loading(
    *,
    scenes: Annotated[
        str,
        Parameter(help="Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files."),
    ] = "random-200k,random-1m",
    formats: Annotated[
        str, Parameter(help="With commas between: folder (a scene folder), .ply, .splat, .spz.")
    ] = "folder,.ply,.splat,.spz",
    repeats: Annotated[int, Parameter(help="Times that each is read.")] = 3,
    json: JsonFileOrScreen = None,
) -> dict[str, Any]:
    """Time writing and reading scenes, from the system's file cache. Medians, by scene and format."""
    check_writable(json)
    if not 1 <= repeats <= 1000:
        raise ValueError(f"--repeats {repeats}: must be within 1..1000")
    suffixes = [_suffix(each) for each in listed("--formats", formats)]
    rows: list[LoadingTimes] = []
    for name in listed("--scenes", scenes):
        scene = timed_scene(name)
        with progress_bar(f"Timing {scene.name}", len(suffixes)) as advance:
            for suffix in suffixes:
                with tempfile.TemporaryDirectory(prefix="gsrain-bench-") as folder:
                    rows.append(time_loading(scene, suffix, Path(folder), repeats))
                advance()
    _print(rows, Console(file=words_go_to(json), width=100))
    numbers = {"rows": [asdict(row) for row in rows], "machine": machine()}
    write_numbers(json, numbers)
    return numbers


def _suffix(word: str) -> str:
    suffix = "" if word == _FOLDER else word
    if suffix not in WRITTEN:
        raise ValueError(f"--formats {word}: expected {_FOLDER}, {', '.join(each for each in WRITTEN if each)}")
    return suffix


def _print(rows: list[LoadingTimes], console: Console) -> None:
    table = Table(
        "scene", "format", "Gaussians", "SH", "MB", "write ms", "read ms", "bytes ms", "ns/Gaussian", box=None
    )
    for row in rows:
        table.add_row(
            row.scene,
            row.format,
            f"{row.gaussians:,}",
            str(row.sh_degree),
            f"{row.megabytes:.1f}",
            f"{row.write_ms:.0f}",
            f"{row.read_ms_median:.1f}",
            f"{row.bytes_ms_min:.1f}",
            f"{row.ns_per_gaussian:.0f}",
        )
    console.print(table)
