"""Runs the command line of one checkout in a folder of its own, and hashes what it makes."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from .cases import Case, Chain, chains
from .digests import digests_of

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]

_LONGEST_S = 600


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """Give the folder of a commit's files, which is removed afterwards; of a folder's name, that folder."""
    if Path(commit).is_dir():
        yield Path(commit).resolve()
        return
    git = ["git", "-C", str(REPOSITORY)]
    with tempfile.TemporaryDirectory(prefix="gsrain-golden-") as temporary:
        tree = Path(temporary) / "tree"
        subprocess.run([*git, "worktree", "add", "--quiet", "--detach", str(tree), commit], check=True)
        try:
            yield tree
        finally:
            subprocess.run([*git, "worktree", "remove", "--force", str(tree)], check=True)


def hashes(tree: Path, *, workers: int, only: str, keep: Path | None, report: Callable[[str], None]) -> dict[str, str]:
    """Hash what a checkout makes, by name; `only` takes chains with a case whose name contains it.

    `keep` is a new folder where all files stay, to look at differences.
    """
    with tempfile.TemporaryDirectory(prefix="gsrain-golden-") as temporary:
        folder = Path(temporary) if keep is None else keep.resolve()
        environment = _environment(tree, Path(temporary))
        chosen = [chain for chain in chains() if any(only in case.name for case in chain)]
        if not chosen:
            raise ValueError(f"no case has {only!r} in its name")
        begun = time.monotonic()

        def done(chain: Chain) -> dict[str, str]:
            found = _run_chain(chain, folder / _name(chain), environment)
            report(f"{time.monotonic() - begun:4.0f} s  {_name(chain)}: {len(found)} hashes")
            return found

        first = done(chosen[0])  # alone: it compiles kernels and builds the street
        with ThreadPoolExecutor(workers) as pool:
            return dict(sorted(pair for found in (first, *pool.map(done, chosen[1:])) for pair in found.items()))


def _name(chain: Chain) -> str:
    return chain[0].name.replace("/", "_").replace(" ", "_")


def _environment(tree: Path, temporary: Path) -> dict[str, str]:
    """Return an environment where the checkout's packages come first, and nothing that a user has set is found."""
    own = {f"XDG_{each}_HOME": str(temporary / "home" / each.lower()) for each in ("CACHE", "CONFIG", "DATA", "STATE")}
    left_out = "GSRAIN_", "NUMBA_CACHE", "PYTHONDONTWRITE"  # without kept bytecode each start takes seconds
    passed = {key: value for key, value in os.environ.items() if not key.startswith(left_out)}
    metadata = temporary / "metadata"
    subprocess.run([sys.executable, REPOSITORY / "packaging" / "metadata.py", metadata, tree], check=True)
    return passed | own | {"PYTHONPATH": f"{metadata}{os.pathsep}{tree}", "NO_COLOR": "1", "COLUMNS": "120"}


def _run_chain(chain: Chain, folder: Path, environment: dict[str, str]) -> dict[str, str]:
    copy_saved(folder)
    return {name: each for case in chain for name, each in _run(case, folder, environment).items()}


def copy_saved(folder: Path) -> None:
    """Put the files that cases use into a folder, and make the folders of their stills."""
    shutil.copytree(HERE / "saved", folder / "saved", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("still", "look"):
        (folder / name).mkdir()


def _run(case: Case, folder: Path, environment: dict[str, str]) -> dict[str, str]:
    command = [sys.executable, "-m", "app", *case.command.split()]
    ended = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=_LONGEST_S, check=False
    )
    if ended.returncode != 0:
        said = (ended.stderr.strip() or ended.stdout.strip() or "no output").splitlines()[-1]
        return {case.name: f"failed with {ended.returncode}: {said}"}
    return results_of(case, folder)


def results_of(case: Case, folder: Path) -> dict[str, str]:
    """Hash the files that a case has made in a folder."""
    found: dict[str, str] = {}
    for kind, pattern in (result.split() for result in case.results):
        files = sorted(folder.glob(pattern))
        if not files:
            found[f"{case.name}: {pattern}"] = "absent"
        for file in files:
            label = str(file.relative_to(folder))
            name = case.name if label.removesuffix(file.suffix) == case.name else f"{case.name}: {label}"
            found |= digests_of(kind, file, name)
    return found
