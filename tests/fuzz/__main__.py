"""Tries every reader with damaged files: python -m tests.fuzz --minutes 10 [READER ...]; findings go to out/fuzz.

With --messages N every server's door gets hostile messages instead: python -m tests.fuzz --messages 10000 [DOOR ...].
With --pictures N kernels get hostile numbers; NUMBA_BOUNDSCHECK=1 checks their indices, and compiles them for minutes.
"""

import argparse
import sys
import time
import traceback
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))  # the writers of test files, as pytest finds them


def main() -> int:
    """Run the campaign; the exit code is 1 where something was found."""
    from . import doors
    from .campaign import campaign
    from .readers import READERS

    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join((*READERS, *doors.DOORS))}; default: all"
    )
    parser.add_argument("--messages", type=int, default=0, help="number of messages for each door of a server")
    parser.add_argument("--pictures", type=int, default=0, help="number of pictures of hostile numbers")
    parser.add_argument("--minutes", type=float, default=10.0, help="for each reader")
    parser.add_argument("--first-seed", type=int, default=1_000_000, help="seeds rise from here")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder for files that fail")
    arguments = parser.parse_args()
    if arguments.pictures:
        return _draw(arguments.pictures, arguments.first_seed)
    known = doors.DOORS if arguments.messages else READERS
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        parser.error(f"no {unknown[0]!r}; there are {', '.join(known)}")
    total = 0
    for name in arguments.names or known:
        if arguments.messages:
            total += _besiege(name, arguments.messages, arguments.first_seed)
            continue
        began = time.monotonic()
        files, found = campaign(name, arguments.minutes, arguments.first_seed, arguments.out)
        print(f"{name}: {files:,} files in {time.monotonic() - began:.0f} s, {found} findings", flush=True)
        total += found
    return 1 if total else 0


def _draw(pictures: int, seed: int) -> int:
    """Call kernels with hostile numbers; returns the number of findings."""
    import warnings
    from random import Random

    from .kernel_callers import kernel_callers

    warnings.simplefilter("ignore")
    found = drawn = 0
    with kernel_callers() as callers:
        for number in range(seed, seed + pictures):
            try:
                drawn += callers.call(Random(number)) == "drawn"
            except Exception as error:
                found += 1
                print(f"picture {number}: {type(error).__name__}: {error!r:.200}", flush=True)
                traceback.print_exc(limit=-2)
    print(f"{pictures:,} pictures, {drawn:,} of them drawn, {found} findings")
    return found


def _besiege(name: str, messages: int, seed: int) -> int:
    """Attack one door; returns the number of findings."""
    from . import doors

    began = time.monotonic()
    growth, what = doors.campaign(name, messages, seed)
    ending = f"{messages:,} messages, no finding" if what is None else what
    print(f"{name}: {ending}, {growth >> 20} MB of growth, {time.monotonic() - began:.0f} s", flush=True)
    return int(what is not None)


if __name__ == "__main__":
    sys.exit(main())
