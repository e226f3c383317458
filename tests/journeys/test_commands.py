"""Commands of README and the guide, as printed and in order, by an installed program, with the files that they assume.

Options that the pages describe make them small. Each leaves what its text promises.
"""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsrain_engine import plugins
from gsrain_engine.render.video import read_video
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.geometry import quaternions_from_matrices
from parsivel_text import rain, station_line
from repository import REPOSITORY
from small_scene import AHEAD, small_scene

STILL = "--size 96x64 --backend cpu"
CLIP = f"{STILL} --duration 0.2 --fps 10"
EDITS = "'rename key=layers/garden name=\"wet garden\"' 'change-rain intensity_mm_h=8.5'"
SMALL = {
    "README.md": {
        "gsrain render garden.ply --rain 8.5 --wet -o garden.png": STILL,
        "gsrain render --rain 12 --wet -o street.mp4": CLIP,
        "gsrain render project -o clip.mp4 --clear-pair sunny --passes color,labels": CLIP,
        "gsrain render --preset paper -o paper.png --json paper.json": STILL,
        "gsrain render scene.spz --camera -8,0,1.5,0,0,1 --rain 4 --depth -o view.npy": STILL,
        "gsrain convert scene.sog scene.ply": "",
        "gsrain convert garden.spz garden --up -y --meters-per-unit 0.5": "",
        "gsrain drive --rain 0,1.2,8.5,12": "--agent oracle-idm --duration 1 --no-video --backend cpu",
        "gsrain disdrometer --rain 8.5 --area 0.5 --seconds 60": "",
        "gsrain info parsivel.log": "",
    },
    "docs/guide/without_a_window.md": {
        "gsrain render --rain 8.5 --set roughness_m=0.03 --set velocity=atlas -o meadow.png": STILL,
        "gsrain drive --set speed_m_s=15 --set step_s=0.1": "--agent oracle-idm --duration 1 --no-video -o drive-fast",
        "gsrain export-rain SCENE --rain 8.5 --time 2 -o rain.ply": "--size 96x64",
        f"gsrain edit garden.ply -o edited {EDITS}": "",
    },
    "docs/guide/wet_colors.md": {
        "gsrain night drive -o drive_night": "",
        "gsrain render drive_night --rain 8.5 -o night.mp4": CLIP,
        "gsrain transfer scene -o rainy --contact-sheet sheet.png": "--count 6 --width 96",
        "gsrain recolor scene --images rainy -o wet_scene": "",
        "gsrain render wet_scene --rain 8.5 -o rain.mp4": CLIP,
    },
}  # fmt: skip
"""Commands by page, and the options that make each take seconds."""
NOT_HERE = (
    "gsrain info nuscenes", "gsrain reconstruct nuscenes", "gsrain export-rain NUSCENES",  # a data set
    "gsrain transfer scene -o rainy &&",  # as in the guide
    "gsrain calibrate parsivel.log",  # days of measurements
    "gsrain night garden.ply",  # a file of lamps
    "gsrain edit garden.ply \"sky", "gsrain publish", "gsrain serve",  # tests of their own
)  # fmt: skip
if plugins.find_extension(plugins.COMMANDS, "night") is None:  # its folder was deleted
    NOT_HERE += "gsrain night", "gsrain render drive_night"
    for commands in SMALL.values():
        for each in [command for command in commands if command.startswith(NOT_HERE)]:
            del commands[each]
STEPS = [(page, command) for page, commands in SMALL.items() for command in commands]


def printed(page: str) -> list[str]:
    """Return the commands of a page, as indented lines print them, without their comments."""
    lines = re.findall(r"^    (gsrain .*)$", (REPOSITORY / page).read_text("utf-8"), re.MULTILINE)
    return [re.sub(r"\s+#.*", "", line) for line in lines]


@pytest.mark.parametrize("page", SMALL)
def test_each_printed_command_is_a_step_or_needs_what_is_not_here(page):
    assert [each for each in printed(page) if not each.startswith(NOT_HERE)] == list(SMALL[page])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with the files that the pages assume."""
    folder = tmp_path_factory.mktemp("journeys")
    scene = small_scene()
    for name in ("garden.ply", "garden.spz", "scene.spz", "scene.sog", "scene", "SCENE", "drive"):
        write_scene(scene, folder / name)
    facing = np.tile(quaternions_from_matrices(AHEAD), (2, 1))
    flight = CameraPath(np.array([0.0, 1.0]), np.array([[0.0, 0, 2], [6, 0, 2]]), facing, np.full(2, 50.0))
    write_scene(replace(scene, path=flight), folder / "project")
    (folder / "parsivel.log").write_text("\n".join(station_line(second, rain()) for second in range(10, 50)) + "\n")
    return folder


RUN = """
import json, shlex, sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
import app
from app.main import run

results = []
for command in json.load(sys.stdin):
    said = StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = run(shlex.split(command)[1:])
    results.append((code, said.getvalue()))
json.dump({"program": app.__file__, "results": results}, sys.stdout)
"""


@pytest.fixture(scope="module")
def results(installed, place):
    """Exit code and words of each step, in one process of the installed program."""
    site, environment = installed
    commands = [f"{command} {SMALL[page][command]}" for page, command in STEPS]
    ended = subprocess.run(
        [sys.executable, "-P", "-c", RUN], input=json.dumps(commands), cwd=place, env=environment, text=True,
        stdout=subprocess.PIPE, check=True,
    )  # fmt: skip
    found = json.loads(ended.stdout)
    assert Path(found["program"]).is_relative_to(site)
    return dict(zip(STEPS, found["results"], strict=True))


@pytest.mark.parametrize(("page", "command"), STEPS)
def test_a_step_ends_well_and_leaves_what_it_names(page, command, results, place):
    code, said = results[page, command]
    assert code == 0, said
    for name in re.findall(r"(?:-o|--json|--contact-sheet) (\S+)", f"{command} {SMALL[page][command]}"):
        check(place / name)


def check(path: Path) -> None:
    """Open what a command has written."""
    if path.suffix == ".png":
        assert np.asarray(Image.open(path)).std() > 1
    elif path.suffix == ".mp4":
        assert len(list(read_video(path))) == 2
    elif path.suffix == ".json":
        assert json.loads(path.read_text("utf-8"))
    elif path.suffix == ".npy":
        assert np.load(path).ndim == 3
    elif path.suffix == ".ply" or (path / "scene.json").is_file():
        assert read_scene(path).gaussian_count > 0
    else:
        assert any(path.iterdir())


def test_the_words_beside_the_commands_hold(results, place):
    """Pairs and passes, a scale that is stored, a driver in four rains, drops of a log, an edited name."""
    assert {each.name for each in place.glob("clip*.mp4")} >= {"clip.mp4", "clip.clear.mp4"}
    assert read_scene(place / "garden").metres_per_unit == 0.5
    assert "implied_mm_h" in json.loads((place / "paper.json").read_text("utf-8"))
    said = results["README.md", "gsrain drive --rain 0,1.2,8.5,12"][1]
    assert all(f"\n{rate}" in said or f" {rate} " in said for rate in ("0", "1.2", "8.5", "12"))
    assert "drops" in results["README.md", "gsrain info parsivel.log"][1]
    edited = read_scene(place / "edited")
    assert edited.layers[0].name == "wet garden" and edited.rain["intensity_mm_h"] == 8.5
    assert read_scene(place / "wet_scene").has_wet_colors
