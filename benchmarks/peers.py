"""Time that other libraries take to read the same files of a million Gaussians. Prints a table.

All run in this one process, by turns. Needs the files that `across.py --folder` writes, and for each row its library
(pip install plyfile trimesh gsply gaussforge); rows of those that are missing are left out. What they return differs:
`reads` says how far each goes. Ours is activated, normalized, checked and ready to be drawn, in its order in the file.
"""

import argparse
import io
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from gsrain_engine.scene.formats.registry import read_gaussians


class Peer(NamedTuple):
    """One library's way to read one file."""

    library: str
    file: str
    reads: str
    read: Callable[[Path], object]


def peers() -> Iterator[Peer]:
    """Ours, and those that are installed."""
    for file in ("million.ply", "million.spz", "million.sog"):
        yield Peer("gsrain", file, "activated, checked", read_gaussians)
    for library, module, file, reads, read in (
        ("plyfile", "plyfile", "million.ply", "rows as they are", _plyfile),
        ("trimesh", "trimesh", "million.ply", "rows as they are", _trimesh),
        ("gsply", "gsply", "million.ply", "arrays of logs and logits", _gsply),
        ("gaussforge", "gaussforge", "million.ply", "arrays of logs and logits", _gaussforge),
        ("gsply", "gsply", "million.spz", "arrays of logs and logits", _gsply),
        ("gaussforge", "gaussforge", "million.spz", "arrays of logs and logits", _gaussforge),
        ("gaussforge", "gaussforge", "million.sog", "arrays of logs and logits", _gaussforge),
    ):
        try:
            found = import_module(module)
        except ImportError:
            continue
        yield Peer(library, file, reads, partial(read, found))


def _plyfile(module: Any, path: Path) -> object:
    return module.PlyData.read(str(path))["vertex"].data["f_rest_44"].sum()  # mapped, not read, before it is asked for


def _trimesh(module: Any, path: Path) -> object:
    return module.load(io.BytesIO(path.read_bytes()), file_type="ply", process=False)


def _gsply(module: Any, path: Path) -> object:
    return module.plyread(str(path)) if path.suffix == ".ply" else module.read_spz(str(path))


def _gaussforge(module: Any, path: Path) -> object:
    return module.GaussForge().read(path.read_bytes(), path.suffix[1:])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="as `across.py --folder` has filled it")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    arguments = parser.parse_args()
    chosen = list(peers())
    took: list[list[tuple[float, float]]] = [[] for _ in chosen]
    for turn in range(arguments.repeats + 1):
        for peer, times in zip(chosen, took, strict=True):
            wall, work = time.perf_counter(), time.process_time()
            peer.read(arguments.folder / peer.file)
            if turn:  # in the first one they load and compile
                times.append((time.perf_counter() - wall, time.process_time() - work))
    rows: list[dict[str, object]] = []
    for peer, times in zip(chosen, took, strict=True):
        wall, work = (median(column) for column in zip(*times, strict=True))
        rows.append({"file": peer.file, "library": peer.library, "reads": peer.reads, "wall_s": wall, "work_s": work})
        print(f"{peer.file:12} {peer.library:12} {wall:8.3f} s {work:8.3f} s of processor   {peer.reads}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
