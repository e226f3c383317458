"""Hashes what two commits make on this machine, and compares: python -m tests.golden OLD NEW.

A commit may be a folder, such as `.` for the working tree. `--write FILE [COMMIT]` saves its hashes, and
`--compare FILE [COMMIT]` compares with saved ones. Only a commit's command line is used. Each difference is printed;
the exit code is then 1.
"""

import argparse
import json
import sys
from pathlib import Path

from .machine import machine
from .run import checkout, hashes


def main() -> int:
    """Return 1 where something differs, 2 where a command failed on both sides or in what is written."""
    arguments = _arguments()
    if arguments.write is not None:
        found = _made(arguments.commits[0], arguments)
        text = json.dumps({"machine": machine(), "hashes": found}, indent=1) + "\n"
        arguments.write.write_text(text, encoding="utf-8")
        failed = _failures(found)
        print(*failed, f"{len(found)} hashes in {arguments.write}", sep="\n")
        return 2 if failed else 0
    if arguments.compare is not None:
        kept = json.loads(arguments.compare.read_text(encoding="utf-8"))
        old, new = kept["hashes"], _made(arguments.commits[0], arguments)
        here = machine()
        for key in [key for key in here if here[key] != kept["machine"].get(key)]:
            print(f"another machine: {key} was {kept['machine'].get(key)!r}, is {here[key]!r}")
        if arguments.only:
            old = {name: each for name, each in old.items() if name in new}
    else:
        old, new = (_made(commit, arguments) for commit in arguments.commits)
    differences = _differences(old, new)
    failed = _failures(new)
    print(*differences, *failed, f"{len(old)} hashes, {len(differences)} different", sep="\n")
    return 1 if differences else 2 if failed else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("commits", nargs="*", metavar="COMMIT", help="two to compare, else one; default: .")
    parser.add_argument("--write", type=Path, metavar="FILE", help="keep the hashes of one commit in this file")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="compare one commit with hashes that were kept")
    parser.add_argument("--only", default="", metavar="NAME", help="chains with this in a case's name, e.g. drive/")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="leave all files here, in a folder a commit")
    parser.add_argument("--workers", type=int, default=2, help="commands at a time; default: 2")
    arguments = parser.parse_args()
    is_one = arguments.write is not None or arguments.compare is not None
    if is_one and not arguments.commits:
        arguments.commits = ["."]
    if len(arguments.commits) != (1 if is_one else 2) or (arguments.write and arguments.compare):
        parser.error("expected OLD NEW, or --write FILE [COMMIT], or --compare FILE [COMMIT]")
    return arguments


def _made(commit: str, arguments: argparse.Namespace) -> dict[str, str]:
    print(f"{commit}:", flush=True)
    name = Path(commit).resolve().name if Path(commit).is_dir() else commit
    keep = None if arguments.keep is None else arguments.keep / name
    with checkout(commit) as tree:
        return hashes(tree, workers=arguments.workers, only=arguments.only, keep=keep,
                      report=lambda line: print(line, flush=True))  # fmt: skip


def _differences(old: dict[str, str], new: dict[str, str]) -> list[str]:
    """Return a line for each name whose hash differs or is on one side only."""
    names = [name for name in sorted(old.keys() | new.keys()) if old.get(name) != new.get(name)]
    return [f"DIFFERENT {name}: {_short(old.get(name))} -> {_short(new.get(name))}" for name in names]


def _failures(found: dict[str, str]) -> list[str]:
    return [f"FAILED {name}: {each}" for name, each in found.items() if each.startswith(("failed", "absent"))]


def _short(value: str | None) -> str:
    if value is None:
        return "nothing"
    return value if value.startswith(("failed", "absent")) else value[:12]


if __name__ == "__main__":
    sys.exit(main())
