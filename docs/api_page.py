"""Tables of docs/python.md, which `python -m docs.tables` writes: signatures, and what their docstrings say."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STUB = ROOT / "gsrain" / "__init__.pyi"
TOPICS = {
    "Scenes and cameras": "scenes",
    "Rain": "rain",
    "Images and videos": "rendering",
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
