"""Measures the tests: changes one place of the program at a time and runs the tests of it; python -m tests.mutants.

Places are drawn by a seed; one whose change leaves the bytecode as it is, or disables a check of the code on itself, is
none. A mutant that no test notices survives, and is printed as a line of code to be read: either the change makes no
difference, or a test is missing. All runs are forks of this process in a copy of the checkout.
First come all tests, as they are: which pass there, how long each takes, which lines it runs. A mutant gets those that
run its line, nearest first, then the quickest; one in a compiled kernel, whose lines no tracer sees, or in what runs at
import, those of its file or that name it, and kernels compiled anew. In the end tests that noticed anything run once
more without a change: what fails then is no verdict.

Verdicts are lines of a file, written as they come: a second call continues where the first ended. Where the program or
its tests have changed, remove the folder.
"""

import argparse
import ast
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

from tests.repository import is_compiled

ROOT = Path(__file__).resolve().parents[1]
COPIED = (
    "app", "ui", "gsrain", "gsrain_engine", "gsrain_extras", "shaders", "sample_configs", "tests", "docs", "examples",
    "benchmarks",
)  # fmt: skip
TESTS = {"app": "tests/app", "ui": "tests/ui", "gsrain": "tests/python_api", "gsrain_engine": "tests"}
"""Packages, and the folders of their tests; those of the engine have one for each folder of it."""
BUDGET_S = 20.0
"""Tests of one mutant, added up as they took without it."""
TIMEOUT_S = 60.0
"""So much longer than ten times its tests, and a mutant is one that never ends."""
BROKEN = 70
"""Exit code: pytest itself has failed, or it ran other packages than the copy's."""

COMPARE = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
BINARY = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitOr,
}  # fmt: skip
CALLS = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor",
    "sin": "cos", "cos": "sin", "any": "all", "all": "any",
}  # fmt: skip


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

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {' '.join(self.before.split())[:110]}  ->  {self.text[:110]!r}"


class Verdict(NamedTuple):
    """The tests' answer to a mutant."""

    mutant: Mutant
    result: str  # "failed", "timeout", "survived" or "untested"
    failed_test: str = ""
    tests: int = 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("subjects", nargs="+", help="files and folders to change")
    parser.add_argument("--count", type=int, default=300, help="mutants to draw")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", nargs="+", help="tests that may notice a change; default: those of the packages")
    parser.add_argument("--out", type=Path, default=Path("out/mutants"), help="coverage and verdicts go here")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / f"verdicts-{arguments.seed}.jsonl"
    rows = map(json.loads, file.read_text().splitlines()) if file.is_file() else ()
    verdicts = {Mutant(*fields): Verdict(Mutant(*fields), *others) for fields, *others in rows}
    files = sorted({name for subject in arguments.subjects for name in python_files(subject)})
    places = [mutant for name in files for mutant in mutants_of(name, (ROOT / name).read_text(encoding="utf-8"))]
    drawn = random.Random(arguments.seed).sample(places, min(arguments.count, len(places)))
    chosen = [each for each in drawn if has_effect(each)]
    print(f"{len(files)} files, {len(places)} places, {len(drawn)} drawn, {len(chosen)} with an effect", flush=True)
    with tempfile.TemporaryDirectory(prefix="gsrain-mutants-") as folder, file.open("a") as out:
        copy = Copy(Path(folder))
        folders = sorted({tests_folder(name) for name in files})
        tests = TestChoice(arguments.out / "coverage.json", arguments.tests or folders, copy)
        for number, mutant in enumerate((each for each in chosen if each not in verdicts), 1):
            verdict = verdicts[mutant] = judge(mutant, tests, copy)
            out.write(json.dumps(verdict) + "\n")
            out.flush()
            if verdict.result in ("survived", "untested"):
                print(f"{verdict.result} {mutant} ({verdict.tests} tests)", flush=True)
            print(f"[{number}] {verdict.result}", flush=True, file=sys.stderr)
        noticed = tests.seconds.keys() & {each.failed_test for each in verdicts.values()}
        for name in copy.run(sorted(noticed), 3600.0)[1].get("failed", ()) if noticed else ():
            print(f"fails without a change, so its verdicts are none: {name}")
    survivors = sum(each.result in ("survived", "untested") for each in verdicts.values())
    print(f"{survivors} of {len(verdicts)} not noticed")
    return 0


def python_files(subject: str) -> list[str]:
    path = ROOT / subject
    found = path.rglob("*.py") if path.is_dir() else [path]
    return [str(each.relative_to(ROOT)) for each in found if each.name != "__init__.py"]


def tests_folder(file: str) -> str:
    """Return the folder with the tests of a file."""
    package, *folders, _ = Path(file).parts
    return "/".join([TESTS[package], *(folders if package == "gsrain_engine" else ())])


# Places


def mutants_of(file: str, source: str) -> Iterator[Mutant]:
    """All places of a file, with what each would become."""
    tree = ast.parse(source)
    rows = source.splitlines(keepends=True)
    starts = [sum(map(len, rows[:n])) for n in range(len(rows) + 1)]

    def offset(line: int, column: int) -> int:  # columns of the syntax tree count bytes
        return starts[line - 1] + len(rows[line - 1].encode()[:column].decode())

    passive = {id(node) for part in passive_parts(tree) for node in ast.walk(part)}
    statements: dict[int, int] = {}
    in_functions: set[int] = set()
    kernels: set[int] = set()
    for each in ast.walk(tree):  # outer ones first
        if isinstance(each, ast.stmt):
            statements |= {id(node): each.lineno for node in ast.walk(each)}
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef):
            inner = {id(node) for statement in each.body for node in ast.walk(statement)}
            in_functions |= inner
            kernels |= inner if is_compiled(each) else set()
    for node in ast.walk(tree):
        for text in changes(node) if id(node) not in passive else ():
            start, end = offset(node.lineno, node.col_offset), offset(node.end_lineno, node.end_col_offset)
            has_no_line = id(node) not in in_functions or id(node) in kernels
            yield Mutant(file, node.lineno, statements[id(node)], start, end, source[start:end], text, has_no_line)


def passive_parts(tree: ast.Module) -> Iterator[ast.AST]:
    """Parts that decide nothing: annotations, decorators, error sentences, log lines, `if TYPE_CHECKING`.

    Nor do checks of the code on itself, which no correct call fails: lengths of `zip`, immutable structs, assertions.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from node.decorator_list
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns:
            yield node.returns
        if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
            yield node.annotation
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
            yield node
        if isinstance(node, ast.keyword) and node.arg in ("strict", "frozen", "kw_only"):
            yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            yield node
        if isinstance(node, ast.Expr) and ast.unparse(node).startswith(("logger.", "warnings.")):
            yield node


def changes(node: ast.AST) -> Iterator[str]:
    """Replacements of a place: a neighboring comparison, another operator or function, a larger number, nothing."""
    match node:
        case ast.Compare(left, [operator], others) if type(operator) in COMPARE:
            yield ast.unparse(ast.Compare(left, [COMPARE[type(operator)]()], others))
        case ast.BinOp(left, operator, right) if type(operator) in BINARY:
            if not any(isinstance(each, ast.Constant) and isinstance(each.value, str) for each in (left, right)):
                yield f"({ast.unparse(ast.BinOp(left, BINARY[type(operator)](), right))})"
        case ast.BoolOp(operator, values):
            yield f"({ast.unparse(ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values))})"
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield f"({ast.unparse(operand)})"
        case ast.Constant(bool(value)):
            yield str(not value)
        case ast.Constant(int(value)):
            yield repr(value + 1)
        case ast.Constant(float(value)):
            yield repr(value * 1.25 if value else 1.0)
        case ast.Call(ast.Attribute(owner, name), arguments, named) if name in CALLS:
            yield ast.unparse(ast.Call(ast.Attribute(owner, CALLS[name]), arguments, named))
        case ast.Call(ast.Name(name), arguments, named) if name in CALLS:
            yield ast.unparse(ast.Call(ast.Name(CALLS[name]), arguments, named))
        case ast.Call(ast.Name("abs") | ast.Attribute(_, "abs"), [argument, *_]):
            yield f"({ast.unparse(argument)})"
        case ast.If(_, [*_, ast.Raise() | ast.Return() | ast.Continue()] as body, []):
            yield ast.unparse(ast.If(ast.Constant(False), body, [])).replace("\n", "\n" + " " * node.col_offset)
        case ast.Expr(ast.Call()):
            yield "pass"


def has_effect(mutant: Mutant) -> bool:
    """Return whether the change makes another program: the compiler folds constants and drops what is never reached."""
    source = (ROOT / mutant.file).read_text(encoding="utf-8")
    changed = source[: mutant.start] + mutant.text + source[mutant.end :]
    return _instructions(source) != _instructions(changed)


def _instructions(source: str | CodeType) -> tuple[Any, ...]:
    """Return what a program executes, without its lines and columns."""
    code = compile(source, "", "exec", dont_inherit=True) if isinstance(source, str) else source
    constants = tuple(
        _instructions(each) if isinstance(each, CodeType) else (type(each), repr(each)) for each in code.co_consts
    )
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    return code.co_code, constants, names, code.co_flags, code.co_exceptiontable


# Runs


class Recorder:
    """Plugin of pytest: failed tests, the time that others took, and lines under the name of the test that ran them.

    All parameters of a test count together.
    """

    def __init__(self, measured: Any) -> None:
        self.measured = measured
        self.failed: list[str] = []
        self.seconds: dict[str, float] = defaultdict(float)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        if self.measured is not None:
            self.measured.switch_context(nodeid.split("[")[0])

    def pytest_runtest_logreport(self, report: Any) -> None:
        name = report.nodeid.split("[")[0]
        if report.failed:
            self.failed.append(name)
        elif not report.skipped:
            self.seconds[name] += report.duration


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

    def run(self, tests: list[str], timeout_s: float, *, measures: bool = False) -> tuple[int, dict[str, Any]]:
        """Run tests; exit code, negative for a signal, and what `Recorder` has recorded, empty if it never ended."""
        record = self.folder / "record.json"
        record.unlink(missing_ok=True)
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if not child:
            code = BROKEN
            try:
                code = self.run_in_child(tests, record, measures)
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
        return code, json.loads(record.read_text()) if record.is_file() else {}

    def run_in_child(self, tests: list[str], record: Path, measures: bool) -> int:
        import pytest
        from coverage import Coverage

        os.setsid()
        os.chdir(self.folder)
        output = os.open("output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        sys.path[0] = str(self.folder)
        sys.modules.pop("tests", None)
        sources = [str(self.folder / name) for name in TESTS]
        measured = Coverage(data_file=None, source=sources, config_file=False) if measures else None
        recorder = Recorder(measured)
        if measured is not None:
            measured.start()
        code = int(pytest.main(["-q", "-p", "no:cacheprovider", "--no-xvfb", *tests], plugins=[recorder]))
        found: dict[str, Any] = {"failed": recorder.failed, "seconds": recorder.seconds, "lines": {}}
        if measured is not None:
            measured.stop()
            data = measured.get_data()
            for file in data.measured_files():
                lines = {
                    line: [name for name in names if name] for line, names in data.contexts_by_lineno(file).items()
                }
                found["lines"][str(Path(file).relative_to(self.folder.resolve()))] = lines
        record.write_text(json.dumps(found))
        loaded = [sys.modules[name] for name in TESTS if name in sys.modules]
        is_other = not all(Path(each.__path__[0]).is_relative_to(self.folder) for each in loaded)
        sys.stdout.flush()
        return BROKEN if is_other else code

    def forget_kernels(self, file: str) -> None:
        """Let kernels of a folder be compiled anew: Numba looks at a kernel's own file, not at those it calls."""
        for folder in (self.folder / "kernels").glob(f"{Path(file).parent.name}_*"):
            shutil.rmtree(folder)


class TestChoice:
    """Tests by the lines that they run, measured part by part and stored in a file."""

    __test__ = False

    def __init__(self, file: Path, parts: list[str], copy: Copy) -> None:
        known = json.loads(file.read_text()) if file.is_file() else {}
        for part in parts:
            if part not in known:
                print(f"measuring {part}", flush=True, file=sys.stderr)
                code, known[part] = copy.run([part], 3600.0, measures=True)
                if code not in (0, 1):
                    raise RuntimeError(f"pytest ended with {code}: {(copy.folder / 'output.txt').read_text()[-2000:]}")
                file.write_text(json.dumps(known))
        failed = {name for each in known.values() for name in each["failed"]}
        self.seconds: dict[str, float] = {}
        self.lines: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        for each in known.values():
            self.seconds |= {name: took for name, took in each["seconds"].items() if name not in failed}
            for name, lines in each["lines"].items():
                for line, tests in lines.items():
                    self.lines[name][line] |= set(tests) - failed

    def of(self, mutant: Mutant) -> list[str]:
        """Tests for a mutant, nearest first, then the quickest, until the budget is spent."""
        lines = self.lines[mutant.file]
        found = lines[str(mutant.line)] | lines[str(mutant.statement_line)]
        path = Path(mutant.file)
        folder, own = f"{tests_folder(mutant.file)}/", f"test_{path.stem}.py::"
        if mutant.has_no_line or not found:  # one that compares a file's constants runs none of its lines
            files = {name.split("::")[0] for name in self.seconds}
            naming = {file for file in files if f"{path.stem} import" in (ROOT / file).read_text(encoding="utf-8")}
            found = set().union(*lines.values(), (name for name in self.seconds if name.split("::")[0] in naming))
        found = found & self.seconds.keys() or {name for name in self.seconds if name.startswith(folder)}
        near = sorted(found, key=lambda name: (own not in name, not name.startswith(folder), self.seconds[name]))
        total, chosen = 0.0, list[str]()
        for name in near:
            if total > BUDGET_S:
                break
            chosen.append(name)
            total += self.seconds[name]
        return chosen


def judge(mutant: Mutant, choice: TestChoice, copy: Copy) -> Verdict:
    """Apply a mutant to a copy, run its tests there, and take it back."""
    tests = choice.of(mutant)
    if not tests:
        return Verdict(mutant, "untested")
    changed = copy.folder / mutant.file
    source, status = changed.read_text(encoding="utf-8"), changed.stat()
    changed.write_text(source[: mutant.start] + mutant.text + source[mutant.end :], encoding="utf-8")
    if mutant.has_no_line:
        copy.forget_kernels(mutant.file)
    try:
        code, record = copy.run(["-x", *tests], TIMEOUT_S + 10 * sum(choice.seconds[name] for name in tests))
    finally:
        changed.write_text(source, encoding="utf-8")
        os.utime(changed, ns=(status.st_atime_ns, status.st_mtime_ns))
        if mutant.has_no_line:
            copy.forget_kernels(mutant.file)
    if code == 5:  # no test found
        raise RuntimeError(f"no test found for {mutant}: {(copy.folder / 'output.txt').read_text()[-2000:]}")
    result = {0: "survived", -signal.SIGKILL: "timeout"}.get(code, "failed")
    failed = next(iter(record.get("failed", ())), "")
    return Verdict(mutant, result, failed, len(tests))


if __name__ == "__main__":
    sys.exit(main())
