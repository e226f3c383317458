"""How long a scene takes to be written and read, format by format."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from ..scene import Scene
from .scene_files import read_scene, write_scene

WRITTEN = ("", ".ply", ".splat", ".spz")
"""What scenes can be saved as; "" is a scene folder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadingTimes:
    """What one format took."""

    scene: str
    format: str
    """The suffix; of a scene folder the word folder."""
    gaussians: int
    sh_degree: int
    """Of what was read back: formats without harmonics have 0."""
    megabytes: float
    write_ms: float
    read_ms_median: float
    read_ms_min: float
    bytes_ms_min: float
    """For the files' bytes alone, from the same cache: the least that any reader can take."""
    ns_per_gaussian: float
    """Median reading over Gaussians."""


def time_loading(scene: Scene, suffix: str, folder: Path, repeats: int) -> LoadingTimes:
    """Write a scene into an empty folder once, and read it back several times, from the system's cache.

    Raises `SceneFormatError` for a suffix that can't be written.
    """
    path = folder / f"scene{suffix}"
    write_ms = _ms(lambda: write_scene(scene, path))
    files = [file for file in folder.rglob("*") if file.is_file()]
    back = read_scene(path)  # kernels are loaded, and the files are in the cache
    reads = [_ms(lambda: read_scene(path)) for _ in range(repeats)]
    return LoadingTimes(
        scene=scene.name,
        format=suffix or "folder",
        gaussians=back.gaussian_count,
        sh_degree=max((member.gaussians.sh_degree for member in back.members), default=0),
        megabytes=sum(file.stat().st_size for file in files) / 1e6,
        write_ms=write_ms,
        read_ms_median=median(reads),
        read_ms_min=min(reads),
        bytes_ms_min=min(_ms(lambda: [file.read_bytes() for file in files]) for _ in range(repeats)),
        ns_per_gaussian=1e6 * median(reads) / max(back.gaussian_count, 1),
    )


def _ms(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return 1000 * (time.perf_counter() - start)
