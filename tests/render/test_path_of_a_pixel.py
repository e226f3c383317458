"""The path of a pixel in docs/architecture.md is the one that a render takes."""

import re
import sys

from app.main import run
from repository import REPOSITORY

_STEP = re.compile(r"^\d+\. `(\S+): ([\w.]+)`( \*)?", re.MULTILINE)


def test_the_functions_of_the_page_are_called_in_its_order(tmp_path):
    page = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    steps = _STEP.findall(page.partition("## The path of a pixel")[2].partition("\n## ")[0])
    assert 10 <= len(steps) <= 15
    assert sum(bool(mark) for *_, mark in steps) <= 3
    calls = calls_of(["render", "street", "--rain", "8.5", "-o", str(tmp_path / "out.png"), "--backend", "cpu"])
    at = 0
    assert steps[0][:2] == ("app/__main__.py", "main")  # which ends the process with the result of the second
    for file, name, _ in steps[1:]:
        assert (file, name) in calls[at:], f"{name} of {file} is not called after the steps before it"
        at = calls.index((file, name), at) + 1


def calls_of(arguments):
    """File and name of each function of the repository that a command calls, in order."""
    calls, root = [], f"{REPOSITORY}/"

    def note(frame, event, _):
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(root):
            calls.append((code.co_filename.removeprefix(root), code.co_qualname))

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        assert run([*arguments, "--size", "96x64"]) == 0
    finally:
        sys.setprofile(before)
    return calls
