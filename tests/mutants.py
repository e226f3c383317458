"""Measures the tests: changes one place of the program at a time and runs the tests of it; python -m tests.mutants.

Places are drawn by a seed from rain, scene formats, metrics and limits. A mutant that no test notices survives, and is
printed as a line of code to be read: either the change makes no difference, or a test is missing. All runs are forks of
this process in a copy of the checkout. First come all tests, as they are: which pass there, how long each takes, which
lines it runs. A mutant gets those that run its line, nearest first, then the quickest; one in a compiled kernel, whose
lines no tracer sees, or in what runs at import, those of its file or that name it, and kernels compiled anew. In the
end tests that noticed anything run once more without a change: what fails then is no verdict.

Verdicts are lines of a file, written as they come: a second call goes on where the first ended, and `--survivors`
judges anew those that survived. Tests that were changed are measured anew; where the program has been, remove
coverage.json.
"""

import argparse
import ast
import hashlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree

if TYPE_CHECKING:
    from coverage import Coverage

ROOT = Path(__file__).resolve().parents[1]
SUBJECTS = (
    "gsrain_engine/rain",
    "gsrain_engine/scene/formats",
    "gsrain_engine/simulation/metrics",
    "gsrain_engine/simulation/interop/hugsim_protocol.py",
    "gsrain_engine/evaluation/*.py",
    "gsrain_engine/safe_io",
)
"""Folders and files that are changed."""
DRAWN = ("plot.py", "figures.py", "curves_over_time.py", "birds_eye.py", "run_page.py")
"""Files that only draw figures and pages: people judge these, not tests."""
TESTS = (
    "tests/rain",
    "tests/scene/formats",
    "tests/simulation/metrics",
    "tests/simulation/interop/test_pipes.py",
    "tests/evaluation/test_image_metrics.py",
    "tests/evaluation/test_lpips.py",
    "tests/evaluation/test_lpips_loss.py",
    "tests/evaluation/test_share_interval.py",
    "tests/evaluation/test_streaks.py",
    "tests/evaluation/detection/test_summary.py",
    "tests/safe_io",
    "tests/fuzz/test_limits.py",
    "tests/fuzz/test_settings_values.py",
    "tests/app/test_calibrate_command.py",
    "tests/app/test_disdrometer_command.py",
    "tests/app/test_evaluate_images.py",
    "tests/app/test_marked_scenes.py",
    "tests/test_extensions.py",
)
"""Tests that may notice a change."""
COPIED = (
    "app",
    "ui",
    "gsrain",
    "gsrain_engine",
    "shaders",
    "sample_configs",
    "tests",
    "docs",
    "examples",
    "benchmarks",
)
BUDGET_S = 20.0
"""Tests of one mutant, added up as they took without it."""
TIMEOUT_S = 60.0
"""So much longer than ten times its tests, and a mutant is one that never ends."""

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
_BROKEN, _ELSEWHERE = 70, 71
"""Exit codes: pytest itself has failed; it ran another engine than the copy's."""
_GUARDS = (ast.Raise, ast.Return, ast.Continue)


class Mutant(NamedTuple):
    """One changed place: characters `start` to `end` of `file` become `text`."""

    file: str
    line: int
    statement_line: int
    start: int
    end: int
    before: str
    text: str
    has_no_line: bool
    """In a kernel, or run at import: no tracer sees which test runs it."""

    def applied(self, source: str) -> str:
        if source[self.start : self.end] != self.before:
            raise ValueError(f"{self.file} has changed since: {self}")
        return source[: self.start] + self.text + source[self.end :]

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {' '.join(self.before.split())[:110]}  ->  {self.text[:110]!r}"


class Verdict(NamedTuple):
    """The tests' answer to a mutant."""

    mutant: Mutant
    result: str  # "failed", "timeout", "survived" or "untested"
    failed_test: str
    tests: int
    seconds: float


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("subjects", nargs="*", default=SUBJECTS, help="files and folders to change")
    parser.add_argument("--count", type=int, default=300, help="mutants to draw")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/mutants"), help="coverage and verdicts go here")
    parser.add_argument("--survivors", action="store_true", help="judge anew those that survived")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / f"verdicts-{arguments.seed}.jsonl"
    verdicts = _stored(file)
    if arguments.survivors:
        chosen = [each.mutant for each in verdicts.values() if each.result in ("survived", "untested")]
    else:
        files = sorted({name for subject in arguments.subjects for name in _python_files(subject)})
        places = [mutant for name in files for mutant in mutants_of(name, (ROOT / name).read_text(encoding="utf-8"))]
        chosen = random.Random(arguments.seed).sample(places, min(arguments.count, len(places)))
        print(f"{len(files)} files, {len(places)} places, {len(chosen)} drawn", flush=True)
        chosen = [each for each in chosen if each not in verdicts]
    with tempfile.TemporaryDirectory(prefix="gsrain-mutants-") as folder, file.open("a") as out:
        copy = Copy(Path(folder))
        tests = TestChoice(arguments.out, copy)
        for number, mutant in enumerate(chosen, 1):
            verdict = verdicts[mutant] = judge(mutant, tests, copy)
            out.write(json.dumps(verdict) + "\n")
            out.flush()
            if verdict.result in ("survived", "untested"):
                print(f"{verdict.result} {mutant} ({verdict.tests} tests)", flush=True)
            print(f"[{number} of {len(chosen)}] {verdict.result} {verdict.seconds:.0f} s", flush=True, file=sys.stderr)
        _check(tests.known & {each.failed_test for each in verdicts.values()}, copy)
    counts = Counter(each.result for each in verdicts.values())
    print(dict(counts), f"{counts['survived'] + counts['untested']} of {len(verdicts)} not noticed")
    return 0


def _stored(file: Path) -> dict[Mutant, Verdict]:
    """Last verdicts on mutants of the program as it is."""
    found: dict[Mutant, Verdict] = {}
    for line in file.read_text().splitlines() if file.is_file() else ():
        fields, *others = json.loads(line)
        mutant = Mutant(*fields)
        if (ROOT / mutant.file).read_text(encoding="utf-8")[mutant.start : mutant.end] == mutant.before:
            found[mutant] = Verdict(mutant, *others)
    return found


def _python_files(subject: str) -> list[str]:
    path = ROOT / subject
    found = path.rglob("*.py") if path.is_dir() else ROOT.glob(subject)
    return [str(each.relative_to(ROOT)) for each in found if each.name not in ("__init__.py", *DRAWN)]


def mutants_of(file: str, source: str) -> Iterator[Mutant]:
    """All places of a file, with what each would become."""
    tree = ast.parse(source)
    rows = source.splitlines(keepends=True)
    starts = [sum(map(len, rows[:n])) for n in range(len(rows) + 1)]

    def offset(line: int, column: int) -> int:  # columns of the syntax tree count bytes
        return starts[line - 1] + len(rows[line - 1].encode()[:column].decode())

    passive = {id(node) for part in _passive(tree) for node in ast.walk(part)}
    statements: dict[int, int] = {}
    in_functions: set[int] = set()
    kernels: set[int] = set()
    for each in ast.walk(tree):  # outer ones first
        if isinstance(each, ast.stmt):
            statements |= {id(node): each.lineno for node in ast.walk(each)}
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef):
            inner = {id(node) for statement in each.body for node in ast.walk(statement)}
            in_functions |= inner
            kernels |= inner if any("njit" in ast.unparse(word) for word in each.decorator_list) else set()
    for node in ast.walk(tree):
        if id(node) not in passive:
            for text in _changes(node):
                start, end = offset(node.lineno, node.col_offset), offset(node.end_lineno, node.end_col_offset)
                has_no_line = id(node) not in in_functions or id(node) in kernels
                yield Mutant(file, node.lineno, statements[id(node)], start, end, source[start:end], text, has_no_line)


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
            other = _CALLS[name]
            function = (
                ast.Attribute(node.func.value, other) if isinstance(node.func, ast.Attribute) else ast.Name(other)
            )
            yield ast.unparse(ast.Call(function, node.args, node.keywords))
        elif name == "abs":
            yield f"({ast.unparse(node.args[0])})"
    elif isinstance(node, ast.If) and not node.orelse and isinstance(node.body[-1], _GUARDS):
        yield ast.unparse(ast.If(ast.Constant(False), node.body, [])).replace("\n", "\n" + " " * node.col_offset)
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "pass"


class Copy:
    """The checkout in a folder of its own, and pytest in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in COPIED:
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "images"))
        for file in (*ROOT.glob("*.toml"), *ROOT.glob("*.md"), *ROOT.glob("*.txt")):
            shutil.copy2(file, folder)
        os.environ |= {
            "GSRAIN_TEST_DATA": os.environ.get("GSRAIN_TEST_DATA", str(ROOT.parent / "shared" / "data")),
            "NUMBA_CACHE_DIR": str(folder / "kernels"),
            "CI": "1",
        }
        sys.dont_write_bytecode = False  # compiled once, not in each fork
        for name in ("numpy", "scipy.stats", "numba", "pytest"):
            __import__(name)  # once, not in each fork

    def run(
        self, tests: list[str], timeout_s: float, *, data: Path | None = None
    ) -> tuple[int, list[ElementTree.Element]]:
        """Run tests; exit code, negative for a signal, and the cases of the report. With `data`, measure coverage."""
        report = self.folder / "report.xml"
        report.unlink(missing_ok=True)
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if not child:
            code = _BROKEN
            try:
                code = self._run_here(tests, report, data)
            except BaseException:  # pytest's own end: of objects that nobody has closed, say
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)
        clock = threading.Timer(timeout_s, os.kill, (child, signal.SIGKILL))
        clock.start()
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        clock.cancel()
        clock.join()
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # what its tests have left
        return code, [*ElementTree.parse(report).iter("testcase")] if report.is_file() else []

    def _run_here(self, tests: list[str], report: Path, data: Path | None) -> int:
        import pytest

        os.setsid()
        os.chdir(self.folder)
        output = os.open("output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        sys.path[0] = str(self.folder)
        sys.modules.pop("tests", None)
        options = "-q", "-p", "no:cacheprovider", "--no-xvfb", f"--junitxml={report}", "-o", "junit_family=xunit1"
        if data is None:
            code = pytest.main([*options, *tests])
        else:
            from coverage import Coverage

            measured = Coverage(data_file=str(data), source=[str(self.folder / "gsrain_engine")], config_file=False)
            measured.start()
            code = pytest.main([*options, *tests], plugins=[LinesByTest(measured)])
            measured.stop()
            measured.save()
        engine = sys.modules.get("gsrain_engine")
        if engine is not None and not Path(engine.__file__).is_relative_to(self.folder):
            code = _ELSEWHERE
        sys.stdout.flush()
        return int(code)

    def forget_kernels(self, file: str) -> None:
        """Let kernels of a folder be compiled anew: Numba looks at a kernel's own file, not at those it calls."""
        for folder in (self.folder / "kernels").glob(f"{Path(file).parent.name}_*"):
            shutil.rmtree(folder)


class LinesByTest:
    """Plugin of pytest that notes lines under the name of the test that runs them, its fixtures among them."""

    def __init__(self, measured: "Coverage") -> None:
        self._measured = measured

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Begin a test."""
        self._measured.switch_context(nodeid.split("[")[0])


class TestChoice:
    """Tests by the lines that they run; measured where a file of tests is not yet, and stored in `folder`."""

    __test__ = False

    def __init__(self, folder: Path, copy: Copy) -> None:
        file = folder / "coverage.json"
        stored = json.loads(file.read_text()) if file.is_file() else {"files": {}, "seconds": {}, "lines": {}}
        self._seconds: dict[str, float] = stored["seconds"]
        self._lines: dict[str, dict[str, list[str]]] = stored["lines"]
        files: dict[str, str] = stored["files"]
        for part in TESTS:
            present = {str(each.relative_to(ROOT)): _digest(each) for each in _test_files(ROOT / part)}
            if changed := [name for name, digest in present.items() if files.get(name) != digest]:
                print(f"measuring {len(changed)} files of {part}", flush=True, file=sys.stderr)
                self._forget(set(changed))
                self._measure(changed, copy, folder / "coverage")
                files |= present
                file.write_text(json.dumps({"files": files, "seconds": self._seconds, "lines": self._lines}))

    def _forget(self, files: set[str]) -> None:
        self._seconds = {name: took for name, took in self._seconds.items() if name.split("::")[0] not in files}
        for of_file in self._lines.values():
            for line, names in of_file.items():
                of_file[line] = [name for name in names if name.split("::")[0] not in files]

    def _measure(self, files: list[str], copy: Copy, data: Path) -> None:
        from coverage import CoverageData

        data.unlink(missing_ok=True)
        code, cases = copy.run(files, 3600.0, data=data.resolve())
        shutil.copy2(copy.folder / "output.txt", data.with_name("tests.txt"))
        if code not in (0, 1):
            raise RuntimeError(f"pytest ended with {code}: {(copy.folder / 'output.txt').read_text()[-2000:]}")
        bad = {_node(case) for case in cases if _has_failed(case)}
        for case in cases:
            if _node(case) not in bad and case.find("skipped") is None:
                self._seconds[_node(case)] = self._seconds.get(_node(case), 0.0) + float(case.get("time", 0))
        measured = CoverageData(basename=str(data))
        measured.read()
        for file in measured.measured_files():
            of_file = self._lines.setdefault(str(Path(file).relative_to(copy.folder.resolve())), {})
            for line, contexts in measured.contexts_by_lineno(file).items():
                if names := set(contexts) & self._seconds.keys():
                    of_file[str(line)] = sorted(names | set(of_file.get(str(line), ())))

    def of(self, mutant: Mutant) -> list[str]:
        """Tests for a mutant."""
        lines = self._lines.get(mutant.file, {})
        found = {name for line in (mutant.line, mutant.statement_line) for name in lines.get(str(line), ())}
        folder = "tests/" + "/".join(Path(mutant.file).parts[1:-1]) + "/"
        if mutant.has_no_line or not found:
            naming = self._naming(Path(mutant.file).stem)
            found = {name for names in lines.values() for name in names}
            found |= {name for name in self._seconds if name.split("::")[0] in naming}
        if not found:
            found = {name for name in self._seconds if name.startswith(folder)}
        own = f"test_{Path(mutant.file).stem}.py::"
        near = sorted(found, key=lambda name: (own not in name, not name.startswith(folder), self._seconds[name]))
        chosen, total = [], 0.0
        for name in near:
            if total > BUDGET_S:
                break
            chosen.append(name)
            total += self._seconds[name]
        return chosen

    def _naming(self, module: str) -> set[str]:
        """Files of tests that name a module: one that compares its constants runs none of its lines."""
        files = {name.split("::")[0] for name in self._seconds}
        return {file for file in files if f"{module} import" in (ROOT / file).read_text(encoding="utf-8")}

    @property
    def known(self) -> set[str]:
        """Tests that pass without a change."""
        return set(self._seconds)

    def seconds(self, tests: list[str]) -> float:
        """Time that tests took without a change."""
        return sum(self._seconds[name] for name in tests)


def _test_files(path: Path) -> list[Path]:
    return sorted(path.rglob("test_*.py")) if path.is_dir() else [path]


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _has_failed(case: ElementTree.Element) -> bool:
    return case.find("failure") is not None or case.find("error") is not None


def _node(case: ElementTree.Element) -> str:
    """Name by which pytest is asked for the test of a report, all its parameters together."""
    file, function = case.get("file", ""), case.get("name", "").split("[")[0]
    last = case.get("classname", "").rpartition(".")[2]
    return f"{file}::{last}::{function}" if last[:1].isupper() else f"{file}::{function}"


def judge(mutant: Mutant, choice: TestChoice, copy: Copy) -> Verdict:
    """Apply a mutant to a copy, run its tests there, and take it back."""
    tests = choice.of(mutant)
    if not tests:
        return Verdict(mutant, "untested", "", 0, 0.0)
    changed = copy.folder / mutant.file
    source, status = changed.read_text(encoding="utf-8"), changed.stat()
    changed.write_text(mutant.applied(source), encoding="utf-8")
    if mutant.has_no_line:
        copy.forget_kernels(mutant.file)
    began = time.monotonic()
    try:
        code, cases = copy.run(["-x", *tests], TIMEOUT_S + 10 * choice.seconds(tests))
    finally:
        changed.write_text(source, encoding="utf-8")
        os.utime(changed, ns=(status.st_atime_ns, status.st_mtime_ns))
        if mutant.has_no_line:
            copy.forget_kernels(mutant.file)
    if code in (_ELSEWHERE, 5):  # 5: no test found
        raise RuntimeError(f"pytest ended with {code} for {mutant}: {(copy.folder / 'output.txt').read_text()[-2000:]}")
    result = {0: "survived", -signal.SIGKILL: "timeout"}.get(code, "failed")
    failed = [_node(case) for case in cases if _has_failed(case)]
    return Verdict(mutant, result, next(iter(failed), ""), len(tests), time.monotonic() - began)


def _check(tests: set[str], copy: Copy) -> None:
    """Run tests that have failed for mutants without one."""
    code, cases = copy.run(sorted(tests), 3600.0) if tests else (0, [])
    if code:
        print(f"the unchanged copy: pytest ended with {code}")
    for case in cases:
        if _has_failed(case):
            print(f"fails without a change, so its verdicts are none: {_node(case)}")


if __name__ == "__main__":
    sys.exit(main())
