"""Writes the tables of docs/python.md: python -m docs.api_page. Each row is a signature and what its docstring says."""

import ast
import re
from pathlib import Path

from gsrain_engine.api import TOPICS

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "python.md"
_TABLES = re.compile(r"(?<=<!-- tables -->\n).*?(?=<!-- end of tables -->)", re.DOTALL)


def main() -> None:
    """Write the tables anew."""
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(_TABLES.sub(lambda _: tables(), text), encoding="utf-8")
    print(f"wrote {PAGE}")


def written_tables() -> str:
    """Return the tables as the page has them."""
    found = _TABLES.search(PAGE.read_text(encoding="utf-8"))
    assert found is not None
    return found[0]


def tables() -> str:
    """Return a heading and a table for each topic of the API."""
    parts = ["\n"]
    for topic, places in TOPICS.items():
        rows = [_row(name, place) for name, place in places.items()]
        parts.append(f"### {topic}\n\n| name | what it is |\n|---|---|\n" + "".join(rows) + "\n")
    return "".join(parts)


def _row(name: str, place: str) -> str:
    signature, says = _described(name, ROOT / "gsrain_engine" / f"{place.replace('.', '/')}.py")
    first = re.split(r"(?<!\beq\.)(?<!\bal\.)(?<=\.)\s|\n\n", says.strip(), maxsplit=1)[0]
    return f"| `{signature}` | {' '.join(first.split()).replace('|', chr(92) + '|')} |\n"


def _described(name: str, module: Path) -> tuple[str, str]:
    """Return a name's signature and docstring, from its source: nothing is imported."""
    body = ast.parse(module.read_text(encoding="utf-8")).body
    for node, following in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and node.name == name:
            return name, ast.get_docstring(node) or ""
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return f"{name}({_parameters(node.args)})", ast.get_docstring(node) or ""
        if isinstance(node, ast.Assign | ast.AnnAssign) and name in _assigned(node):
            text = following.value if isinstance(following, ast.Expr) else None
            return name, str(text.value) if isinstance(text, ast.Constant) else ""
    raise ValueError(f"{module}: has no {name}")


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
    return ", ".join(words)


if __name__ == "__main__":
    main()
