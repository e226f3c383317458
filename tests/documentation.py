"""The texts of the documentation: pages, their headings, links and commands."""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

from repository import REPOSITORY

PAGES = sorted(
    each.relative_to(REPOSITORY)
    for each in (*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md"), *REPOSITORY.glob("[a-z]*/README.md"))
)
_FENCE = re.compile(r"^( *)```[^\n]*\n.*?^\1```$", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
_COMMAND = re.compile(r"^(?: {4,}|)(?:\$ )?(gsrain(?: [^\n]*)?)$")
_IN_SENTENCE = re.compile(r"`(gsrain [a-z][^`\n]*)`")


class Command(NamedTuple):
    """A command that a page tells people to type."""

    page: Path
    line: int
    words: tuple[str, ...]
    is_whole: bool = True
    """True for a command in a code block, to be typed as it is; in a sentence, arguments may be left out."""


def text_of(page: Path) -> str:
    return (REPOSITORY / page).read_text(encoding="utf-8")


def links_of(page: Path) -> list[str]:
    """Targets of links and pictures that are in the repository."""
    prose = _FENCE.sub("", text_of(page))
    prose = re.sub(r"^ {4,}.*$|`[^`\n]*`", "", prose, flags=re.MULTILINE)
    return [each for each in _LINK.findall(prose) if not re.match(r"[a-z]+:", each)]


def anchors_of(page: Path) -> set[str]:
    """Names of the headings for which GitHub and the site agree, and those given by hand."""
    text = _FENCE.sub("", text_of(page))
    headings = [re.sub(r"\[([^\]]*)\]\([^)]*\)|[*`]", r"\1", each) for each in _HEADING.findall(text)]
    github = [re.sub(r"[^\w\- ]", "", each.lower()).replace(" ", "-") for each in headings]
    site = [re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", each).strip().lower()) for each in headings]
    return {a for a, b in zip(github, site, strict=True) if a == b} | set(re.findall(r'<a (?:id|name)="([^"]+)"', text))


def commands_of(page: Path) -> list[Command]:
    """Lines of code blocks that begin with `gsrain`, up to a pipe or another command; `...` stands for anything."""
    found: list[Command] = []
    lines, inside = text_of(page).splitlines(), False
    for number, line in enumerate(lines, 1):
        if line.lstrip().startswith("```"):
            inside = not inside
        match = _COMMAND.match(line)
        if match is None or not (inside or line.startswith("    ")):
            continue
        text, following = match[1], number
        while text.endswith("\\"):
            text = text[:-1] + lines[following]
            following += 1
        words = shlex.split(text, comments=True)
        end = next((n for n, word in enumerate(words) if word in ("|", "||", "&&", ">", "2>", ";", "&")), len(words))
        if not {"...", "…"} & set(words):
            found.append(Command(page, number, tuple(words[1:end])))
    return found + [
        Command(page, match.string[: match.start()].count("\n") + 1, tuple(shlex.split(match[1])[1:]), is_whole=False)
        for match in _IN_SENTENCE.finditer(_FENCE.sub(_blank, text_of(page)))
        if not {"|", "…", "..."} & set(match[1].replace("|", " | ").split())
    ]


def _blank(block: re.Match[str]) -> str:
    """As many empty lines: what follows keeps its line numbers."""
    return "\n" * block[0].count("\n")
