"""Kills real commands at random calls of theirs that change the disk, and looks at what is left each time.

`python tests/reliability/killed_commands.py [--each 20] [--seed 0] [NAME...]`, on a system that can fork. Not a test:
it takes minutes. After each death nothing may stand half under the name of a result; in the end the same command has
to succeed, and nothing but results may be left. Prints a line for each complaint, and a table.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
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
    """All that is in a folder."""
    return {str(each.relative_to(folder)) for each in folder.rglob("*")}


def main() -> None:
    """Kill and tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="deaths of each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("names", nargs="*", help="commands, by the beginning of their names; default: all")
    arguments = parser.parse_args()
    chance, table = random.Random(arguments.seed), list[str]()
    for command in COMMANDS:
        import_module(f"app.commands.{command.arguments[0]}")
    with tempfile.TemporaryDirectory() as place:
        inputs = Path(place) / "in"
        inputs.mkdir()
        run_in_child(lambda: write_inputs(inputs) or 0, None, inputs / "said.txt")
        for command in COMMANDS:
            if arguments.names and not command.name.startswith(tuple(arguments.names)):
                continue
            folder = Path(place) / command.name.replace(" ", "_")
            folder.mkdir()
            deaths, faults = kill_often(command, arguments.each, inputs, folder, chance)
            table.append(f"{command.name:30} {deaths:4} deaths {faults:4} complaints")
            print(table[-1], flush=True)
    print("\n".join(["", *table]))


if __name__ == "__main__":
    main()
