"""`gsrain doctor`: what works on this machine, and how to get the rest."""

import json
import sys
from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from types import SimpleNamespace

import numba
import pytest

from app import doctor
from app.main import run
from gsrain_engine.appearance.cyclegan_turbo import weight_paths
from gsrain_engine.appearance.cyclegan_turbo.model import sd_turbo
from gsrain_engine.evaluation.detection.detector import PLACE
from gsrain_engine.evaluation.fid_torch_features import INCEPTION_PLACE
from gsrain_engine.render.opengl import sort


def test_doctor_finds_what_it_needs(tmp_path, capsys):
    numbers = tmp_path / "doctor.json"
    assert run(["doctor", "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert "libx264" in found["video"]["what"]
    for package, module, extra in (
        ("torch", "torch", "jobs"),
        ("pyarrow", "pyarrow", "waymo"),
        ("protobuf", "google.protobuf", "waymo"),
    ):
        is_there = find_spec(module.partition(".")[0]) is not None and find_spec(module) is not None
        assert found[package]["found"] == is_there
        assert is_there or found[package]["what"].endswith(doctor.how_to_add(extra))


@pytest.mark.parametrize(
    ("mark", "line"),
    [
        (None, "'/a b/python' -m pip install 'gsrain[drive]'"),
        ("pipx_metadata.json", "pipx runpip gsrain install 'gsrain[drive]'"),
        ("uv-receipt.toml", "uv pip install --python '/a b/python' 'gsrain[drive]'"),
    ],
)
def test_doctor_adds_extras_to_the_environment_it_runs_in(mark, line, tmp_path, monkeypatch):
    """A bare `pip` is another environment's: it finds no gsrain, and on Debian it refuses to install anything."""
    environment = tmp_path / "gsrain"
    environment.mkdir()
    if mark is not None:
        (environment / mark).touch()
    monkeypatch.setattr(sys, "prefix", str(environment))
    monkeypatch.setattr(sys, "executable", "/a b/python")
    assert doctor.how_to_add("drive") == line


def test_doctor_names_libgomp_where_it_is_missing(tmp_path, monkeypatch, capsys):
    """Numba then takes its own workqueue, which aborts where two threads use kernels at once."""
    monkeypatch.setattr(numba, "threading_layer", lambda: "workqueue")
    monkeypatch.setattr(doctor, "find_depth_order", list)
    assert run(["doctor", "--json", str(tmp_path / "doctor.json")]) == 1
    kernels = json.loads((tmp_path / "doctor.json").read_text())["compiled kernels"]
    assert not kernels["found"]
    assert kernels["what"].startswith("libgomp is missing") and "apt-get install libgomp1" in kernels["what"]


def test_doctor_tests_the_order_of_splats(tmp_path, monkeypatch, capsys):
    """The one that OpenGL makes here; and a wrong one of a GPU, of which it sorts as many as scenes have."""
    assert run(["doctor", "--json", str(tmp_path / "right.json")]) == 0
    name = "order of splats by depth (OpenGL)"
    found = json.loads((tmp_path / "right.json").read_text())[name]
    assert found == {"found": True, "what": "right for 100,000 splats, twice the same"}

    def wrong(context, count):
        sorted_counts.append(count)
        return sort.SortCheck(count, missing=9_239, inversions=0, changed=12)

    sorted_counts = []
    monkeypatch.setattr("gsrain_engine.render.opengl.context.is_software", lambda context: False)
    monkeypatch.setattr(sort, "check_sort", wrong)
    capsys.readouterr()
    assert run(["doctor", "--json", str(tmp_path / "wrong.json")]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if name in line]
    assert line.startswith("WRONG")
    assert "of 1,000,000 splats 9,239 are lost, 0 out of order, and 12 elsewhere in a second try" in line
    assert sorted_counts == [1_000_000, 3_000_000]
    assert not json.loads((tmp_path / "wrong.json").read_text())[name]["found"]


def test_what_pip_can_not_add_needs_a_program_that_pip_installed(monkeypatch, capsys):
    """In the program that PyInstaller builds, to which pip can add nothing."""

    def none(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(doctor, "metadata", SimpleNamespace(version=none, PackageNotFoundError=PackageNotFoundError))
    monkeypatch.setattr(doctor, "installed_extensions", tuple)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    doctor.doctor()
    lines = [line for line in capsys.readouterr().out.splitlines() if "not installed; for " in line]
    assert len(lines) > 5
    assert all("needs GSRAIN installed by pip, with 'gsrain[" in line for line in lines)


# Files that a user brings: weights and models

FILES = {
    doctor.find_lpips: ("no weights of LPIPS (vgg)",),
    doctor.find_inception: ("pt_inception-2015-12-05",),
    doctor.find_detector_file: ("https://", "Apache-2.0", "detectors"),
    doctor.find_base_model: ("hf download stabilityai/sd-turbo", "sd-turbo"),
    doctor.find_transfer_weights: (weight_paths.PUBLISHED_URL, "transfer"),
    doctor.find_text_encoder: ("comes with SD-Turbo",),
}
"""Functions that look for them, and what they print of one that is missing: where to put it, where to get it."""


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A machine on which nothing lies yet."""
    folders = {"XDG_DATA_HOME": "data", "XDG_CACHE_HOME": "cache", "HF_HOME": "hub", "GSRAIN_LPIPS_WEIGHTS": "lpips"}
    for variable, folder in (folders | {INCEPTION_PLACE: "inception.npz"}).items():
        monkeypatch.setenv(variable, str(tmp_path / folder))
    for variable in (weight_paths.BASE_VARIABLE, weight_paths.WEIGHTS_VARIABLE, "HF_HUB_CACHE", PLACE):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


@pytest.mark.parametrize("find", FILES)
def test_what_is_missing_comes_with_how_to_get_it(find, home):
    finding = find()
    assert not finding.found and all(words in finding.what for words in FILES[find])


def test_weights_of_measures_are_read(home):
    pytest.importorskip("torch")
    from evaluation.random_lpips import random_weights
    from evaluation.random_networks import write_inception

    (home / "lpips").mkdir()
    random_weights("alex").write(home / "lpips" / "small.npz")
    assert not doctor.find_lpips().found and "only AlexNet" in doctor.find_lpips().what  # jobs take VGG16
    write_inception(home / "inception.npz")
    assert doctor.find_inception().found
    (home / "inception.npz").write_bytes(b"torn")
    assert "inception.npz" in doctor.find_inception().what and not doctor.find_inception().found


def test_a_detector_is_opened(home):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from evaluation.detection.tiny_onnx import NAMES, rows, write_constant

    (home / "data" / "gsrain" / "detectors").mkdir(parents=True)
    file = write_constant(home / "data" / "gsrain" / "detectors" / "seer.onnx", [rows()], (48, 64), NAMES)
    assert doctor.find_detector_file()[1:] == (True, f"{file} (sees 64 x 48 px)")
    file.write_bytes(b"nothing of the kind")
    assert not doctor.find_detector_file().found and "seer.onnx" in doctor.find_detector_file().what


def test_a_whole_base_of_the_right_architecture_is_found(home, monkeypatch):
    base = home / "sd-turbo"
    monkeypatch.setenv(weight_paths.BASE_VARIABLE, str(base))
    first, last = sd_turbo().betas
    schedule = {"beta_start": first, "beta_end": last, "beta_schedule": "scaled_linear", "prediction_type": "epsilon"}
    configs = {"unet/config.json": dict(sd_turbo().unet), "vae/config.json": sd_turbo().vae}
    for file, fields in (configs | {"scheduler/scheduler_config.json": schedule}).items():
        (base / file).parent.mkdir(parents=True)
        (base / file).write_text(json.dumps(fields))
    assert "unet: no weights" in doctor.find_base_model().what
    for part in ("unet", "vae"):
        (base / part / "diffusion_pytorch_model.safetensors").touch()
    assert doctor.find_base_model()[1:] == (True, str(base))
    for folder in ("tokenizer", "text_encoder"):
        (base / folder).mkdir()
    (base / "text_encoder" / "config.json").write_text("{}")
    assert doctor.find_text_encoder().what == str(base / "text_encoder")
    weight_paths.captions_file().parent.mkdir(parents=True)
    weight_paths.captions_file().touch()
    assert "captions are kept in" in doctor.find_text_encoder().what
    narrow = dict(sd_turbo().unet) | {"block_out_channels": [128, 640, 1280, 1280]}
    (base / "unet" / "config.json").write_text(json.dumps(narrow))
    assert not doctor.find_base_model().found and "block_out_channels" in doctor.find_base_model().what


def test_weights_are_named_with_their_size(home):
    file = weight_paths.data_folder() / "transfer" / "clear2rainy.pkl"
    file.parent.mkdir(parents=True)
    file.write_bytes(bytes(3_000_000))
    assert doctor.find_transfer_weights()[1:] == (True, f"{file} (3 MB)")
