"""Features whose package is missing: one sentence, with the line that installs it, and nothing is lost."""

import re
import subprocess
import sys
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from app.main import BAD_INPUT, run
from gsrain_engine.optional_packages import OPTIONAL_PACKAGES, MissingPackageError, import_package
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.simulation.serving.protocols import protocol_names
from repository import REPOSITORY
from small_scene import small_scene


@pytest.fixture
def without(monkeypatch):
    """Hide a package, as if it were not installed."""
    return lambda module: monkeypatch.setitem(sys.modules, module, None)


def test_each_optional_package_is_one_of_its_extra():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    base = {canonicalize_name(Requirement(each).name) for each in project["dependencies"]}
    for package in OPTIONAL_PACKAGES.values():
        assert package.name in {Requirement(each).name for each in extras[package.extra]}
        assert canonicalize_name(package.name) not in base
    assert len(base) <= 23


@pytest.mark.parametrize(
    ("module", "words", "package", "extra"),
    [
        ("xarray", ["disdrometer", "-o", "{out}/a.nc"], "xarray", "netcdf"),
        pytest.param("pyrender", ["street", "{out}/street"], "pyrender", "street", marks=pytest.mark.street),
        ("grpc", ["serve", "{scene}"], "grpcio", "alpasim"),
        ("carla_canvas", ["serve", "{scene}", "--protocol", "carla-canvas"], "carla-canvas", "carla"),
        ("viser", ["serve", "{scene}", "--protocol", "browser"], "viser", "viser"),
        ("pyarrow", ["drive", "--export", "parquet", "-o", "{out}/drive"], "pyarrow", "drive"),
    ],
)
def test_a_command_names_the_package_and_the_line_that_installs_it(
    module, words, package, extra, without, tmp_path, capsys
):
    if words[0] == "serve" and [*words, "alpasim"][3 if len(words) > 3 else -1] not in protocol_names():
        pytest.skip("its folder was deleted")
    scene, out = tmp_path / "scene", tmp_path / "out"
    write_scene(small_scene(), scene)
    without(module)
    assert run([each.format(scene=scene, out=out) for each in words]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    installs = re.escape(f"-m pip install 'gsrain[{extra}]'")
    assert re.search(f" needs {package}, which is not installed: .*{installs}$", line)
    assert not out.exists() or not list(out.iterdir())


def test_a_missing_package_is_an_import_error_and_a_wrong_value(without):
    without("rerun")
    with pytest.raises(MissingPackageError) as caught:
        import_package("rerun", "a Rerun file")
    assert isinstance(caught.value, ImportError) and isinstance(caught.value, ValueError)
    assert caught.value.name == "rerun"


def test_doctor_says_which_protocol_lacks_a_package(without, capsys):
    if not {"alpasim", "carla-canvas"} <= set(protocol_names()):
        pytest.skip("its folder was deleted")
    without("carla_canvas")
    run(["doctor"])
    printed = capsys.readouterr().out
    assert re.search(r"^absent  protocol carla-canvas: .* needs carla-canvas, which is not installed: ", printed, re.M)
    assert re.search(r"^ok      protocol alpasim: gsrain_extras\.alpasim\.protocol:PROTOCOL of gsrain ", printed, re.M)


WHILE_TORCH_IS_IMPORTED = """
import sys, threading
import numpy as np
from scipy.spatial.transform import Rotation
from gsrain_engine.optional_packages import import_package

found = []
importing = threading.Thread(target=lambda: found.append(import_package("torch", "a test")))
importing.start()
while "torch" not in sys.modules:
    pass
was_importing = importing.is_alive()
Rotation.from_euler("z", np.ones((3, 1))).as_matrix()  # which asks for its array's kind once
importing.join()
print(was_importing, found[0].zeros(2).sum().item(), found[0].Tensor is type(found[0].zeros(2)))
"""


def test_scipy_works_in_one_thread_while_another_imports_torch():
    """As the window draws while a checkpoint is opened."""
    ended = subprocess.run([sys.executable, "-c", WHILE_TORCH_IS_IMPORTED], capture_output=True, text=True, check=False)
    assert ended.stdout == "True 0.0 True\n", ended.stderr


def test_a_checkpoint_names_torch_where_that_is_missing(without, tmp_path, capsys):
    (tmp_path / "a.pth").write_bytes(b"PK")
    without("torch")
    assert run(["info", str(tmp_path / "a.pth")]) == BAD_INPUT
    assert "a checkpoint needs torch, which is not installed: " in capsys.readouterr().err
