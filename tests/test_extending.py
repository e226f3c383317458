"""The package of docs/extending.md is installed, and each of its extensions is used as the page describes."""

import json
import os
import re
import subprocess
import sys
import tomllib
from contextlib import closing
from io import BytesIO
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image

import gsrain as gr
from app.doctor import describe, installed_extensions
from app.main import BAD_INPUT, run
from app.schema import settings_type
from extension_package import installed, titled_blocks
from gsrain_engine.appearance.output_folder import read_transferred
from gsrain_engine.appearance.registry import usable_methods
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.datasets.open_source import names_scene
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.steps import steps_since
from gsrain_engine.fields import fields_of
from gsrain_engine.plugins import GROUPS
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.open import load_scene, scene_hash
from gsrain_engine.simulation.agents.base import Agent
from gsrain_engine.simulation.agents.registry import open_agent
from gsrain_engine.simulation.drive_exports import FinishedDrive, find_drive_export
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.scenario_io import load_scenario, scenario_suffixes
from gsrain_engine.simulation.serving.protocols import RainyScene, ServerOptions, find_protocol
from gsrain_engine.simulation.simulation import Simulation, run_drive
from gsrain_engine.simulation.traffic.appearance import vehicle_model
from repository import REPOSITORY
from small_scene import small_scene
from ui.commands.table import all_command_groups, all_commands

PAGE = REPOSITORY / "docs" / "extending.md"
BLOCKS = titled_blocks(PAGE)
ENTRIES = tomllib.loads(BLOCKS["pyproject.toml"])["project"]["entry-points"]


@pytest.fixture(scope="module")
def rain_lab(tmp_path_factory):
    """The page's package, installed."""
    modules = {name: text for name, text in BLOCKS.items() if name.startswith("rain_lab/")}
    site = tmp_path_factory.mktemp("site")
    with installed(site, "rain-lab", modules, ENTRIES):
        yield site


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(small_scene(), folder)
    return folder


def refused(capsys, *arguments):
    """Error of a command."""
    assert run([*map(str, arguments)]) == BAD_INPUT
    return capsys.readouterr().err


def test_every_kind_of_extension_has_its_example_and_its_row():
    assert set(ENTRIES) == {group.name for group in GROUPS}
    rows = re.findall(r"^\| \[.*$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"`(gsrain\.\w+)`", row)} == set(ENTRIES)
    named = {f"{each.partition(':')[0].replace('.', '/')}.py" for group in ENTRIES.values() for each in group.values()}
    assert named == {name for name in BLOCKS if name.startswith("rain_lab/")}


def test_scene_formats_are_read_and_written(rain_lab, scene, tmp_path, capsys):
    scan, flat = tmp_path / "scan.pts", tmp_path / "flat.ply"
    assert run(["convert", str(scene), str(scan)]) == run(["convert", str(scene), str(flat)]) == 0
    first, second = scan.read_text().splitlines()[:2]
    assert first == str(read_scene(scene).gaussian_count) and len(second.split()) == 7
    found, expected = (read_scene(file).layers[0].gaussians for file in (scan, flat))
    away = found.means - expected.means
    assert np.abs(away - away.round()).max() < 2e-3  # moved by whole meters, for float32
    assert np.abs(found.sh[:, 0] - expected.sh[:, 0]).max() < 0.02
    for name, words in (
        ("scan.pts", "expected 3 points"),
        ("empty.pts", "pts (rain_lab.laser_scan:FORMAT of rain-lab): line"),
        ("scan.lab", " .pts"),
    ):
        (tmp_path / name).write_text("nothing\n" if name == "empty.pts" else "3\n1 2 3 0 255 255 255\n")
        error = refused(capsys, "info", tmp_path / name)
        assert name in error and words in error


def test_transfers_are_methods(rain_lab, scene, tmp_path):
    options = ["--method", "mist", "--count", "1", "--width", "96"]
    assert run(["transfer", str(scene), "-o", str(tmp_path / "misty"), *options]) == 0
    (view,) = read_transferred(tmp_path / "misty")
    far = view.clear.depth > 20
    assert far.any() and view.image[far].std() < 0.9 * view.clear.image[far].std()
    assert usable_methods()[-1].title == "Mist"


def test_edits_are_commands_of_shell_python_and_window(rain_lab, scene, tmp_path, capsys):
    before = read_scene(scene)
    assert run(["edit", str(scene), "fade share=0.8", "-o", str(tmp_path / "faded")]) == run(["edit", "--list"]) == 0
    assert "fade [share=0.5]\n    Mix all colors with gray, as through thin fog." in capsys.readouterr().out
    made = read_scene(tmp_path / "faded"), gr.edit(before, "fade", share=0.8)
    for each in before.members:
        paler = 0.2 * np.sort(each.gaussians.sh.ravel())  # files are in drawing order
        assert all(np.allclose(np.sort(m.member(each.key).gaussians.sh.ravel()), paler, atol=1e-6) for m in made)
    assert "share" in refused(capsys, "edit", scene, "fade share=2", "-o", tmp_path / "no")
    (command,) = [each for each in all_commands() if each.edit == "fade"]
    assert (command.name, command.menu) == ("Fade colors", "Scene") and command in all_command_groups()[-1]
    with closing(Editor(before)) as editor:
        command.perform(editor)
        editor.jobs.all[-1].wait(60)
        history = editor.document.history
        assert history.labels[1:] == ["Fade colors"] and command.can_run(editor)
        assert [each.text for each in steps_since(history, history.steps[0].document)] == ["fade"]
        half = editor.document.scene.layers[0].gaussians.sh
        editor.document.undo()
        assert np.allclose(half, 0.5 * before.layers[0].gaussians.sh) and editor.document.scene is before


def test_agents_drive(rain_lab, scene):
    scenario = Scenario(name="empty road", scene=str(scene), speed_m_s=8.0, duration_s=2.0)
    agent = open_agent("gentle")
    rollout = run_drive(Simulation(scenario, read_scene(scene)), agent)
    assert isinstance(agent, Agent) and len(rollout.steps) > 4
    speeds = [step.ego.speed_m_s for step in rollout.steps]
    assert 8.0 == speeds[0] > speeds[-1] > 5.0  # it slows down to 6 m/s


def test_decoders_read_the_output_of_detectors(rain_lab, tmp_path):
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from evaluation.detection.tiny_onnx import write_constant
    from gsrain_engine.evaluation.detection.detector import open_detector

    def detected(name, description, *outputs):
        model = write_constant(tmp_path / name, outputs, (64, 96))
        (tmp_path / description).write_text(BLOCKS[description])
        (found,) = open_detector(model, tmp_path / description).detect(np.zeros((64, 96, 3), np.uint8))
        return found.class_name, found.confidence, found.box_xyxy

    logits = np.full((1, 5, 4), -9.0)
    logits[0, :, 3] = 3.0  # nothing
    logits[0, 2] = [0.0, 6.0, 0.0, 0.0]  # a truck
    boxes = np.tile([0.5, 0.25, 0.5, 0.25], (1, 5, 1))
    found = detected("detr.onnx", "my_detr.yaml", logits, boxes)
    assert found == ("truck", pytest.approx(0.9926, abs=1e-3), pytest.approx((24, 8, 72, 24), abs=1e-3))
    with pytest.raises(ValueError, match=r"wrong.onnx: expected logits \(1, queries, 4\)"):
        detected("wrong.onnx", "my_detr.yaml", logits)
    table = np.zeros((1, 7, 84))
    table[0, :, 40] = [48, 32, 40, 20, 0.1, 0.2, 0.9]
    found = detected("yolo.onnx", "my_yolo.yaml", table)
    assert found == ("pedestrian", pytest.approx(0.9), pytest.approx((28, 22, 68, 42)))


def test_rain_laws_are_calibrations(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS["thunderstorm.py"], "thunderstorm.py", "exec"), {})
    drops = float(capsys.readouterr().out.split()[0])
    scale_mm = 8.5**0.21 / 3.0
    assert 0.4 < drops / (1400 * scale_mm) < 1.3  # those of 0.1 to 8 mm, and as many as make 8.5 mm/h
    assert (tmp_path / "thunderstorm.yaml").is_file()


def test_disdrometer_logs_are_read(rain_lab, tmp_path, capsys):
    log = tmp_path / "our_log.csv"
    counts = [120, 90, 60, 40, 30, 10, 4, 1, 0]
    log.write_text(f"our drop counter\n2024-05-01T10:00,3.1,{','.join(map(str, counts))}\n")
    middles = np.array([0.3, 0.5, 0.7, 0.9, 1.25, 1.75, 2.5, 3.5, 5.0])
    expected = np.dot(counts, np.pi / 6 * middles**3) / 5000 * 60  # mm3 on 5000 mm2, in an hour of such minutes
    assert read_disdrometer(log).spectra.rate_mm_h == pytest.approx([expected])
    log.write_text("our drop counter\n2024-05-01T10:00,3.1,1\n")
    error = refused(capsys, "calibrate", log, "-o", tmp_path / "cal.yaml")
    assert "our_log.csv: line 2: expected 11 fields, found 3" in error


def test_captures_are_read(rain_lab, tmp_path, capsys):
    for name, gray in (("one.png", 40), ("two.png", 90)):
        Image.new("RGB", (48, 32), (gray, gray, gray)).save(tmp_path / name)
    (tmp_path / "poses.csv").write_text("one.png,0,0,0,1.5,90\ntwo.png,0.5,0,5,1.5,90\n")
    assert capture_format(tmp_path).name == "dash camera"  # not a folder of images
    capture = open_capture(tmp_path)
    assert [int(view.image.mean()) for view in capture] == [40, 90]
    assert capture.views[1].camera.camera_to_world[:3, 2] == pytest.approx([0, 1, 0], abs=1e-9)
    (tmp_path / "two.png").unlink()
    assert "poses.csv: names two.png, which is not there" in refused(capsys, "info", tmp_path)


def test_evaluations_are_listed_without_running_them(rain_lab, capsys):
    assert run(["evaluate", "--help"]) == 0
    assert "contrast" in capsys.readouterr().out and "rain_lab.contrast" not in sys.modules


def test_evaluations_are_commands(rain_lab, scene, tmp_path, capsys):
    assert run(["evaluate", "--help"]) == run(["evaluate", "contrast", "--help"]) == 0
    printed = capsys.readouterr().out
    words = " ".join(printed.replace("│", " ").split())
    assert re.search(r"contrast Fit a line through .* Of the package rain-lab 0\.1\.0\.", words)
    assert words.count("Fit a line through the pixels") == 2 and "Views" in printed and "--json" in printed
    numbers, options = tmp_path / "slopes.json", ("--wind-speed", "8", "--set", "roughness_m=0.1")
    command = ["evaluate", "contrast", str(scene), "--intensity", "8.5", "--intensity", "50", "--width", "96", *options]
    assert run([*command, "--json", str(numbers)]) == 0
    shares = {line.split()[0]: float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()}
    assert list(shares) == ["8.5", "50.0"] and shares["50.0"] < shares["8.5"] < 1
    assert json.loads(numbers.read_text())["slopes"]["50"] == pytest.approx(shares["50.0"], abs=1e-3)
    refused(capsys, "evaluate", "contrast", "--wetness", "1")
    assert "did you mean contrast?" in refused(capsys, "evaluate", "contrasts")


def test_settings_have_schemas(rain_lab, tmp_path):
    kind = settings_type("site")
    assert [each.name for each in fields_of(kind)] == ["gauge_height_m", "mast_height_m"]
    path = os.pathsep.join([str(rain_lab), str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "app", "schema", "site"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path})
    assert json.loads(printed.stdout)["$defs"]["Site"]["properties"]["mast_height_m"]["x-unit"] == "m"
    (tmp_path / "mine.yaml").write_text("mast_height_m: 200")
    with pytest.raises(ValueError, match="mast_height_m"):
        sys.modules[kind.__module__].load_site(str(tmp_path / "mine.yaml"))


def test_drives_are_exported(rain_lab, scene, tmp_path, capsys):
    scenario = Scenario(name="empty road", scene=str(scene), speed_m_s=8.0, duration_s=1.0)
    rollout = run_drive(Simulation(scenario, read_scene(scene)), open_agent("constant-velocity"))
    export = find_drive_export("track", "--export track")
    export.write(FinishedDrive(export, rollout, read_scene(scene)), tmp_path / "a.geojson")
    track = json.loads((tmp_path / "a.geojson").read_text())
    assert np.diff(track["geometry"]["coordinates"], axis=0)[:, 0] == pytest.approx([2.0] * 4, abs=1e-3)
    assert track["properties"] == {"agent": "constant-velocity", "times_s": [0.0, 0.25, 0.5, 0.75, 1.0]}
    error = refused(capsys, "drive", "--export", "trick", "-o", tmp_path / "out")
    assert error.startswith("gsrain: --export trick: there is only parquet, ") and "track" in error


def test_scenarios_are_read(rain_lab, tmp_path):
    file = tmp_path / "late_braking.ini"
    file.write_text(BLOCKS["late_braking.ini"])
    scenario = load_scenario(file)
    assert (scenario.name, scenario.speed_m_s, scenario.rain.intensity_mm_h) == ("late_braking", 12.0, 8.5)
    assert scenario.road_users[0].ahead_m == 30.0 and ".ini" in scenario_suffixes()
    file.write_text("[test]\nspeed_m_s = fast\n")
    with pytest.raises(ValueError, match=r"late_braking\.ini: expected speed_m_s, .*fast"):
        load_scenario(file)


def test_functions_are_commands(rain_lab, scene, capsys):
    assert run(["--help"]) == run(["count", "--help"]) == 0
    printed = capsys.readouterr().out
    words = " ".join(printed.replace("│", " ").split())
    assert re.search(r"count Count the Gaussians of a scene whose .* Of the package rain-lab 0\.1\.0\.", words)
    assert "--below-mm" in printed
    assert run(["count", str(scene), "--below-mm", "1e6"]) == 0
    every = read_scene(scene).gaussian_count
    assert capsys.readouterr().out == f"{every:,} of {every:,}\n"
    assert "did you mean gsrain count?" in refused(capsys, "cuont")


def test_scenes_are_opened_by_name(rain_lab, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert load_scene("plaza").gaussian_count == 6400 and names_scene("plaza")
    assert len(list((tmp_path / "gsrain").glob("plaza-*"))) == 1
    assert scene_hash("plaza") != scene_hash("street")
    assert run(["render", "plaza", "-o", str(tmp_path / "plaza.png"), "--rain", "8.5", "--size", "64x48"]) == 0
    assert "no such scene; did you mean gsrain plaza?" in refused(capsys, "plazza")


def test_models_are_road_users(rain_lab):
    cones = [vehicle_model(name, small_scene()) for name in ("cone", "cone/red")]
    assert [each.size_lwh_m for each in cones] == [(0.4, 0.4, 0.75)] * 2
    assert not np.array_equal(*(each.gaussians.sh for each in cones))
    for model, words in (("cone/blue", "no paint is called 'blue', only red"), ("cones", "none of cone")):
        with pytest.raises(ValueError, match=words):
            vehicle_model(model, small_scene())


def test_protocols_serve_scenes(rain_lab, scene, tmp_path, capsys):
    refused(capsys, "serve", scene, "--protocol", "snapshots", "--host", "0.0.0.0", "--token", "a-token")
    protocol = find_protocol("snapshots")
    rainy = RainyScene("town", read_scene(scene), RainSimulation.start(RainSettings(intensity_mm_h=8.5)))
    running = protocol.start([rainy], ServerOptions(backend="cpu"))
    with urlopen(f"http://127.0.0.1:{running.numbers['port']}/town.png", timeout=60) as answer:
        picture = Image.open(BytesIO(answer.read()))
    assert picture.size == (480, 320) and np.asarray(picture).std() > 1
    assert str(running.numbers["port"]) in running.greeting
    assert running.stop() == "1 pictures were there"
    assert "there is " in refused(capsys, "serve", scene, "--protocol", "snapshot")


def test_doctor_lists_all_of_them(rain_lab):
    found = {each.name: describe(each) for each in installed_extensions() if each.package == "rain-lab"}
    places = {name: place for group in ENTRIES.values() for name, place in group.items()}
    assert found == {name: f"{place} of rain-lab 0.1.0" for name, place in places.items()}
