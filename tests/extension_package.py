"""A package as pip would leave it: modules, and metadata with entry points, on Python's path."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

_BLOCK = re.compile(r'^```\w+ title="([^"]+)"\n(.*?)^```$', re.DOTALL | re.MULTILINE)


def titled_blocks(page: Path) -> dict[str, str]:
    """The files that a page of the documentation shows, by their names."""
    return dict(_BLOCK.findall(page.read_text(encoding="utf-8")))


@contextmanager
def installed(folder: Path, name: str, files: dict[str, str], entries: dict[str, dict[str, str]]) -> Iterator[None]:
    """Install a package of some files for a while; `entries` are entry points by group and name."""
    for file, text in files.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text, encoding="utf-8")
    info = folder / f"{name.replace('-', '_')}-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n", encoding="utf-8")
    groups = (f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in named.items()) for group, named in entries.items())
    (info / "entry_points.txt").write_text("\n".join(groups), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        try:
            yield
        finally:
            for module in [
                each
                for each in sys.modules
                if each.partition(".")[0] in {Path(f).parts[0].removesuffix(".py") for f in files}
            ]:
                del sys.modules[module]
