"""The Python API from its source: tables of docs/python.md (`python -m docs.tables`), and a page of the site."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STUB = ROOT / "gsrain" / "__init__.pyi"
TOPICS = {
    "Scenes and cameras": "scenes",
    "Rain": "rain",
    "Images and videos": "rendering",
    "Jobs": "jobs",
    "Driving": "driving",
    "The window": "viewer browser",
}
"""Headings of the page, and the modules of `gsrain` whose names are listed below each."""


def tables() -> str:
    """Return a heading and a table for each topic of the API."""
    names = _exported(ast.parse(STUB.read_text(encoding="utf-8")), STUB)
    parts = ["\n"]
    for topic, modules in TOPICS.items():
        files = [ROOT / "gsrain" / f"{module}.py" for module in modules.split()]
        rows = [_row(name, place) for file in files for name, place in names.items() if place == file]
        parts.append(f"### {topic}\n\n| name | what it is |\n|---|---|\n" + "".join(rows) + "\n")
    return "".join(parts)


PICTURES = {
    "Rain": ("rain_8.5.jpg", "The street in 8.5 mm/h"),
    "Images and videos": ("notebook_views.jpg", "A clear and a rainy image"),
    "Driving": ("drive_film.jpg", "A drive, frame by frame"),
    "The window": ("browser.jpg", "`gr.BrowserViewer`"),
}
"""Picture below a heading of the site's page, and what it shows."""
_LINE = 90
_SECTION = re.compile(r"^(Args|Returns|Raises):\n((?:(?: {4}.*)?\n?)*)", re.MULTILINE)
_ENTRY = re.compile(r"^ {4}(\w+): ", re.MULTILINE)
_INTRODUCTION = (
    "What `import gsrain as gr` has, from the source when this site was built; [From Python](python.md) shows it in "
    "use. Lengths are in meters, times in seconds, rain rates in mm/h."
)


def page() -> str:
    """Return the site's reference: each name with its signature, its docstring, and the members of classes."""
    names = _exported(ast.parse(STUB.read_text(encoding="utf-8")), STUB)
    parts = ["# Python API", _INTRODUCTION]
    for topic, modules in TOPICS.items():
        parts.append(f"## {topic}")
        if topic in PICTURES:
            file, shows = PICTURES[topic]
            parts.append(f"![{shows}](images/{file})")
        files = [ROOT / "gsrain" / f"{module}.py" for module in modules.split()]
        for file in files:
            parts += [_entry(name, place) for name, place in names.items() if place == file]
    return "\n\n".join(parts) + "\n"


def _entry(name: str, file: Path) -> str:
    signature, says = _described(name, file)
    node = _definition(name, file)
    if isinstance(node, ast.FunctionDef):
        signature = f"{name}({ast.unparse(node.args)}) -> {ast.unparse(node.returns) if node.returns else 'None'}"
    if isinstance(node, ast.ClassDef):
        begin = next((each for each in _functions(node) if each.name in ("__init__", "__new__")), None)
        if begin is not None:
            says += "\n\n" + (ast.get_docstring(begin) or "").partition("\n\n")[2]
            signature = f"{name}({ast.unparse(begin.args).partition(', ')[2]})"
        elif any("dataclass" in ast.unparse(each) for each in node.decorator_list):
            given = [each for each in node.body if isinstance(each, ast.AnnAssign) and "init=" not in ast.unparse(each)]
            signature = f"{name}({', '.join(map(ast.unparse, given))})"
    parts = [f"### {name}", f"```python\ngr.{_wrapped(signature)}\n```", _as_markdown(says)]
    if isinstance(node, ast.ClassDef) and (rows := _members(node)):
        parts.append("| member | what it is |\n|---|---|\n" + "\n".join(rows))
    return "\n\n".join(parts)


def _wrapped(signature: str) -> str:
    """Return a signature, one argument a line where it is long."""
    if len(signature) <= _LINE:
        return signature
    depth, lines, begun = 0, [""], signature.index("(") + 1
    for at, sign in enumerate(signature[begun:], begun):
        depth += (sign in "([{") - (sign in ")]}")
        if depth < 0:
            return "\n    ".join([signature[:begun], *(f"{each.strip()}," for each in lines)]) + f"\n{signature[at:]}"
        if sign == "," and depth == 0:
            lines.append("")
        else:
            lines[-1] += sign
    return signature


def _definition(name: str, file: Path) -> ast.stmt | None:
    """Return the class or function of a name, wherever it is imported from."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return node
    for node in tree.body:
        for each in node.names if isinstance(node, ast.ImportFrom) else []:
            if (each.asname or each.name) == name and (place := _exported(tree, file).get(name)) is not None:
                return _definition(each.name, place)
    return None


def _functions(node: ast.ClassDef) -> list[ast.FunctionDef]:
    return [each for each in node.body if isinstance(each, ast.FunctionDef)]


def _members(node: ast.ClassDef) -> list[str]:
    """Rows of the documented fields, properties and methods of a class."""
    rows: dict[str, str] = {}
    for each, following in zip(node.body, [*node.body[1:], None], strict=True):
        if isinstance(each, ast.AnnAssign) and isinstance(following, ast.Expr):
            says = following.value.value if isinstance(following.value, ast.Constant) else ""
            rows[ast.unparse(each.target)] = str(says)
    for each in _functions(node):
        decorators = {ast.unparse(decorator).rpartition(".")[2] for decorator in each.decorator_list}
        if not each.name.startswith("_") and "setter" not in decorators:
            given = _parameters(each.args).removeprefix("self, ").removeprefix("cls, ").removeprefix("self")
            call = "" if decorators & {"property", "cached_property"} else f"({given.removeprefix('cls')})"
            rows[f"{each.name}{call}"] = ast.get_docstring(each) or ""
    lines = {name: " ".join(says.partition("\n\n")[0].split()).replace("|", "\\|") for name, says in rows.items()}
    return [f"| `{name.replace('|', chr(92) + '|')}` | {says} |" for name, says in lines.items() if says]


def _as_markdown(says: str) -> str:
    """Return a docstring with lists in place of its sections."""

    def listed(section: re.Match[str]) -> str:
        title = {"Args": "Arguments", "Returns": "Returns", "Raises": "Raises"}[section[1]]
        entries = _ENTRY.split(section[2])
        if len(entries) == 1:
            return f"{title}: {' '.join(section[2].split())}\n\n"
        pairs = zip(entries[1::2], entries[2::2], strict=True)
        return f"{title}:\n\n" + "".join(f"* `{name}`: {' '.join(text.split())}\n" for name, text in pairs) + "\n"

    return _SECTION.sub(listed, says.strip()).strip()


def _row(name: str, file: Path) -> str:
    signature, says = _described(name, file)
    first = re.split(r"(?<!\beq\.)(?<!\bal\.)(?<=\.)\s|\n\n", says.strip(), maxsplit=1)[0]
    return f"| `{signature}` | {' '.join(first.split()).replace('|', chr(92) + '|')} |\n"


def _exported(tree: ast.Module, file: Path) -> dict[str, Path]:
    """Return the file of each name that a module imports by `from ... import`."""
    found: dict[str, Path] = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            parts = (node.module or "").split(".")
            base = file.parents[node.level - 1] if node.level else ROOT
            module = base.joinpath(*filter(None, parts))
            place = module.with_suffix(".py") if module.with_suffix(".py").is_file() else module / "__init__.py"
            found |= {each.asname or each.name: place for each in node.names if place.is_file()}
    return found


def _described(name: str, file: Path) -> tuple[str, str]:
    """Return a name's signature and docstring, from its source, wherever that is: nothing is imported."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node, following in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and node.name == name:
            return name, ast.get_docstring(node) or ""
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return f"{name}({_parameters(node.args)})", ast.get_docstring(node) or ""
        if isinstance(node, ast.Assign | ast.AnnAssign) and name in _assigned(node):
            text = following.value if isinstance(following, ast.Expr) else None
            return name, str(text.value) if isinstance(text, ast.Constant) else ""
    for node in tree.body:
        for each in node.names if isinstance(node, ast.ImportFrom) else []:
            if (each.asname or each.name) == name and (place := _exported(tree, file).get(name)) is not None:
                signature, says = _described(each.name, place)
                return signature.replace(each.name, name, 1), says
    raise ValueError(f"{file}: has no {name}")


def _assigned(node: ast.Assign | ast.AnnAssign) -> list[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return [each.id for each in targets if isinstance(each, ast.Name)]


def _parameters(arguments: ast.arguments) -> str:
    """Return names and defaults, without types."""
    plain = [each.arg for each in (*arguments.posonlyargs, *arguments.args)]
    without = len(plain) - len(arguments.defaults)
    words = [
        name if n < without else f"{name}={ast.unparse(arguments.defaults[n - without])}"
        for n, name in enumerate(plain)
    ]
    if arguments.kwonlyargs:
        words.append("*")
    for each, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        words.append(each.arg if default is None else f"{each.arg}={ast.unparse(default)}")
    if arguments.kwarg is not None:
        words.append(f"**{arguments.kwarg.arg}")
    return ", ".join(words)
