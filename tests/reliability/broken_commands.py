"""Breaks real commands while they write: kills them at calls that change the disk, or fills the disk.

`python tests/reliability/broken_commands.py killed [--each 20] [--seed 0] [NAME...]`, on a system that can fork. After
each death nothing may stand half under the name of a result; in the end the same command has to succeed, and nothing
but results may be left.

`python tests/reliability/broken_commands.py full [NAME...]`, as root on Linux: it mounts a small disk in memory. Each
command is run with less and less room. Where it fails it has to name the place in one line and end with code 2, and no
file that was to be renamed may be left. Results of an earlier run that fitted stay as they were, or are replaced whole.

Not tests: they take minutes. Both print a line for each fault and for each command.
"""

import argparse
import io
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from importlib import import_module
from pathlib import Path

os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from gsrain_engine.compile_cache import use_kernel_cache  # noqa: E402

use_kernel_cache()

from app.main import run  # noqa: E402
from reliability.commands import COMMANDS, Command, complaints, leftovers, write_inputs  # noqa: E402
from reliability.dying import run_in_child  # noqa: E402

# Killed


def kill_often(
    command: Command, times: int, inputs: Path, folder: Path, chance: random.Random
) -> tuple[int, list[str]]:
    """Let a command die so often, each time over the remains of the one before; returns deaths and faults."""
    output = folder / "output.txt"
    run_in_child(partial(run, command.line(inputs, folder / "first")), None, output)  # compiles kernels
    code, count = run_in_child(partial(run, command.line(inputs, folder / "whole")), 0, output)
    if code != 0:
        return 0, [f"fails by itself: {output.read_text()[-500:]}"]
    results = folder / "killed"
    results.mkdir()
    deaths, faults = 0, list[str]()
    for _ in range(times):
        at = chance.randint(1, count)
        code, _ = run_in_child(partial(run, command.again(inputs, results)), at, output)
        deaths += code == -signal.SIGKILL
        ended = [] if code in (0, -signal.SIGKILL) else [f"ended with {code}: {output.read_text()[-300:]}"]
        faults += [f"killed at {at} of {count}: {each}" for each in [*complaints(results), *ended]]
    for part in results.rglob("*"):
        os.utime(part, (0, 0))  # as if ten minutes had passed
    code, _ = run_in_child(partial(run, command.again(inputs, results)), 0, output)
    faults += [] if code == 0 else [f"in the end: {code}: {output.read_text()[-300:]}"]
    faults += [f"left behind: {each}" for each in leftovers(results)]
    whole, killed = (
        {str(each.relative_to(place)) for each in place.rglob("*")} for place in (folder / "whole", results)
    )
    return deaths, faults + [f"not as without deaths: {each}" for each in whole ^ killed]


def kill(commands: list[Command], place: Path, times: int, seed: int) -> Iterator[str]:
    """Kill each command; yields faults, and a line for each command."""
    chance, inputs = random.Random(seed), place / "in"
    for module in ("render", "scene", "drive", "sweep", "train", "translate"):
        import_module(f"app.{module}")  # once, not in each child
    inputs.mkdir()
    run_in_child(lambda: write_inputs(inputs) or 0, None, inputs / "output.txt")
    for command in commands:
        folder = place / command.name.replace(" ", "_")
        folder.mkdir()
        deaths, faults = kill_often(command, times, inputs, folder, chance)
        yield from (f"{command.name}, {each}" for each in faults)
        yield f"{command.name:30} {deaths:4} deaths {len(faults):4} faults"


# On a full disk

_DISK_MB = 64
_SHARES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
"""Free space as shares of the size of the results."""


@contextmanager
def small_disk(place: Path) -> Iterator[Path]:
    """Mount a disk in memory at a folder."""
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={_DISK_MB}m", "tmpfs", str(place)], check=True)
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@contextmanager
def full_disk(room: int, disk: Path) -> Iterator[None]:
    """Leave only so many bytes of a disk, in whole pages."""
    filler = disk / "filler"
    pages = (shutil.disk_usage(disk).free - room) // 4096
    with filler.open("wb") as file:
        for _ in range(pages):
            file.write(bytes(4096))
    yield
    filler.unlink()


def gsrain(arguments: list[str]) -> tuple[int, str]:
    """Run a command; returns its exit code and its standard error."""
    errors = io.StringIO()
    with redirect_stderr(errors), redirect_stdout(io.StringIO()):
        try:
            code = run(arguments)
        except Exception as error:  # would be a traceback
            return 1, f"Traceback: {type(error).__name__}: {error}"
    return code, errors.getvalue()


def fill_disk(command: Command, inputs: Path, disk: Path, *, over: bool) -> tuple[int, list[str]]:
    """Run a command with less and less space, into an empty folder or over results; returns failures and faults."""
    results = disk / "results"
    results.mkdir()
    used = shutil.disk_usage(disk).used
    code, error = gsrain(command.line(inputs, results))
    if code != 0:
        return 0, [f"fails by itself: {error[-300:]}"]
    size, failures, faults = shutil.disk_usage(disk).used - used, 0, list[str]()
    for share in _SHARES:
        if not over:
            shutil.rmtree(results)
            results.mkdir()
        with full_disk(int(share * size), disk):
            code, error = gsrain(command.line(inputs, results))
        found = complaints(results) + [f"left behind: {each}" for each in leftovers(results)]
        failures += code != 0
        *_, last = error.strip().splitlines() or [""]
        is_explained = code == 2 and "space" in last and last.startswith("gsrain: ") and "results" in last
        if code != 0 and ("Traceback" in error or not is_explained):
            found.append(f"ended with {code}: {error[-400:]}")
        faults += [f"{share:.0%} of the space: {each}" for each in found]
    return failures, faults


def fill(commands: list[Command], place: Path) -> Iterator[str]:
    """Run each command on a disk that becomes full; yields faults, and a line for each command."""
    (place / "in").mkdir()
    write_inputs(place / "in")
    with small_disk(place / "disk") as disk:
        for command in commands:
            for over in (False, True):
                name = command.name + ", over an older one" * over
                failures, faults = fill_disk(command, place / "in", disk, over=over)
                shutil.rmtree(disk / "results")
                yield from (f"{name}, {each}" for each in faults)
                yield f"{name:50} {failures} full {len(faults)} faults"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("how", choices=("killed", "full"))
    parser.add_argument("--each", type=int, default=20, help="deaths of each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("names", nargs="*", help="commands, by the beginning of their names; default: all")
    arguments = parser.parse_intermixed_args()
    commands = [each for each in COMMANDS if each.name.startswith(tuple(arguments.names) or "")]
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        killed = arguments.how == "killed"
        rows = kill(commands, place, arguments.each, arguments.seed) if killed else fill(commands, place)
        for row in rows:
            print(row, flush=True)


if __name__ == "__main__":
    main()
