"""`gsrain doctor`: what works on this machine, and how to get the rest."""

import sys
from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

from app import doctor
from app.main import run
from gsrain_engine import optional_packages
from gsrain_engine.appearance.cyclegan_turbo import weight_paths
from gsrain_engine.appearance.dsine_checkout import CHECKOUT_PLACE, WEIGHTS_PLACE
from gsrain_engine.appearance.finetune.settings import PLACE as CLIP_PLACE
from gsrain_engine.evaluation.detection.detector import PLACE
from gsrain_engine.evaluation.fid_torch_features import INCEPTION_PLACE
from gsrain_engine.render import gsplat_build
from gsrain_engine.render.opengl import context, sort

SORTED = "order of splats by depth (OpenGL)"


def test_what_is_found_and_what_is_missing(reported):
    found = reported("doctor")
    assert "libx264" in found["video"]["what"]
    assert found[SORTED] == {"found": True, "what": "right for 100,000 splats, twice the same"}
    for package, extra in (("torch", "jobs"), ("pyarrow", "drive"), ("gymnasium", "drive")):
        is_there = find_spec(package) is not None
        assert found[package]["found"] == is_there
        assert is_there or found[package]["what"].endswith(optional_packages.how_to_add(extra))


@pytest.mark.parametrize(
    ("mark", "line"),
    [
        (None, "'/a b/python' -m pip install 'gsrain[drive]'"),
        ("pipx_metadata.json", "pipx runpip gsrain install 'gsrain[drive]'"),
        ("uv-receipt.toml", "uv pip install --python '/a b/python' 'gsrain[drive]'"),
        ("archive-v0/x/pyvenv.cfg", "uvx --from 'gsrain[drive]' gsrain"),
    ],
)
def test_extras_are_added_to_the_environment_of_the_program(mark, line, tmp_path, monkeypatch):
    """A bare `pip` is another environment's: it finds no gsrain, and on Debian it refuses to install anything."""
    environment = (tmp_path / "gsrain" / (mark or "")).parent if "/" in (mark or "") else tmp_path / "gsrain"
    environment.mkdir(parents=True)
    if mark is not None:
        (environment / Path(mark).name).touch()
    monkeypatch.setattr(sys, "prefix", str(environment))
    monkeypatch.setattr(sys, "executable", "/a b/python")
    assert optional_packages.how_to_add("drive") == line


def test_what_pip_can_not_add_to_a_frozen_program(monkeypatch, capsys):
    """To the program that PyInstaller builds, pip can add nothing."""

    def none(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(doctor, "metadata", SimpleNamespace(version=none, PackageNotFoundError=PackageNotFoundError))
    monkeypatch.setattr(doctor, "installed_extensions", tuple)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    doctor.doctor()
    lines = [line for line in capsys.readouterr().out.splitlines() if "not installed; for " in line]
    assert len(lines) > 5
    assert all("install GSRAIN by pip, with 'gsrain[" in line for line in lines)


def test_an_nvidia_gpu_without_its_opengl_names_the_setting_of_containers(tmp_path, monkeypatch):
    setting = "NVIDIA_DRIVER_CAPABILITIES=graphics"
    monkeypatch.setattr(context, "_NVIDIA_DEVICE", tmp_path / "missing")
    monkeypatch.setattr(context, "is_software", lambda _: True)
    assert setting not in doctor.find_opengl().what
    monkeypatch.setattr(context, "_NVIDIA_DEVICE", tmp_path)
    assert setting in doctor.find_opengl().what
    monkeypatch.setattr(context, "is_software", lambda _: False)
    assert setting not in doctor.find_opengl().what

    def missing():
        raise OSError("libEGL.so.1: no such file")

    monkeypatch.setattr(context, "_open_egl", missing)
    found, what = doctor.find_opengl()[1:]
    assert not found and "libEGL.so.1" in what and setting in what


@pytest.mark.parametrize("kernels", [object(), None])
def test_gsplat_trains_where_its_kernels_load(kernels, monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.setattr(gsplat_build, "gsplat_is_built", lambda: True)
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", SimpleNamespace(_C=kernels))
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(doctor, "metadata", SimpleNamespace(version=lambda name: f"{name} 1.5"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert not doctor.find_gsplat().found
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a card")
    found = doctor.find_gsplat()
    assert found.found == (kernels is not None)
    assert ("trains on a card" if kernels else "CUDA toolkit (nvcc)") in found.what


def test_a_wrong_order_of_splats(tmp_path, monkeypatch, capsys):
    def wrong(context, count):
        sorted_counts.append(count)
        return sort.SortCheck(count, missing=9_239, inversions=0, changed=12)

    sorted_counts = []
    monkeypatch.setattr("gsrain_engine.render.opengl.context.is_software", lambda context: False)
    monkeypatch.setattr(sort, "check_sort", wrong)
    assert run(["doctor"]) == 1
    line = next(line for line in capsys.readouterr().out.splitlines() if SORTED in line)
    assert line.startswith("WRONG")
    assert "of 1,000,000 splats 9,239 are lost, 0 out of order, and 12 elsewhere in a second try" in line
    assert sorted_counts == [1_000_000, 3_000_000]


# Files that a user brings: weights and models

FILES = {
    doctor.find_lpips: "LPIPS (vgg)", doctor.find_inception: "pt_inception", doctor.find_detector_file: "https://",
    doctor.find_base_model: "hf download", doctor.find_transfer_weights: weight_paths.PUBLISHED_URL,
    doctor.find_text_encoder: "SD-Turbo", doctor.find_clip_model: "--clip",
    doctor.find_normals_weights: "--normals-weights FILE", doctor.find_normals_program: "--normals-checkout DIR",
}  # fmt: skip
"""Functions that look for them, and what they print of one that is missing: where to get it."""


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A machine on which nothing lies yet."""
    folders = {"XDG_DATA_HOME": "data", "XDG_CACHE_HOME": "cache", "HF_HOME": "hub", "GSRAIN_LPIPS_WEIGHTS": "lpips"}
    for variable, folder in (folders | {INCEPTION_PLACE: "inception.npz"}).items():
        monkeypatch.setenv(variable, str(tmp_path / folder))
    places = (weight_paths.BASE_VARIABLE, weight_paths.WEIGHTS_VARIABLE, WEIGHTS_PLACE, CHECKOUT_PLACE, CLIP_PLACE)
    for variable in (*places, "HF_HUB_CACHE", PLACE):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


@pytest.mark.parametrize("find", FILES)
def test_what_is_missing_comes_with_how_to_get_it(find, home):
    finding = find()
    assert not finding.found and FILES[find] in finding.what


PAPER = ("SD-Turbo", "CLIP ViT-B/32", "LPIPS", "DSINE weights", "DSINE program", "Inception", "transfer weights", "zsh")
"""Files and programs that the rows of docs/paper.md need, besides data."""


def test_everything_that_the_paper_needs_has_a_row(home, reported):
    found = reported("doctor")
    for name in PAPER:
        (row,) = (key for key in found if key.startswith(name))
        assert found[row]["what"] and (found[row]["found"] is False or name == "zsh")


def test_dsine_is_found_where_it_is_looked_for(home, monkeypatch):
    weights, program = home / "data" / "gsrain" / "dsine" / "dsine.pt", home / "DSINE"
    (program / "models").mkdir(parents=True)
    (program / "models" / "dsine.py").write_text("raise SystemExit('code must not run')\n")
    weights.parent.mkdir(parents=True)
    weights.touch()
    assert doctor.find_normals_weights()[1:] == (True, str(weights))
    monkeypatch.setenv(WEIGHTS_PLACE, str(home / "elsewhere.pt"))
    assert not doctor.find_normals_weights().found and "elsewhere.pt" in doctor.find_normals_weights().what
    monkeypatch.setenv(CHECKOUT_PLACE, str(program))
    monkeypatch.setattr("gsrain_engine.appearance.dsine_checkout.has_geffnet", lambda: False)
    finding = doctor.find_normals_program()
    assert not finding.found and finding.what.endswith("install geffnet") and str(program) in finding.what
    monkeypatch.setattr("gsrain_engine.appearance.dsine_checkout.has_geffnet", lambda: True)
    assert doctor.find_normals_program()[1:] == (True, str(program))


def test_zsh_comes_with_the_option_that_names_the_client(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not doctor.find_zsh().found and "apt-get install zsh" in doctor.find_zsh().what
    (tmp_path / "zsh").touch(0o755)
    assert doctor.find_zsh().found and doctor.find_zsh().what.startswith(str(tmp_path / "zsh"))
    assert "--hugsim-client" in doctor.find_zsh().what


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


def test_a_detector_and_transfer_weights_are_found(home):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from evaluation.detection.tiny_onnx import NAMES, rows, write_constant

    (home / "data" / "gsrain" / "detectors").mkdir(parents=True)
    file = write_constant(home / "data" / "gsrain" / "detectors" / "seer.onnx", [rows()], (48, 64), NAMES)
    assert doctor.find_detector_file()[1:] == (True, f"{file} (sees 64 x 48 px)")
    file.write_bytes(b"nothing of the kind")
    assert not doctor.find_detector_file().found and "seer.onnx" in doctor.find_detector_file().what
    file = weight_paths.data_folder() / "transfer" / "clear2rainy.pkl"
    file.parent.mkdir(parents=True)
    file.write_bytes(bytes(3_000_000))
    assert doctor.find_transfer_weights()[1:] == (True, f"{file} (3 MB)")


@pytest.fixture
def older_numpy(monkeypatch):
    """An environment in which another package has brought an older NumPy."""
    version = doctor.metadata.version
    monkeypatch.setattr(doctor.metadata, "version", lambda name: "1.26.4" if name == "numpy" else version(name))
    others = [("nuscenes-devkit", ["numpy<2.0.0,>=1.22.0", "cachetools"]), ("open3d", ["numpy>=1.18"])]
    packages = [SimpleNamespace(metadata={"Name": name}, requires=lines) for name, lines in others]
    monkeypatch.setattr(doctor.metadata, "distributions", lambda: packages)


@pytest.mark.street
def test_a_package_of_another_version_comes_with_what_limits_it(older_numpy, monkeypatch, capsys):
    _, found, what = doctor.find_requirements()
    assert not found and "numpy 1.26.4" in what and "nuscenes-devkit (numpy<2.0.0,>=1.22.0)" in what
    assert ">=2.1" in what and "open3d" not in what

    def fail(*args, **kwargs):
        raise AttributeError("module 'numpy' has no attribute 'bitwise_count'")

    monkeypatch.setattr("app.main.copy_context", lambda: SimpleNamespace(run=fail))
    assert run(["info", "street"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "numpy 1.26.4" in line and "bitwise_count" in line


def test_an_optional_package_of_another_version_is_not_there(monkeypatch):
    version = doctor.metadata.version
    monkeypatch.setattr(doctor.metadata, "version", lambda name: "0.2.7" if name == "viser" else version(name))
    rows = doctor.find_package("viser"), doctor.find_requirements()
    assert [row.found for row in rows] == [False, True] and "viser 0.2.7" in rows[0].what


@pytest.mark.parametrize("packages", [["opencv-python-headless"], ["opencv-contrib-python-headless", "opencv-python"]])
def test_any_build_of_opencv_will_do_and_several_are_named(packages, monkeypatch):
    monkeypatch.setattr(doctor.metadata, "packages_distributions", lambda: {"cv2": packages})
    row = doctor.find_opencv()
    assert row.found and all(each in row.what for each in packages) and ("share" in row.what) == (len(packages) > 1)
