"""Breaks real commands while they write: kills them at calls that change the disk, or lets the disk become full.

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
os.environ["NUMBA_THREADING_LAYER"] = "workqueue"  # OpenMP does not live on in a forked process
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from gsrain_engine.compile_cache import use_kernel_cache  # noqa: E402

use_kernel_cache()

from app.main import run  # noqa: E402
from reliability.commands import COMMANDS, Command, complaints, leftovers, write_inputs  # noqa: E402
from reliability.dying import run_in_child  # noqa: E402

# Killed


def kill_often(command: Command, times: int, inputs: Path, folder: Path, chance: random.Random) -> tuple[int, int]:
    """Let a command die so often, each time over what the one before has left; returns deaths and faults."""
    said = folder / "said.txt"
    run_in_child(partial(run, command.line(inputs, folder / "first")), None, said)  # compiles what has to be
    code, count = run_in_child(partial(run, command.line(inputs, folder / "whole")), 0, said)
    if code != 0:
        print(f"{command.name}: fails by itself: {said.read_text()[-500:]}")
        return 0, 1
    results = folder / "killed"
    results.mkdir()
    deaths, found = 0, list[str]()
    for _ in range(times):
        at = chance.randint(1, count)
        code, _ = run_in_child(partial(run, command.again(inputs, results)), at, said)
        deaths += code == -signal.SIGKILL
        ended = [] if code in (0, -signal.SIGKILL) else [f"ended with {code}: {said.read_text()[-300:]}"]
        found += [f"killed at {at} of {count}: {each}" for each in [*complaints(results), *ended]]
    for part in results.rglob("*"):
        os.utime(part, (0, 0))  # as if ten minutes had gone by
    code, _ = run_in_child(partial(run, command.again(inputs, results)), 0, said)
    found += [] if code == 0 else [f"in the end: {code}: {said.read_text()[-300:]}"]
    found += [f"left behind: {each}" for each in leftovers(results)]
    found += [f"not as without deaths: {each}" for each in names_in(folder / "whole") ^ names_in(results)]
    for each in found:
        print(f"{command.name}, {each}", flush=True)
    return deaths, len(found)


def names_in(folder: Path) -> set[str]:
    return {str(each.relative_to(folder)) for each in folder.rglob("*")}


def kill(commands: list[Command], place: Path, times: int, seed: int) -> Iterator[str]:
    """Kill each command; yields rows of a table."""
    chance, inputs = random.Random(seed), place / "in"
    for module in ("render", "scene", "drive", "sweep", "train", "translate"):
        import_module(f"app.{module}")  # once, not in each child
    inputs.mkdir()
    run_in_child(lambda: write_inputs(inputs) or 0, None, inputs / "said.txt")
    for command in commands:
        folder = place / command.name.replace(" ", "_")
        folder.mkdir()
        deaths, faults = kill_often(command, times, inputs, folder, chance)
        yield f"{command.name:30} {deaths:4} deaths {faults:4} faults"


# On a full disk

_DISK_MB = 64
_SHARES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
"""Of what the results take: how much room there is."""


@contextmanager
def small_disk(place: Path) -> Iterator[Path]:
    """Mount a disk in memory at a folder."""
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={_DISK_MB}m", "tmpfs", str(place)], check=True)
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


def leave(room: int, disk: Path) -> Path:
    """Fill a disk but for so many bytes, in whole pages."""
    filler = disk / "filler"
    free = shutil.disk_usage(disk).free
    with filler.open("wb") as file:
        for _ in range((free - room) // 4096):
            file.write(bytes(4096))
    return filler


def gsrain(arguments: list[str]) -> tuple[int, str]:
    """Run a command; returns its exit code and its standard error."""
    errors = io.StringIO()
    with redirect_stderr(errors), redirect_stdout(io.StringIO()):
        try:
            code = run(arguments)
        except Exception as error:  # what would be a traceback
            return 1, f"Traceback: {type(error).__name__}: {error}"
    return code, errors.getvalue()


def fill_disk(command: Command, inputs: Path, disk: Path, *, over: bool) -> tuple[int, int]:
    """Run a command with less and less room, into an empty folder or over results; returns failures and faults."""
    results = disk / "results"
    results.mkdir()
    used = shutil.disk_usage(disk).used
    code, said = gsrain(command.line(inputs, results))
    if code != 0:
        print(f"{command.name}: fails by itself: {said[-300:]}")
        shutil.rmtree(results)
        return 0, 1
    size, failures, faults = shutil.disk_usage(disk).used - used, 0, 0
    for share in _SHARES:
        if not over:
            shutil.rmtree(results)
            results.mkdir()
        filler = leave(int(share * size), disk)
        code, said = gsrain(command.line(inputs, results))
        filler.unlink()
        found = complaints(results) + [f"left behind: {each}" for each in leftovers(results)]
        if code != 0:
            failures += 1
            *_, last = said.strip().splitlines() or [""]
            if code != 2 or "Traceback" in said or "space" not in last or not last.startswith("gsrain: "):
                found.append(f"ended with {code}: {said[-400:]}")
            elif "results" not in last:
                found.append(f"does not name the place: {last}")
        faults += len(found)
        for each in found:
            print(f"{command.name}{', over an older one' * over}, {share:.0%} of the room: {each}", flush=True)
    shutil.rmtree(results)
    return failures, faults


def fill(commands: list[Command], place: Path) -> Iterator[str]:
    """Run each command on a disk that becomes full; yields rows of a table."""
    (place / "in").mkdir()
    write_inputs(place / "in")
    with small_disk(place / "disk") as disk:
        for command in commands:
            for over in (False, True):
                failures, faults = fill_disk(command, place / "in", disk, over=over)
                yield f"{command.name + ', over an older one' * over:50} {failures} full {faults} faults"


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
