"""Endless input in place of every file that a command reads: an error soon, and without much memory."""

import json
import os
import sys
import threading

import pytest
from PIL import Image

import gsrain_engine.safe_io.limits as limits
from app.main import run
from fuzz.reader import limited_memory, limited_time
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.open import random_scene
from small_scene import small_scene

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pipes and devices stand elsewhere under other names")

SETTINGS = (
    "render {scene} -o {out} --backend cpu --camera {}",
    "render {scene} -o {out} --backend cpu --camera-path {}",
    "render {scene} -o {out} --backend cpu --rain 8 --preset {}",
    "render {scene} -o {out} --backend cpu --rain 8 --calibration {}",
    "disdrometer --calibration {}",
    "reconstruct {scene} -o {out} --config {}",
    "sweep {}.yaml -o {out}",
    "drive {} -o {out}",
    "train-transfer {} -o {out}",
    "evaluate transfers {}.yaml -o {out}",
    "evaluate lidar {scene} -o {out} --sensor {}",
)
"""Commands that take settings from a file, or from a pipe that ends."""
FILES = (
    "info {}",
    "info {}.ply",
    "info {}.spz",
    "info {}.json",
    "convert {}.splat {out}.ply",
    "convert {}.ksplat {out}.ply",
    "convert {}.sog {out}.ply",
    "calibrate {} -o {out}.yaml",
    "reconstruct {} -o {out}",
    "drive cut-in --agent {}.py -o {out}",
    "drive cut-in --scene {}.ply -o {out}",
    "evaluate images {}.png {}.png",
    "evaluate lpips-weights {}.npz -o {out}.npz",
    "evaluate lpips-weights {}.ckpt -o {out}.npz",
)
"""Commands that take only files."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.ply"
    write_scene(random_scene("random-20k"), path)
    return path


def refusal(command, make, scene, folder, capsys):
    """Run a command whose file is something else; returns its error."""
    words = command.split()
    for word in {each for each in words if "{}" in each}:
        make(folder / word.format("input"))
    named = [
        word.replace("{}", str(folder / "input")).replace("{scene}", str(scene)).replace("{out}", str(folder / "out"))
        for word in words
    ]
    with limited_memory(4 << 30), limited_time(30):
        code = run(named)
    error = capsys.readouterr().err.strip()
    assert code == 2 and error.startswith("gsrain: ") and "\n" not in error, error
    assert "[Errno" not in error
    assert not list(folder.glob("out*"))
    return error


@pytest.mark.parametrize("command", [*SETTINGS, *FILES])
def test_devices_are_refused(command, scene, tmp_path, capsys):
    error = refusal(command, lambda path: path.symlink_to("/dev/zero"), scene, tmp_path, capsys)
    assert "input" in error
    assert command in FILES or error.endswith("not a file but a device")


@pytest.mark.parametrize("command", [*SETTINGS, *FILES[:2], *FILES[7:9]])
def test_pipes_without_a_writer_are_refused(command, scene, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(limits, "PIPE_WAIT_S", 0.1)
    error = refusal(command, os.mkfifo, scene, tmp_path, capsys)
    assert "input" in error
    assert command in FILES or error.endswith("a pipe that has not ended within 0.1 s")


@pytest.mark.parametrize("command", ["render {scene} -o {out}.png --json {}", "convert {scene} {}.ply"])
def test_pipes_that_nobody_reads_are_refused(command, scene, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(limits, "PIPE_WAIT_S", 0.1)
    words = [*command.split(), "--backend", "cpu", "--size", "48x32"] if "render" in command else command.split()
    pipe = tmp_path / ("input.ply" if "{}.ply" in command else "input")
    os.mkfifo(pipe)
    line = [each.format(tmp_path / "input", scene=scene, out=tmp_path / "out") for each in words]
    with limited_time(30):
        assert run(line) == 2
    error = capsys.readouterr().err.splitlines()[-1]  # after the progress bar
    assert str(pipe) in error and "nobody reads within 0.1 s" in error
    assert pipe.is_fifo()


@pytest.mark.parametrize("command", [SETTINGS[0], SETTINGS[2], SETTINGS[7]])
def test_endless_pipes_take_little_memory(command, scene, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gsrain_engine.safe_io.files._MAX_BYTES", 1 << 24)

    def endless(path):
        os.mkfifo(path)

        def write():
            with pytest.raises(BrokenPipeError), path.open("wb", buffering=0) as pipe:
                while True:
                    pipe.write(bytes(1 << 16))

        threading.Thread(target=write, daemon=True).start()

    assert "larger than 17 MB" in refusal(command, endless, scene, tmp_path, capsys)


def test_cameras_are_read_from_pipes(scene, tmp_path):
    """As a shell hands them over: `--camera <(command)`."""
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]
    camera = {"width": 48, "height": 32, "fx": 40, "fy": 40, "cx": 24, "cy": 16, "world_to_camera": pose}
    reader, writer = os.pipe()
    os.write(writer, json.dumps(camera).encode())
    os.close(writer)
    out = tmp_path / "a.png"
    assert run(["render", str(scene), "--backend", "cpu", "-o", str(out), "--camera", f"/dev/fd/{reader}"]) == 0
    os.close(reader)
    with Image.open(out) as picture:
        assert picture.size == (48, 32)


def test_pipes_in_place_of_temporary_files_do_not_block(tmp_path):
    os.mkfifo(tmp_path / ".a.ply.0123abcd.part")
    with limited_time(10):
        write_scene(small_scene(), tmp_path / "a.ply")
    assert read_scene(tmp_path / "a.ply").members
