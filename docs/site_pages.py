"""MkDocs hook: pages that are generated when the site is built."""

import posixpath
import re
import sys
from pathlib import Path
from typing import Any, get_args

ROOT = Path(__file__).resolve().parent.parent

# Texts that stand outside docs/, where people look for them first, and their pages in the site.
ELSEWHERE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changes.md",
    "THIRD_PARTY_LICENCES.md": "licences.md",
    "benchmarks/README.md": "benchmarks.md",
    "examples/README.md": "examples.md",
}

_LINK = re.compile(r"(!?\[[^\]]*\]\()([^)\s#]+)(#[^)\s]*)?\)")
_EXAMPLE = re.compile(r"(?<=\n\n)(gsrain [a-z].*)(?=\n\n)")
_CONTENTS = re.compile(r"^## Table of Contents$.*?(?=^## )", re.DOTALL | re.MULTILINE)
_LIST_BELOW_TEXT = re.compile(r"^(?![*#|> `]|\d+\. )(.+)\n(?=\* )", re.MULTILINE)
_LISTS = re.compile(r"^\*\*Commands\*\*:\n\n(?:\* .*\n)+\n?", re.MULTILINE)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages whose text is not in docs/."""
    from mkdocs.structure.files import File

    for source, page in ELSEWHERE.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    files.append(File.generated(config, "commands.md", content=commands_page()))
    files.append(File.generated(config, "settings.md", content=settings_page()))
    files.append(File.generated(config, "api.md", content=api_page()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Point links to where texts are in the site."""
    here = page.file.src_uri
    if here == "index.md":
        page.meta["hide"] = ["navigation"]  # it would hold this one page
    source = next((each for each, name in ELSEWHERE.items() if name == here), f"docs/{here}")
    spaced = _LIST_BELOW_TEXT.sub(r"\1\n\n", markdown)  # GitHub needs no empty line before a list, Python-Markdown does
    return with_site_links(spaced, source, here)


def with_site_links(markdown: str, source: str, page: str) -> str:
    """Rewrite relative links of a text, which is `source` in the repository and `page` in the site."""

    def led(link: re.Match[str]) -> str:
        opening, target, anchor = link[1], link[2], link[3] or ""
        if re.match(r"[a-z]+:", target):
            return link[0]
        place = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        place = ELSEWHERE.get(place, place.removeprefix("docs/"))
        return f"{opening}{posixpath.relpath(place, posixpath.dirname(page) or '.')}{anchor})"

    return _LINK.sub(led, markdown)


def commands_page() -> str:
    """Write the reference of the command line, from the program itself."""
    _import_from_checkout()
    from app.main import app, evaluations, installed
    from app.options import all_listed
    from gsrain_engine import plugins

    points = (app, plugins.COMMANDS), (evaluations, plugins.EVALUATIONS)
    with all_listed(), installed(*points[0]), installed(*points[1]):
        text = app.generate_docs(output_format="markdown")
    text = _LISTS.sub("", _CONTENTS.sub("", text, count=1))
    text = text.replace("# gsrain\n", "# Commands\n", 1).replace("```console\n", "```text\n")
    text = text.replace(' *[default: ""]*', "").replace("*[default: ", "*[").replace("**[required]**", "*[required]*")
    text = text.replace("**Parameters**:", "Options:").replace("**Arguments**:", "Arguments:")
    heading, usage, *rest = re.split(r"(?=^## )", text, maxsplit=1, flags=re.MULTILINE)[0].split("\n\n", 2)
    body = re.split(r"(?=^## )", text, maxsplit=1, flags=re.MULTILINE)[1]
    how = (
        "What `gsrain COMMAND --help-all` says, made from the program when this site was built. Every command prints "
        "what it wrote; `--json FILE` keeps the numbers that it reports; bad input ends with exit code 2 and one line, "
        "Ctrl-C with 130."
    )
    parts = [heading, how, usage, *rest, window_table()]
    return "\n\n".join(part.strip() for part in parts) + "\n\n" + _EXAMPLE.sub(r"    \1", body)


def window_table() -> str:
    """Write the commands of the window, with what does the same elsewhere, from the table of commands."""
    from ui.commands.table import all_commands

    rows = ["| in the window | keys | command line | Python |", "|---|---|---|---|"]
    for each in all_commands():
        shell = f"`gsrain edit` `{each.edit}`" if each.edit else f"`gsrain {each.shell}`" if each.shell else ""
        python = f"`gr.{each.python}`" if each.python else f'`gr.edit(scene, "{each.edit}")`' if each.edit else ""
        name = f"{each.menu} > {each.name}" if each.menu else each.name
        rows.append(" | ".join(["", name.replace("|", "\\|"), each.key_names, shell, python, ""]).strip())
    return "## In the window\n\nThe commands of menus, keys and palette, and what does the same.\n\n" + "\n".join(rows)


def api_page() -> str:
    """Write the reference of the Python API, from its source."""
    _import_from_checkout()
    from docs.api_page import page

    return page()


def settings_page() -> str:
    """Write the reference of the settings files, from the field table."""
    _import_from_checkout()
    from app.schema import SETTINGS, Kind, settings_type
    from gsrain_engine.fields import structs_of

    parts = ["# Settings", _SETTINGS_TEXT]
    listed: set[type] = set()
    places = {kind: f"Files of `sample_configs/{kind}`; " for kind in SETTINGS}
    titles = {kind: title for kind, (_, title) in SETTINGS.items()}
    for kind in get_args(Kind):
        title = titles.get(kind, kind.replace("_", " ").capitalize())
        parts.append(f"## {title}\n\n{places.get(kind, '')}`gsrain schema {kind}`.")
        for struct in structs_of(settings_type(kind)):
            if struct not in listed:
                parts += [f"### {struct.__name__}", (struct.__doc__ or "").strip().split("\n\n")[0], _table(struct)]
            listed.add(struct)
    return "\n\n".join(parts) + "\n"


_SETTINGS_TEXT = (
    "Fields of settings files (YAML), made from the program when this site was built. `gsrain schema KIND` prints the "
    "same for editors. A field without a default is required; options are those of the commands in the last column."
)


def _table(struct: type) -> str:
    from gsrain_engine.fields import fields_of

    rows = ["| field | meaning | range | default | option |", "|---|---|---|---|---|"]
    for each in fields_of(struct):
        meaning = ": ".join(filter(None, (each.title if each.title != each.name else "", each.help)))
        options = f"`{each.options[0]}` of {', '.join(each.commands)}" if each.commands else ""
        allowed = each.range or ", ".join(each.choices) or each.unit
        cells = (f"`{each.name}`", meaning, allowed, _default(each), options)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def _default(field: Any) -> str:
    from msgspec import NODEFAULT

    if field.default is NODEFAULT:
        return "required"
    if field.kind is bool and field.default is not None:
        return "on" if field.default else "off"
    return "none" if field.default is None else field.default_text


def _import_from_checkout() -> None:
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
