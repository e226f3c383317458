"""Bad input to every command: one line that names option, file or field, exit code 2, nothing written."""

import json
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from app.main import BAD_INPUT, run
from boxy_scene import boxy_scene
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.simulation.serving.protocols import protocol_names
from measured_rain import measured_rain
from small_scene import small_scene
from sweep.small_sweep import write_road, write_scenario
from tests.training.drive_capture import drive_capture
from tests.training.small_street import small_street

from .picture_sets import write_pictures

TABLE = """
nowhere.ply                                          | nowhere.ply: there is no such file or folder
rendre room.ply                                      | did you mean gsrain render?
render room.ply                                      | --output
render nowhere.ply -o a.png                          | nowhere.ply
render room.ply -o a.png --rain 150                  | --rain: 150 must be at most 149 mm/h
render room.ply -o a.png --size 960                  | --size 960: expected WIDTHxHEIGHT
render room.ply -o a.png --preset drizzle            | preset drizzle
render room.ply -o a.png --exposure 2                | --exposure: 2 must be at most 1 s
drive --calibration mine.yaml                        | calibration mine.yaml: no such file
evaluate lidar -o out --calibration mine.yaml        | calibration mine.yaml: no such file
render room.ply -o a.png --time nan                  | --time: Expected a finite number
render room.ply -o a.png --seed 1.5                  | --seed 1.5: expected a whole number
render room.ply -o a.png --color red                 | --color
render room.ply -o a.png --meters-per-unit 0         | --meters-per-unit
render room.ply -o a.png --labels coco               | --labels coco
render room.ply -o a.png --camera camera.json --camera-path p | --camera and --camera-path
render room.ply -o a.png --camera camera.json --frame 3 | --frame 3
render room.ply -o a.png --frame 5                   | --frame 5
render room.ply -o a.png --frame 0                   | --frame 0
render room.ply -o a.png --duration 2                | --duration
render room.ply -o a.png --to 2                      | --to
render room.ply -o a.png --fps 10                    | --fps
render room.ply -o a.png --quality 50                | --quality
render room.ply -o a.png --mode depth --rain 5       | --rain
render room.ply -o a.png --mode depth --preset 8.5   | --preset
render scene -o a.png --cameras one --camera camera.json | --camera
render scene -o a.png --cameras one --camera-path p  | --camera-path
render room.ply -o a.png --sheet 0,5 --rain 8.5      | --rain
render room.ply -o a.png --sheet 0,5 --mode depth    | --mode
render room.ply -o a.png --sheet 0,5 --clear-pair sunny | --clear-pair
render room.ply -o a.png --sheet 0,5 --passes depth  | --passes
render room.ply -o a.jpg --sheet 0,5 --quality 50    | --quality
render room.ply -o a.mp4 --sheet 0,5                 | a.mp4
render scene -o a.png --cameras one --speed 3        | --speed 3
render scene -o a.png --frame 161                    | --frame 161
render scene -o a.mp4 --duration 0                   | --duration 0
render scene -o a.mp4 --from 2 --to 1                | --to must be above --time
render scene -o a.mp4 --to 2 --duration 1            | --duration and --to
render scene -o a.mp4 --codec vp9                    | .webm
publish room.ply -o page.png                         | --output page.png
publish room.ply -o page.html --duration 601         | --duration 601
publish room.ply -o page.html --speed 3              | --speed 3
publish room.ply -o page.html --rain 5 --haze gaussians | haze gaussians
info room.ply extra                                  | extra
info room.ply --check                                | --check and --overlay
convert room.ply a.ply --wetness 0.5                 | --wetness 0.5
convert room.ply a --speed 6                         | --speed 6
street out --rig mine                                | --rig mine
calibrate light.nc -o a.json                         | a.json
calibrate light.nc -o a.yaml --intensities 1,x       | --intensities
calibrate light.nc -o a.yaml --plot plot.txt         | plot.txt
disdrometer --seconds 0                              | --seconds 0
disdrometer --record 0.001                           | --record 0.001
disdrometer -o rain.csv                              | --output rain.csv
reconstruct drive -o out --resume                    | resume
reconstruct drive -o out --images nowhere            | --images nowhere
reconstruct drive -o holds                           | holds
transfer town -o out --method dry                    | 'dry'
transfer town -o out --method images                 | --images
transfer town -o out --method cyclegan-turbo         | needs torch
transfer town -o out --method cyclegan-turbo --weights no.pkl | --weights no.pkl
transfer town -o out --wetness 0.5 --rain 3          | --rain and --wetness
transfer town -o out --no-normals --normals dsine    | --no-normals
transfer town -o out --views recorded                | --views recorded
transfer drive -o out --views rig                    | --views rig
transfer drive -o out --capture drive                | --capture
transfer town -o holds                               | holds
transfer town -o out --contact-sheet s.doc           | --contact-sheet s.doc
recolor town --images drive -o out --held-out 1      | held out
recolor town --images drive -o out --photometric-steps 5        | --photometric-steps needs torch
recolor town --images drive -o out --refine          | --refine needs torch
sweep sweep.yaml --workers 2 --dask tcp://127.0.0.1:1 | --workers and --dask
sweep sweep.yaml --dask-resources GPU=1              | --dask ADDRESS
sweep sweep.yaml --dask a:1 --dask-resources GPU     | --dask-resources GPU
sweep sweep.yaml --summarize-only                    | no rows
sweep folderless.yaml                                | --output DIR
sweep sweep.yaml --attribute=rain                    | --attribute rain: expected all
sweep sweep.yaml --attribute=mirror                  | --attribute mirror
sweep dataset -o out --attribute all                 | --attribute: sweep dataset makes clips
drive --agent nobody                                 | --agent nobody
drive --rain "a lot"                                 | --rain a lot
drive --export csv                                   | --export csv
drive --agent hugsim                                 | --hugsim-dir DIR
drive --hugsim-dir x --agent http                    | --hugsim-dir
drive short.yaml --rain 1,1.00000001 --no-video      | two outputs
drive short.yaml --agent oracle-idm --agent oracle-idm.py | oracle-idm.py
bench render --backends vulkan                       | --backends vulkan
bench render --sizes 48x32,7                         | --sizes 7
bench render --rain 1,,2                             | --rain '1,,2'
bench render --rain much                             | --rain much
bench loading --formats .sog                         | --formats .sog
evaluate consistency                                 | DIR
evaluate consistency pictures                        | pictures
evaluate fid pictures pictures --extractor eyes      | --extractor eyes
evaluate fid pictures pictures --extractor pixels16,inception --weights a.pth | --weights
evaluate images pictures other                       | no picture of the one
evaluate images pictures pictures --masks empty      | --masks empty
evaluate lpips-weights none.pth -o a.onnx            | a.onnx
evaluate lidar scene -o out --sensor 99              | --sensor 99
evaluate lidar scene -o out --sensor sensor.yaml     | $.divergence_mrad
evaluate detection boxy --detector x --from 2 --to 1 | --from 2 --to 1
evaluate detection boxy --detector x --description a --description b | --description
evaluate detection boxy --detector x --video v.avi   | --video v.avi
evaluate detection pictures --detector x --wet       | x
evaluate detection boxy --detector x --attribute=rain | --attribute rain: expected all
evaluate detection boxy --detector x --attribute streaks,mirror | --attribute mirror
evaluate detection boxy --detector x --diameter-scale 1,9 | --diameter-scale
evaluate detection boxy --detector x --diameter-scale much | --diameter-scale
serve nothing | nothing
serve --host 0.0.0.0 | --token
serve --port 70000 | --port
serve --sessions 0 | --sessions
serve --protocol carla | --protocol
serve --protocol browser --host 0.0.0.0 | ssh -L 8080:localhost:8080
serve --protocol browser --token pässword | --token
serve --token pässword | --token
serve street street --protocol browser | one scene
"""
"""Command line, and a part of the error: an option, a file or a field, seldom more."""

ROWS = [tuple(part.strip() for part in line.split(" | ")) for line in TABLE.splitlines()[1:]]
SENSOR = {"name": "rings", "elevations_deg": [-8, 0], "divergence_mrad": 100}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with all that the commands name, and is there."""
    place = tmp_path_factory.mktemp("place")
    write_scene(small_scene(), place / "room.ply")
    write_scene(small_scene(), place / "scene")
    write_scene(boxy_scene(), place / "boxy")
    write_scene(small_street(), place / "town")
    list(write_views(place / "drive", drive_capture(2)))
    for name in ("pictures", "other"):
        write_pictures(place / name, 4, 0)
    for file in sorted((place / "other").iterdir()):
        file.rename(file.with_name(f"x{file.name}"))
    for name in ("empty", "holds"):
        (place / name).mkdir()
    (place / "holds" / "mine.txt").write_text("x")
    write_spectra(place / "light.nc", measured_rain(271.0, 9.705, 0.074, minutes=20, seed=3))
    (place / "camera.json").write_text(json.dumps(Camera.from_fov(64, 48, 50.0, np.eye(4)).to_json()))
    write_scenario(place / "short.yaml", write_road(place / "road"))
    sweep = {"kind": "drive", "scenarios": ["short.yaml"], "agents": ["oracle-idm"], "seeds": 1}
    (place / "folderless.yaml").write_text(yaml.safe_dump(sweep))
    (place / "sweep.yaml").write_text(yaml.safe_dump(sweep | {"output": "out"}))
    (place / "sensor.yaml").write_text(yaml.safe_dump(SENSOR))
    return place


DELETED = {"alpasim", "browser", "carla-canvas"}.difference(protocol_names())


@pytest.mark.parametrize(("line", "words"), ROWS, ids=[line for line, _ in ROWS])
def test_bad_input_is_one_line_that_names_it(line, words, place, monkeypatch, capsys):
    if line.startswith(("reconstruct", "evaluate fid", "evaluate transfers")):
        pytest.importorskip("torch")
    if line.startswith("evaluate detection"):
        pytest.importorskip("onnxruntime")
        pytest.importorskip("pycocotools")
    named = re.search(r"--protocol (\S+)", line)
    if line.startswith("serve") and (named[1] if named else "alpasim") in DELETED:
        pytest.skip("its folder was deleted")
    if "needs torch" in words:
        monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.chdir(place)
    before = sorted(place.rglob("*"))
    assert run(shlex.split(line)) == BAD_INPUT
    lines = capsys.readouterr().err.strip().splitlines()
    first = next(number for number, text in enumerate(lines) if text.startswith("gsrain: "))
    assert words in "\n".join(lines[first:])
    assert first == len(lines) - 1 or "inputs are missing" in lines[first]
    assert sorted(place.rglob("*")) == before
