"""Runs real commands on a disk that becomes full while they write, and looks at what is left each time.

`python tests/reliability/full_disk.py [NAME...]`, as root on Linux: it mounts a small disk in memory. Not a test: it
takes minutes. Each command is run with less and less room. Where it fails it has to say so in one line and
end with code 2; nothing may stand half under the name of a result, and no file that was to be renamed may be left.
Results of an earlier run that fitted stay as they were, or are replaced whole. Prints complaints, and a table.
"""

import argparse
import io
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from gsrain_engine.compile_cache import use_kernel_cache  # noqa: E402

use_kernel_cache()

from app.main import run  # noqa: E402
from reliability.commands import COMMANDS, Command, complaints, leftovers, write_inputs  # noqa: E402

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
    """Run a command; returns its exit code and what it said on standard error."""
    errors = io.StringIO()
    with redirect_stderr(errors), redirect_stdout(io.StringIO()):
        try:
            code = run(arguments)
        except Exception as error:  # what would be a traceback
            return 1, f"Traceback: {type(error).__name__}: {error}"
    return code, errors.getvalue()


def fill(command: Command, inputs: Path, disk: Path, *, over: bool) -> tuple[int, int]:
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
                found.append(f"does not say where: {last}")
        faults += len(found)
        for each in found:
            print(f"{command.name}{', over an older one' * over}, {share:.0%} of the room: {each}", flush=True)
    shutil.rmtree(results)
    return failures, faults


def main() -> None:
    """Fill and tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="commands, by the beginning of their names; default: all")
    arguments = parser.parse_args()
    table: list[str] = []
    with tempfile.TemporaryDirectory() as place:
        inputs = Path(place) / "in"
        inputs.mkdir()
        write_inputs(inputs)
        with small_disk(Path(place) / "disk") as disk:
            for command in COMMANDS:
                if arguments.names and not command.name.startswith(tuple(arguments.names)):
                    continue
                for over in (False, True):
                    failures, faults = fill(command, inputs, disk, over=over)
                    table.append(
                        f"{command.name + ', over an older one' * over:50} {failures} full {faults} complaints"
                    )
                    print(table[-1], flush=True)
    print("\n".join(["", *table]))


if __name__ == "__main__":
    main()
