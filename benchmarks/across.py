"""Waiting times: each job of the program, from start to frame, in a fresh process. Prints a table.

With `--against CHECKOUT` another state of the sources does the same, turn by turn with this one, so that what else the
machine does meanwhile falls on both: the last columns say how many times as long it took there. Beside the wall's time
stands the processor's, of all threads and children, which company disturbs less. Without a display: `xvfb-run -a`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
_JOBS = "benchmarks/across_jobs.py"
"""In the checkout that is measured: it knows where things are there."""


class Seconds(NamedTuple):
    """Duration of a job."""

    wall: float
    work: float
    """Of the processor."""


class Case(NamedTuple):
    """One thing to do: arguments of Python, in which FOLDER is where the benchmark's files lie."""

    name: str
    arguments: tuple[str, ...]
    tells: bool
    """True if the process reports its own time, without its start; else it counts from start to end."""


def _command(name: str, words: str) -> Case:
    return Case(name, ("-m", "app", *words.split()), tells=False)


def _job(name: str, job: str, *more: str) -> Case:
    return Case(name, (_JOBS, job, "FOLDER", *more), tells=True)


CASES = (
    _command("gsrain --version", "--version"),
    _command("gsrain --help", "--help"),
    _command("gsrain info SCENE.ply, 1 M", "info FOLDER/million.ply"),
    _command("gsrain render street, one picture", "render street -o FOLDER/still.png --size 480x320"),
    _command("gsrain drive, oracle, no film", "drive --agent oracle-idm --duration 4 --no-video -o FOLDER/drive"),
    _command("gsrain evaluate images, 8 pairs", "evaluate images FOLDER/shown FOLDER/truth"),
    _job("window: street's first picture", "window"),
    _job("open 1 M: .ply", "opened", "million.ply"),
    _job("open 1 M: .splat", "opened", "million.splat"),
    _job("open 1 M: .spz, version 3", "opened", "million.spz"),
    _job("open 1 M: .sog", "opened", "million.sog"),
    _job("open 1 M: scene folder", "opened", "million"),
    _job("save 1 M: .ply", "saved", "copy.ply"),
    _job("save 1 M: .spz", "saved", "copy.spz"),
    _job("play in rain, a frame", "played"),
    _job("rain slider moved, a frame", "moved_slider"),
    _job("scrub, a frame", "scrubbed"),
    _job("record .mp4, a frame", "recorded", "clip.mp4"),
    _job("record PNG, a frame", "recorded", "frames"),
    _job("record EXR, a frame", "recorded", "clip.exr"),
    _job("recolor, 8 views", "recolored"),
    _job("reconstruct, a step", "reconstructed"),
    _job("transfer wet, a view", "transferred", "wet"),
    _job("transfer cyclegan-turbo (tiny), a view", "transferred", "tiny"),
    _job("begin a drive", "began_drive"),
    _job("drive, oracle-idm, a step", "drove", "oracle-idm"),
    _job("drive, camera-idm, a step", "drove", "camera-idm"),
    _job("film a drive, a frame", "filmed"),
)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", help="cases whose name holds one of these words, with commas between")
    parser.add_argument("--against", type=Path, help="another checkout of this repository, to be compared with")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="keep the scenes that are opened here; by default they go")
    parser.add_argument("--cold", action="store_true", help="each process with an empty cache: kernels compile anew")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    arguments = parser.parse_args()
    words = [word for word in (arguments.only or "").split(",") if word]
    cases = [case for case in CASES if not words or any(word in case.name for word in words)]
    checkouts = [HERE.parent, *([arguments.against.resolve()] if arguments.against else [])]
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(
            [sys.executable, _JOBS, "prepared", str(folder)],
            check=True,
            env=_surroundings(checkouts[0]),
            stdout=subprocess.DEVNULL,
        )
        rows = [_row(case, checkouts, folder, arguments.repeats, cold=arguments.cold) for case in cases]
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def _row(case: Case, checkouts: Sequence[Path], folder: Path, repeats: int, *, cold: bool) -> dict[str, object]:
    """Let the checkouts take turns; the first turn, in which caches are filled, does not count unless it is cold."""
    taken: list[list[Seconds]] = [[] for _ in checkouts]
    for turn in range(repeats + (not cold)):
        for checkout, times in zip(checkouts, taken, strict=True):
            found = _run(case, checkout, folder, cold=cold)
            if cold or turn:
                times.append(found)
    medians = [Seconds(*(median(column) for column in zip(*times, strict=True))) for times in taken]
    row: dict[str, object] = {"case": case.name, "wall_s": medians[0].wall, "processor_s": medians[0].work}
    line = f"{case.name:40} {medians[0].wall:8.3f} s {medians[0].work:8.3f} s of processor"
    if len(medians) == 2:
        ratios = Seconds(*(b / a for a, b in zip(*medians, strict=True)))
        row |= {"other_wall_ratio": ratios.wall, "other_processor_ratio": ratios.work}
        line += f"   there {ratios.wall:5.2f} times, {ratios.work:5.2f} times"
    print(line, flush=True)
    return row


def _run(case: Case, checkout: Path, folder: Path, *, cold: bool) -> Seconds:
    """Run a case once."""
    arguments = [each.replace("FOLDER", str(folder)).replace(_JOBS, str(checkout / _JOBS)) for each in case.arguments]
    with tempfile.TemporaryDirectory() as own, (folder / "words.txt").open("w+") as words:
        surroundings = _surroundings(checkout) | ({"XDG_CACHE_HOME": own} if cold else {})
        surroundings |= {"XDG_STATE_HOME": own, "XDG_CONFIG_HOME": own, "ACROSS_STARTED": repr(time.monotonic())}
        start, before = time.perf_counter(), os.times()
        done = subprocess.run(
            [sys.executable, *arguments], env=surroundings, stdout=words, stderr=subprocess.PIPE, check=False
        )
        wall, after = time.perf_counter() - start, os.times()
        if done.returncode:
            raise SystemExit(f"{case.name} ended with exit code {done.returncode}: {done.stderr.decode()}")
        words.seek(0)
        if case.tells:
            return Seconds(*json.loads(words.read().splitlines()[-1]))
    return Seconds(wall, sum(after[2:4]) - sum(before[2:4]))


def _surroundings(checkout: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(checkout)}


if __name__ == "__main__":
    main()
