"""First commands of a new user: `make demo` with and without a display, and scenes that the window opens."""

import os
import shlex
import subprocess
from contextlib import closing
from dataclasses import replace

import av
import pytest

import ui.window
from app.main import run
from editor.files.open_document import settle
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.scene.built_in import built_in_names
from gsrain_engine.scene.formats.scene_files import write_scene
from repository import REPOSITORY
from small_scene import small_scene
from ui.window import begin_editor


@pytest.fixture
def opened(monkeypatch):
    """Record what windows would open: scene, preset, intensity, wet, follow_path."""
    calls = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(ui.window, "begin_editor", lambda *given, **options: calls.append((*given, *options.values())))
    monkeypatch.setattr(ui.window, "run_window", lambda begin, backend: begin())
    return calls


def demo_command(display, folder):
    """Arguments of the program that `make demo` runs, as its shell splits them."""
    recipe = (REPOSITORY / "Makefile").read_text().partition("\ndemo:")[2].partition("\n\n")[0]
    lines = [line.removeprefix("\t").removeprefix("@") for line in recipe.splitlines()[1:]]
    script = "\n".join(lines).replace("$$", "$").replace("$(OUT)", str(folder))
    script = script.replace("$(RUN)/gsrain", "print_arguments").replace("$(CURDIR)/", "")
    program = f'print_arguments() {{ printf "%s\\n" "$@" > {shlex.quote(str(folder / "arguments"))}; }}\n'
    environment = {"PATH": os.environ["PATH"]} | ({"DISPLAY": display} if display else {})
    subprocess.run(["sh", "-ec", program + script], check=True, env=environment, stdout=subprocess.DEVNULL)
    return (folder / "arguments").read_text().splitlines()


def test_make_demo_opens_the_window_where_there_is_a_display(opened, tmp_path):
    assert run(demo_command(":0", tmp_path)) == 0
    assert opened == [("street:dusk", load_preset("demo"), None, True, True)]


def test_make_demo_records_the_same_scene_without_a_display(tmp_path):
    windowed, command = demo_command(":0", tmp_path), demo_command("", tmp_path)
    assert (command[0], command[1]) == ("render", windowed[0])
    assert {"--preset", "demo", "--wet"} <= set(windowed) & set(command)
    # The same command with a small scene that has wet colors, and two frames
    scene = small_scene()
    layers = tuple(replace(each, wet_sh=0.8 * each.gaussians.sh) for each in scene.layers)
    write_scene(replace(scene, layers=layers), tmp_path / "small")
    smaller = {"--size": "96x64", "--fps": "4", "--duration": "0.5"}
    words = [str(tmp_path / "small") if word == command[1] else word for word in command]
    words = [smaller.get(before, word) for before, word in zip(["", *words[:-1]], words, strict=True)]
    assert run(words) == 0
    with av.open(str(tmp_path / "demo.mp4")) as video:
        assert sum(1 for _ in video.decode(video=0)) == 2


@pytest.mark.parametrize("scene", [*built_in_names(), "scene.ply", "scenes/render", "rendr"])
def test_a_word_that_is_a_scene_is_never_a_misspelled_command(scene, opened, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if scene not in built_in_names():
        write_scene(small_scene(), scene)
    orders = [["--no-wet", scene], [scene, "--no-wet"]]
    assert [run(words) for words in orders] == [0, 0]
    assert opened == [(scene, None, None, False, False)] * 2


@pytest.mark.parametrize(("word", "meant"), [("street:dask", "street:dusk"), ("stret", "street"), ("rendre", "render")])
def test_a_misspelled_word_names_what_was_meant(word, meant, opened, capsys):
    assert run([word]) == 2
    assert f"gsrain {meant}?" in capsys.readouterr().err and opened == []


def test_a_scene_that_is_also_a_command_opens_unless_a_place_follows(opened, tmp_path):
    assert run(["street"]) == run(["street", "--rain", "5"]) == 0
    assert opened == [("street", None, None, None, False), ("street", None, 5.0, None, False)]
    assert run(["street", str(tmp_path / "written"), "--moments", "0"]) == 0 and len(opened) == 2
    assert (tmp_path / "written" / "scene" / "scene.json").is_file()
    assert run(["street", "--rain", "500"]) == 2 and len(opened) == 2


@pytest.mark.parametrize(
    ("preset", "rate", "expected"),
    [
        (None, None, (7.0, 50.0, 2)),
        (None, 3.0, (3.0, 50.0, 0)),
        ("8.5", None, (8.5, None, 0)),
        ("8.5", 3.0, (3.0, None, 0)),
    ],
)
def test_the_rain_that_is_asked_for_takes_the_place_of_the_saved_one(preset, rate, expected, tmp_path):
    rain = {"intensity_mm_h": 7.0, "visibility_m": 50.0}
    weather = {"keys": [{"time_s": 0.0, "intensity_mm_h": 1.0}, {"time_s": 9.0, "intensity_mm_h": 2.0}]}
    write_scene(replace(small_scene(), rain=rain, weather=weather), tmp_path / "saved")
    with closing(begin_editor(str(tmp_path / "saved"), load_preset(preset) if preset else None, rate)) as editor:
        settle(editor)
        found = editor.document.rain, editor.document.keyframes
        assert (found[0].intensity_mm_h, found[0].visibility_m, len(found[1].keys)) == expected
