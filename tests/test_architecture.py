"""The structure of the code: no circles of imports, no file that is too long, one module that prints."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("app", "ui", "gsrain", "gsrain_engine", "gsrain_extras")
MAX_LINES = 900
LONG = {
    "THIRD_PARTY_LICENCES.md": "a list, written by packaging/licences.py",
    "docs/extending.md": "a whole program for each thing that can be added, each of which a test runs",
}
"""Files that may be longer, and why."""


def modules() -> dict[str, Path]:
    paths = [path for each in PACKAGES for path in (ROOT / each).rglob("*.py")]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}


@cache
def nodes_by_kind(path: Path) -> dict[type[ast.AST], list[ast.AST]]:
    """All nodes of a file, which several tests look at."""
    found = defaultdict[type[ast.AST], list[ast.AST]](list)
    for node in ast.walk(ast.parse(path.read_bytes())):
        found[type(node)].append(node)
    return found


def nodes_of(path: Path, *kinds: type[ast.AST]) -> Iterator[ast.AST]:
    return chain.from_iterable(nodes_by_kind(path).get(kind, ()) for kind in kinds)


@pytest.fixture(scope="module", autouse=True)
def _only_here():
    yield
    nodes_by_kind.cache_clear()


def imported(module: str, path: Path, known: dict[str, Path]) -> Iterator[str]:
    """Every import of ours: those in functions and those that only type checkers follow too."""
    for node in nodes_of(path, ast.Import, ast.ImportFrom):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names if each.name in known)
        else:
            package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
            base = package[: len(package) + 1 - node.level] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            for each in node.names:
                yield f"{base}.{each.name}" if f"{base}.{each.name}" in known else base


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    known = modules()
    return {name: {each for each in imported(name, path, known) if each in known} for name, path in known.items()}


def test_no_module_imports_itself(imports):
    TopologicalSorter({name: needed - {name} for name, needed in imports.items()}).prepare()


def test_no_file_is_long_without_a_reason():
    tops = (*PACKAGES, "tests", "benchmarks", "examples", "docs", "packaging")
    files = [path for each in tops for path in (ROOT / each).rglob("*.py")]
    files += [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    lines = {str(each.relative_to(ROOT)): len(each.read_text(encoding="utf-8").splitlines()) for each in files}
    assert {name: count for name, count in lines.items() if count > MAX_LINES and name not in LONG} == {}


def printers(path: Path) -> Iterator[str]:
    """Everything in a file that prints without `app.console`: rich, the built-in print, the standard streams."""
    imports = [each for each in nodes_of(path, ast.ImportFrom) if each.module == "app.console" or each.level]
    own = {each.asname or each.name for node in imports if (node.module or "").endswith("console")
           for each in node.names}  # fmt: skip
    for node in nodes_of(path, ast.Import):
        yield from (each.name for each in node.names if each.name.split(".")[0] == "rich")
    for node in nodes_of(path, ast.ImportFrom):
        if not node.level and (node.module or "").split(".")[0] == "rich":
            yield str(node.module)
    for node in nodes_of(path, ast.Call):
        if isinstance(node.func, ast.Name) and node.func.id == "print":
            yield from () if "print" in own else ("print",)
        elif isinstance(node.func, ast.Attribute) and node.func.attr.startswith("write"):
            name = ast.unparse(node.func)
            yield from (name,) if name.startswith(("sys.stdout.", "sys.stderr.")) else ()


def test_only_the_console_prints():
    found = {name: list(printers(path)) for name, path in modules().items()}
    assert found.pop("app.console")
    assert found.pop("gsrain.browser") == ["print"]  # gr.show(server=True) names the page that it serves
    assert {name: each for name, each in found.items() if each} == {}


BANNED = (
    "beside", "told", "said", "kept", "wanted", "wish", "seen", "shown", "taken", "way", "beginning", "again", "sides",
    "whoever", "at_once", "haste", "pull", "most", "least", "usual", "given",
)  # fmt: skip
"""Words that say nothing in names of functions and classes: use the field's terms, docs/glossary.md."""
FIELD_TERMS = ("least_squares", "right_of_way")


def definitions(*kinds: type[ast.AST]) -> Iterator[tuple[str, ast.AST]]:
    return ((module, node) for module, path in modules().items() for node in nodes_of(path, *kinds))


def test_no_class_name_stands_for_two_classes():
    places: dict[str, set[str]] = {}
    for module, node in definitions(ast.ClassDef):
        places.setdefault(node.name, set()).add(f"{module}:{node.lineno}")
    del places["Renderer"], places["CameraPath"]  # `gsrain` has its own, over those of the engine
    assert {name: each for name, each in places.items() if len(each) > 1} == {}


def test_names_have_no_banned_words():
    banned = re.compile(rf"_({'|'.join(BANNED)})_")
    for module, node in definitions(ast.ClassDef, ast.FunctionDef):
        words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", node.name).lower()
        for term in FIELD_TERMS:
            words = words.replace(term, "")
        assert not banned.search(f"_{words}_"), f"{module}: {node.name}"


def test_no_package_is_smaller_than_three_modules():
    folders = [ROOT / each for each in PACKAGES if each != "gsrain_extras"]  # whose folders can be deleted
    packages = [path.parent for each in folders for path in each.rglob("__init__.py")]
    assert [each for each in packages if len(list(each.glob("*.py"))) + len(list(each.glob("*/__init__.py"))) < 3] == []


PUBLIC = {"_replace", "_asdict", "_fields", "_exit", "_make_wrapper_subclass"}
"""Members whose underscore is not for privacy: those of named tuples, of `os`, and one that torch asks for."""


def test_tests_touch_no_private_member():
    """But for those of classes in the same file."""
    found: list[str] = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_bytes())))
        own = {each.attr for each in nodes if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store)}
        found += [
            f"{path.relative_to(ROOT)}:{each.lineno}: {ast.unparse(each)}"
            for each in nodes
            if isinstance(each, ast.Attribute) and re.match("_[a-z]", each.attr)
            if each.attr not in PUBLIC | own and ast.unparse(each.value) not in ("self", "cls")
        ]
    assert found == []


RIDDLE = re.compile(r'\s*"""(What|How|Where|Who|Which|When|Whether|Whose|Why)\b')


def test_docstrings_name_the_thing():
    """A docstring begins with a verb or with the noun that the thing is, in tests and benchmarks too."""
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for folder in (*PACKAGES, "tests", "benchmarks")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for number, line in enumerate(path.read_text("utf-8").splitlines(), start=1)
        if RIDDLE.match(line)
    ]
    assert found == []
