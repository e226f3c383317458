"""Runs examples/10_notebook.ipynb and keeps the pictures that it shows: python -m docs.notebook_pictures."""

import ast
import json
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOK = ROOT / "examples" / "10_notebook.ipynb"
KEPT = {"draw": "notebook_views.jpg", "alone": "notebook_difference.jpg"}
"""Pictures by the ids of the cells that show them."""


def main() -> None:
    """Write the pictures of docs/python.md."""
    names: dict[str, Any] = {}
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        body = ast.parse("".join(cell["source"]))
        last = body.body.pop() if isinstance(body.body[-1], ast.Expr) else None
        exec(compile(body, cell["id"], "exec"), names)
        if isinstance(last, ast.Expr) and cell["id"] in KEPT:
            shown = eval(compile(ast.Expression(last.value), cell["id"], "eval"), names)
            file = ROOT / "docs" / "images" / KEPT[cell["id"]]
            Image.Image.save(shown, file, quality=88, optimize=True)
            print(f"wrote {file}")


if __name__ == "__main__":
    main()
