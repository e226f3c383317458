"""The user's guide, which the program ships as Markdown, as blocks of plain text for the window."""

import re
from functools import cache
from typing import Literal, NamedTuple

from ..presets import shipped_path
from ..safe_io.text_files import read_whole

FOLDER = "docs/guide"
FIRST_PAGE, PANELS_PAGE, VIEW_PAGE = "first_steps.md", "panels.md", "looking_around.md"
_OTHERS = "../driving.md", "../physics/drops.md"  # pages of panels outside of the guide's folder

_IMAGE = re.compile(r"!\[[^\]]*\]\([^)]*\)")
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_EMPHASIS = re.compile(r"(?<![\w*])(\*{1,2})(\S(?:[^*]*\S)?)\1(?![\w*])")
_ITEM = re.compile(r"( *)(?:[*-]|\d+\.) +(.*)")
_RULE = re.compile(r"[|: -]+")


class Block(NamedTuple):
    """A paragraph of a page."""

    kind: Literal["heading", "paragraph", "item", "code"]
    text: str
    level: int = 0
    """Depth of a heading, from 1 on, or of a list's item, from 0 on."""

    @property
    def anchor(self) -> str:
        """Name of a heading in links, after #."""
        return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", self.text).strip().lower())


@cache
def guide_pages() -> dict[str, str]:
    """Return the titles of the pages by their path from the guide's folder, the first steps first.

    Raises `OSError` if the guide is missing.
    """
    folder = shipped_path(FOLDER)
    paths = [*sorted(each.name for each in folder.iterdir() if each.suffix == ".md"), *_OTHERS]
    paths.sort(key=lambda path: path != FIRST_PAGE)
    return {path: read_whole(folder / path).decode().partition("\n")[0].lstrip("# ") for path in paths}


@cache
def guide_page(path: str) -> tuple[Block, ...]:
    """Read a page by its path from the guide's folder; raises `OSError` if it is missing."""
    return tuple(blocks_of(read_whole(shipped_path(FOLDER) / path).decode()))


def blocks_of(markdown: str) -> list[Block]:
    """Return Markdown as blocks of plain text: pictures are left out, rows of tables are items of a list."""
    found, lines = list[Block](), list[str]()
    kind: Literal["paragraph", "item"] = "paragraph"
    level, is_code, given = 0, False, markdown.splitlines()

    def end() -> None:
        if text := _plain(" ".join(lines)):
            found.append(Block(kind, text, level))
        lines.clear()

    for line, after in zip(given, [*given[1:], ""], strict=True):
        item = _ITEM.fullmatch(line)
        if line.startswith("```"):
            end()
            is_code = not is_code
        elif is_code or (line.startswith("    ") and not lines):
            found.append(Block("code", line.removeprefix("    ")))
        elif line.startswith("#"):
            end()
            found.append(Block("heading", _plain(line.lstrip("# ")), len(line) - len(line.lstrip("#"))))
        elif line.startswith("|"):
            end()
            cells = [text for cell in line.strip("|").split("|") if (text := _plain(cell))]
            if len(cells) > 1 and not (_RULE.fullmatch(line) or _RULE.fullmatch(after)):  # not the head of a table
                found.append(Block("item", f"{cells[0]}: {'; '.join(cells[1:])}"))
        elif item is not None:
            end()
            kind, level = "item", len(item[1]) // 2
            lines.append(item[2])
        elif not line.strip():
            end()
            kind, level = "paragraph", 0
        else:
            lines.append(line.strip())
    end()
    return found


def _plain(text: str) -> str:
    """Return a line of Markdown without pictures, addresses of links, emphasis and marks of code."""
    text = _LINK.sub(r"\1", _IMAGE.sub("", text))
    return " ".join(_EMPHASIS.sub(r"\2", _EMPHASIS.sub(r"\2", text)).replace("`", "").split())
