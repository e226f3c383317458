"""Measures the tests: changes one place of the program at a time and runs the tests of it; python -m tests.mutants.

Places are drawn by a seed from rain, scene formats, metrics and limits. A mutant that no test notices survives, and is
printed as a line of code to be read: either the change makes no difference, or a test is missing. Tests are chosen by
coverage: those that ran the changed line, nearest folder first, then the quickest; for a compiled kernel, whose lines
no tracer sees, the test files that import its module. Each mutant runs in a copy of the checkout.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
SUBJECTS = (
    "gsrain_engine/rain",
    "gsrain_engine/scene/formats",
    "gsrain_engine/drive/metrics",
    "gsrain_engine/drive/hugsim/pipes.py",
    "gsrain_engine/evaluate/*.py",
    "gsrain_engine/untrusted",
)
"""Folders and files that are changed."""
DRAWN = ("plot.py", "figures.py", "curves_over_time.py", "birds_eye.py", "run_page.py")
"""Files that only draw figures and pages: people judge these, not tests."""
TESTS = (
    "tests/rain",
    "tests/scene",
    "tests/drive/metrics",
    "tests/drive/hugsim",
    "tests/drive/rollouts",
    "tests/evaluate",
    "tests/fuzz",
    "tests/datasets",
    "tests/app/test_calibrate_command.py",
    "tests/app/test_disdrometer_command.py",
    "tests/app/test_marked_scenes.py",
)
"""Tests that may notice a change."""
COPIED = ("app", "ui", "gsrain_engine", "shaders", "sample_configs", "tests", "docs", "examples", "benchmarks")
BUDGET_S = 20.0
"""Tests of one mutant, added up as they took without it."""
TIMEOUT_S = 600.0
"""A mutant that takes longer is one that never ends; with kernels not compiled, tests take their time."""

_COMPARE = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_BINARY = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitOr,
}  # fmt: skip
_CALLS = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor",
    "sin": "cos", "cos": "sin", "any": "all", "all": "any",
}  # fmt: skip


_GUARDS = (ast.Raise, ast.Return, ast.Continue)


class Mutant(NamedTuple):
    """One changed place: characters `start` to `end` of `file` become `text`."""

    file: str
    line: int
    start: int
    end: int
    text: str
    in_kernel: bool

    def applied(self, source: str) -> str:
        return source[: self.start] + self.text + source[self.end :]


class Verdict(NamedTuple):
    """What the tests made of a mutant."""

    mutant: Mutant
    result: str  # "failed", "timeout", "survived" or "untested"
    tests: int
    seconds: float


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("subjects", nargs="*", default=SUBJECTS, help="files and folders to change")
    parser.add_argument("--count", type=int, default=300, help="mutants to draw")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/mutants"), help="coverage and verdicts go here")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    files = sorted({file for subject in arguments.subjects for file in _python_files(subject)})
    places = [mutant for file in files for mutant in mutants_of(file, (ROOT / file).read_text(encoding="utf-8"))]
    chosen = random.Random(arguments.seed).sample(places, min(arguments.count, len(places)))
    print(f"{len(files)} files, {len(places)} places, {len(chosen)} drawn", flush=True)
    tests = TestChoice(arguments.out)
    verdicts = list(judged(chosen, tests, arguments.processes))
    (arguments.out / "verdicts.json").write_text(
        json.dumps([each._asdict() | {"mutant": each.mutant._asdict()} for each in verdicts], indent=1)
    )
    counts = Counter(each.result for each in verdicts)
    print(dict(counts), f"{counts['survived'] + counts['untested']} of {len(verdicts)} not noticed")
    return 0


def _python_files(subject: str) -> list[str]:
    path = ROOT / subject
    found = path.rglob("*.py") if path.is_dir() else ROOT.glob(subject)
    return [str(each.relative_to(ROOT)) for each in found if each.name not in ("__init__.py", *DRAWN)]


def mutants_of(file: str, source: str) -> Iterator[Mutant]:
    """All places of a file, with what each would become."""
    tree = ast.parse(source)
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    # Columns of the syntax tree count bytes.
    if not source.isascii():
        lengths = [len(line) for line in source.splitlines(keepends=True)]
        starts = [sum(lengths[:n]) for n in range(len(lengths) + 1)]
    passive = {id(node) for part in _passive(tree) for node in ast.walk(part)}
    lines = source.splitlines()

    def place(node: ast.AST, text: str, in_kernel: bool) -> Mutant:
        def offset(line: int, column: int) -> int:
            return starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

        start, end = offset(node.lineno, node.col_offset), offset(node.end_lineno, node.end_col_offset)
        return Mutant(file, node.lineno, start, end, text, in_kernel)

    kernels = {id(node) for each in ast.walk(tree) if _is_kernel(each) for node in ast.walk(each)}
    for node in ast.walk(tree):
        if id(node) not in passive:
            for text in _changes(node):
                yield place(node, text, id(node) in kernels)


def _passive(tree: ast.Module) -> Iterator[ast.AST]:
    """Parts that decide nothing: annotations, decorators, error sentences, log lines, `if TYPE_CHECKING`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from node.decorator_list
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns:
            yield node.returns
        if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
            yield node.annotation
        if isinstance(node, ast.Raise | ast.JoinedStr):
            yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            yield node
        if isinstance(node, ast.Call) and ast.unparse(node.func).startswith(("_log.", "warnings.")):
            yield node


def _is_kernel(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(each) for each in node.decorator_list)


def _changes(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _COMPARE:
        yield ast.unparse(ast.Compare(node.left, [_COMPARE[type(node.ops[0])]()], node.comparators))
    elif isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        if not any(isinstance(each, ast.Constant) and isinstance(each.value, str) for each in (node.left, node.right)):
            yield f"({ast.unparse(ast.BinOp(node.left, _BINARY[type(node.op)](), node.right))})"
    elif isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield f"({ast.unparse(ast.BoolOp(other, node.values))})"
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield f"({ast.unparse(node.operand)})"
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield str(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield repr(node.value + 1 if isinstance(node.value, int) or node.value == 0 else node.value * 1.25)
    elif isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in _CALLS:
            text = ast.unparse(node)
            yield text.replace(f"{name}(", f"{_CALLS[name]}(", 1)
        elif name == "abs":
            yield f"({ast.unparse(node.args[0])})"
    elif isinstance(node, ast.If) and not node.orelse and isinstance(node.body[-1], _GUARDS):
        yield ast.unparse(ast.If(ast.Constant(False), node.body, [])).replace("\n", "\n" + " " * node.col_offset)
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "pass"


class TestChoice:
    """Which tests ran a line, nearest and quickest first; measured once, and kept in `folder`."""

    __test__ = False

    def __init__(self, folder: Path) -> None:
        self._file = folder / "coverage.json"
        self._left_out: set[str] = set()
        if not self._file.is_file():
            self._measure(folder)
        stored = json.loads(self._file.read_text())
        self._seconds: dict[str, float] = stored["seconds"]
        self._lines: dict[str, dict[str, list[str]]] = stored["lines"]

    def _measure(self, folder: Path) -> None:
        from coverage import CoverageData

        data, report = (folder / "coverage").resolve(), (folder / "durations.xml").resolve()
        settings = folder / "coverage.ini"
        settings.write_text("[run]\nsource_pkgs = gsrain_engine\ndynamic_context = test_function\n")
        command = [sys.executable, "-m", "coverage", "run", f"--rcfile={settings}", f"--data-file={data}"]
        subprocess.run(
            [
                *command, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}",
                "-o", "junit_family=xunit1", *TESTS,
            ],
            cwd=ROOT, check=False, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        seconds: dict[str, float] = {}
        for case in ElementTree.parse(report).iter("testcase"):
            if len(case) == 0:  # neither skipped nor failed
                seconds[_node(case)] = seconds.get(_node(case), 0.0) + float(case.get("time", 0))
        by_function = {_context(name): name for name in seconds}
        measured = CoverageData(basename=str(data))
        measured.read()
        lines: dict[str, dict[str, list[str]]] = {}
        for file in measured.measured_files():
            contexts = measured.contexts_by_lineno(file)
            lines[str(Path(file).relative_to(ROOT))] = {
                str(line): sorted({by_function[each] for each in of_line if each in by_function})
                for line, of_line in contexts.items()
            }
        self._file.write_text(json.dumps({"seconds": seconds, "lines": lines}))

    def leave_out(self, names: set[str]) -> None:
        """Choose these no more."""
        self._left_out |= names

    def of(self, mutant: Mutant) -> list[str]:
        """Tests for a mutant; whole files for a kernel."""
        found = [] if mutant.in_kernel else self._lines.get(mutant.file, {}).get(str(mutant.line), [])
        if not found:  # a kernel, a line run at import, or the first line of a longer statement
            module = mutant.file.removesuffix(".py").replace("/", ".")
            package, _, name = module.rpartition(".")
            wanted = f"from {module} import", f"from {package} import {name}"
            near = [ROOT / "tests" / Path(*Path(mutant.file).parts[1:-1]), *(ROOT / each for each in TESTS)]
            files = [file for each in near for file in ([each] if each.is_file() else sorted(each.rglob("test_*.py")))]
            importing = [each for each in files if any(text in each.read_text() for text in wanted)]
            names = {str(each.relative_to(ROOT)) for each in importing or files[:12]}
            found = [name for name in self._seconds if name.split("::")[0] in names]
        folder = "tests/" + "/".join(Path(mutant.file).parts[1:-1])
        left = set(found) - self._left_out
        ordered = sorted(left, key=lambda name: (not name.startswith(folder), self._seconds.get(name, 0)))
        chosen, total = [], 0.0
        for name in ordered:
            if total > BUDGET_S:
                break
            chosen.append(name)
            total += self._seconds.get(name, 0)
        return chosen


def _node(case: ElementTree.Element) -> str:
    """Name by which pytest is asked for the test of a report, all its parameters together."""
    file, function = case.get("file", ""), case.get("name", "").split("[")[0]
    last = case.get("classname", "").rpartition(".")[2]
    return f"{file}::{last}::{function}" if last[:1].isupper() else f"{file}::{function}"


def _context(name: str) -> str:
    """A test's name as coverage writes it: module and function."""
    file, _, function = name.partition("::")
    return f"{file.removesuffix('.py').replace('/', '.')}.{function.replace('::', '.')}"


def judged(mutants: list[Mutant], tests: TestChoice, processes: int) -> Iterator[Verdict]:
    """Run the tests of each mutant, in as many copies of the checkout as there are processes."""
    with tempfile.TemporaryDirectory(prefix="gsrain-mutants-") as folder:
        free: SimpleQueue[Path] = SimpleQueue()
        copies = [_copy(Path(folder) / str(number)) for number in range(processes)]
        tests.leave_out(_failing(copies[0], sorted({test for each in mutants for test in tests.of(each)})))
        for copy in copies:
            free.put(copy)

        def run(mutant: Mutant) -> Verdict:
            copy = free.get()
            try:
                return judge(mutant, tests.of(mutant), copy)
            finally:
                free.put(copy)

        with ThreadPoolExecutor(processes) as pool:
            for number, verdict in enumerate(pool.map(run, mutants), 1):
                mutant = verdict.mutant
                if verdict.result in ("survived", "untested"):
                    source = (ROOT / mutant.file).read_text(encoding="utf-8")
                    before = " ".join(source[mutant.start : mutant.end].split())
                    print(f"{verdict.result} {mutant.file}:{mutant.line}: {before[:110]}  ->  {mutant.text[:110]!r} "
                          f"({verdict.tests} tests)", flush=True)  # fmt: skip
                print(f"[{number}] {verdict.result} {verdict.seconds:.0f} s", flush=True, file=sys.stderr)
                yield verdict


def _copy(folder: Path) -> Path:
    folder.mkdir()
    for name in COPIED:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "images"))
    for file in (*ROOT.glob("*.toml"), *ROOT.glob("*.md"), *ROOT.glob("*.txt")):
        shutil.copy2(file, folder)
    return folder


def _failing(copy: Path, tests: list[str]) -> set[str]:
    """Tests that fail in an unchanged copy: they say nothing about a mutant."""
    report = copy / "control.xml"
    _pytest(copy, {}, f"--junitxml={report}", "-o", "junit_family=xunit1", *tests)
    cases = ElementTree.parse(report).iter("testcase")
    failing = {_node(case) for case in cases if any(case.find(each) is not None for each in ("failure", "error"))}
    for name in sorted(failing):
        print(f"left out, fails without a change: {name}", flush=True)
    return failing


def _pytest(copy: Path, environment: dict[str, str], *arguments: str, timeout_s: float | None = None) -> int:
    data = os.environ.get("GSRAIN_TEST_DATA", str(ROOT.parent / "shared" / "data"))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-xvfb", *arguments],
        cwd=copy, env={**os.environ, "GSRAIN_TEST_DATA": data, "CI": "1", "PYTHONDONTWRITEBYTECODE": "", **environment},
        timeout=timeout_s, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
    )  # fmt: skip
    if done.returncode not in (0, 1, 2):  # passed, failed, could not be collected
        raise RuntimeError(f"pytest ended with {done.returncode} in {copy}: {done.stdout.decode()[-2000:]}")
    return done.returncode


def judge(mutant: Mutant, tests: list[str], copy: Path) -> Verdict:
    """Apply a mutant to a copy, run its tests there, and take it back."""
    if not tests:
        return Verdict(mutant, "untested", 0, 0.0)
    source = (ROOT / mutant.file).read_text(encoding="utf-8")
    changed = copy / mutant.file
    changed.write_text(mutant.applied(source), encoding="utf-8")
    began = time.monotonic()
    environment = {"NUMBA_DISABLE_JIT": "1"} if mutant.in_kernel else {}
    try:
        result = "failed" if _pytest(copy, environment, "-x", *tests, timeout_s=TIMEOUT_S) else "survived"
    except subprocess.TimeoutExpired:
        result = "timeout"
    finally:
        shutil.copy2(ROOT / mutant.file, changed)
    return Verdict(mutant, result, len(tests), time.monotonic() - began)


if __name__ == "__main__":
    sys.exit(main())
