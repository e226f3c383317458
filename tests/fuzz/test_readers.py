"""Damaged files, some dozens a reader: each is read as something valid, or refused in one sentence that names it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from .found import findings, read_finding
from .reader import Example, limited_memory
from .readers import READERS

_FOUND = findings()


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Example]]:
    """One sound example a reader, made when it is asked for."""

    class Examples(dict[str, Example]):
        def __missing__(self, name: str) -> Example:
            try:
                self[name] = Example(READERS[name], tmp_path_factory.mktemp(name))
            except ModuleNotFoundError as error:
                pytest.skip(f"{name} needs {error.name}")
            return self[name]

    yield Examples()


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused(name: str, examples: dict[str, Example]) -> None:
    example = examples[name]
    with limited_memory():
        found = [finding for seed in range(READERS[name].tries) if (finding := example.tried(seed)) is not None]
    assert not found, f"{len(found)} of {READERS[name].tries}: {found[0].file}: {found[0].what}"


@pytest.mark.parametrize("file", _FOUND, ids=lambda file: file.stem)
def test_what_was_found_once_is_read_or_refused(file: Path, examples: dict[str, Example]) -> None:
    finding = read_finding(file)
    with limited_memory():
        again = examples[finding.reader].tried_with(finding.file, finding.content)
    assert again is None, again and again.what
