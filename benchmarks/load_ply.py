"""Load time of a 3DGS PLY relative to reading its bytes and copying them once. Prints JSON."""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsrain_engine.scene.formats.ply import write_ply
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.gaussians import Gaussians


def scattered_gaussians(count: int) -> Gaussians:
    rng = np.random.default_rng(1)
    quaternions = rng.normal(size=(count, 4)).astype(np.float32)
    return Gaussians(
        rng.normal(size=(count, 3)).astype(np.float32),
        rng.uniform(0.01, 0.1, (count, 3)).astype(np.float32),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        rng.uniform(0.01, 0.99, count).astype(np.float32),
        rng.normal(0, 0.2, (count, 16, 3)).astype(np.float32),
    )


def shortest_s(work: Callable[[], object], repeats: int) -> float:
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gaussians", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.ply"
        write_ply(scattered_gaussians(arguments.gaussians), path)
        megabytes = path.stat().st_size / 1e6
        copy_s = shortest_s(lambda: np.fromfile(path, np.uint8).copy(), arguments.repeats)
        load_s = shortest_s(lambda: read_scene(path), arguments.repeats)
    numbers = {
        "gaussians": arguments.gaussians,
        "megabytes": round(megabytes, 1),
        "read_and_copy_s": round(copy_s, 4),
        "load_s": round(load_s, 4),
        "ratio": round(load_s / copy_s, 2),
    }
    print(json.dumps(numbers))


if __name__ == "__main__":
    main()
