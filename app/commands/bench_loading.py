"""`gsrain bench loading`: how fast this machine writes and reads scenes."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Annotated, Any

from cyclopts import Parameter

from gsrain_engine.render.machine import machine
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import Scene

from ..console import Console, Table
from .arguments import JsonFileOrScreen, listed, words_go_to, write_numbers
from .bench import timed_scene
from .outputs import check_writable
from .progress import progress_bar

WRITTEN = ("", ".ply", ".splat", ".spz")
"""What scenes can be saved as; "" is a scene folder."""


def time_loading(scene: Scene, suffix: str, folder: Path, repeats: int) -> dict[str, Any]:
    """Write a scene into an empty folder once, and read it back several times, from the system's cache.

    `bytes_ms_min` is for the files' bytes alone, from the same cache: the least that any reader can take.

    Raises `SceneFormatError` for a suffix that can't be written.
    """
    path = folder / f"scene{suffix}"
    write_ms = _ms(lambda: write_scene(scene, path))
    files = [file for file in folder.rglob("*") if file.is_file()]
    back = read_scene(path)  # kernels are loaded, and the files are in the cache
    reads = [_ms(lambda: read_scene(path)) for _ in range(repeats)]
    return {
        "scene": scene.name,
        "format": suffix or "folder",
        "gaussians": back.gaussian_count,
        "sh_degree": max((member.gaussians.sh_degree for member in back.members), default=0),
        "megabytes": sum(file.stat().st_size for file in files) / 1e6,
        "write_ms": write_ms,
        "read_ms_median": median(reads),
        "read_ms_min": min(reads),
        "bytes_ms_min": min(_ms(lambda: [file.read_bytes() for file in files]) for _ in range(repeats)),
        "ns_per_gaussian": 1e6 * median(reads) / max(back.gaussian_count, 1),
    }


def _ms(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return 1000 * (time.perf_counter() - start)


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
    rows: list[dict[str, Any]] = []
    for name in listed("--scenes", scenes):
        scene = timed_scene(name)
        with progress_bar(f"Timing {scene.name}", len(suffixes)) as advance:
            for suffix in suffixes:
                with tempfile.TemporaryDirectory(prefix="gsrain-bench-") as folder:
                    rows.append(time_loading(scene, suffix, Path(folder), repeats))
                advance()
    _print(rows, Console(file=words_go_to(json), width=100))
    numbers = {"rows": rows, "machine": machine()}
    write_numbers(json, numbers)
    return numbers


def _suffix(word: str) -> str:
    suffix = "" if word == _FOLDER else word
    if suffix not in WRITTEN:
        raise ValueError(f"--formats {word}: expected {_FOLDER}, {', '.join(each for each in WRITTEN if each)}")
    return suffix


def _print(rows: list[dict[str, Any]], console: Console) -> None:
    table = Table(
        "scene", "format", "Gaussians", "SH", "MB", "write ms", "read ms", "bytes ms", "ns/Gaussian", box=None
    )
    for row in rows:
        table.add_row(
            row["scene"],
            row["format"],
            f"{row['gaussians']:,}",
            str(row["sh_degree"]),
            f"{row['megabytes']:.1f}",
            f"{row['write_ms']:.0f}",
            f"{row['read_ms_median']:.1f}",
            f"{row['bytes_ms_min']:.1f}",
            f"{row['ns_per_gaussian']:.0f}",
        )
    console.print(table)
