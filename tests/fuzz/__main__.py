"""Tries every reader with damaged files: python -m tests.fuzz --minutes 10 [READER ...]; findings go to out/fuzz."""

import argparse
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))  # the writers of test files, as pytest finds them


def main() -> int:
    """Run the campaign; the exit code is 1 where something was found."""
    from .campaign import campaign
    from .readers import READERS

    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"of {', '.join(READERS)}; all by default")
    parser.add_argument("--minutes", type=float, default=10.0, help="for each reader")
    parser.add_argument("--first-seed", type=int, default=1_000_000, help="seeds rise from here")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder for files that fail")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.readers if name not in READERS]
    if unknown:
        parser.error(f"no reader {unknown[0]!r}; there are {', '.join(READERS)}")
    total = 0
    for name in arguments.readers or READERS:
        began = time.monotonic()
        files, found = campaign(name, arguments.minutes, arguments.first_seed, arguments.out)
        print(f"{name}: {files:,} files in {time.monotonic() - began:.0f} s, {found} findings", flush=True)
        total += found
    return 1 if total else 0


if __name__ == "__main__":
    sys.exit(main())
