"""Bad input to the commands: one line that names option, file or field, exit code 2, nothing written."""

import shlex
import sys

import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from fuzz.reader import limited_memory, limited_time

TABLE = """
streaks real --frames 4                     | --frames 4
streaks empty --exposure 0.004,,0.01        | --exposure 0.004,,0.01
streaks empty --window 1,2,3                | --window 1,2,3
streaks empty --conditions none             | conditions none: no such file
streaks empty --report page.html            | --report page.html
streaks empty --set aperture_mm=51          | --set aperture_mm: 51 must be at most 50 mm
streaks empty --set exposure_s=0.1          | --set exposure_s: --exposure sets it here
streaks none --report file/below/x.md       | file is a file
streaks none --json file/below/x            | file is a file
rain-gauge empty --focal-px 0 --shutter 0.002 | --focal-px
rain-gauge empty --focal-px 900 --shutter 2 | --shutter
rain-gauge empty --focal-px 900 --shutter 0.002 | no images
rain-gauge pictures --focal-px 900 --shutter 0.002 | pictures
rain-gauge none --focal-px 900 --shutter 0.002 --json file/below/x | file is a file
"""
ROWS = [tuple(part.strip() for part in line.split(" | ")) for line in TABLE.splitlines()[1:]]


@pytest.mark.parametrize(("line", "words"), ROWS, ids=[line for line, _ in ROWS])
def test_bad_input_is_one_line_that_names_it(line, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("empty", "pictures"):
        (tmp_path / name).mkdir()
    for number in range(4):
        Image.new("RGB", (24, 16)).save(tmp_path / "pictures" / f"{number}.png")
    (tmp_path / "file").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    assert run(["evaluate", *shlex.split(line)]) == BAD_INPUT
    (error,) = capsys.readouterr().err.splitlines()
    assert words in error
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.skipif(sys.platform != "linux", reason="devices stand elsewhere under other names")
@pytest.mark.parametrize("line", ["streaks input", "rain-gauge input.mp4 --focal-px 900 --shutter 0.002"])
def test_devices_are_refused(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / line.split()[1]).symlink_to("/dev/zero")
    with limited_memory(4 << 30), limited_time(30):
        assert run(["evaluate", *line.split()]) == BAD_INPUT
    (error,) = capsys.readouterr().err.splitlines()
    assert "input" in error and "[Errno" not in error
