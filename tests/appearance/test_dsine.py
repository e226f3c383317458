"""DSINE as the person has it: stood in for by a program of the same files, names and calls."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from appearance.dsine_program import write_program

torch = pytest.importorskip("torch")

from gsrain_engine.appearance.normal_models import DsineNormals  # noqa: E402
from gsrain_engine.appearance.normals import (  # noqa: E402
    NormalEstimator,
    open_estimator,
    view_rays,
)
from gsrain_engine.scene.camera import (  # noqa: E402
    Camera,
    look_at,
)


@pytest.fixture
def encoder(monkeypatch):
    """Stands in for geffnet; knows whether weights were asked of the network."""
    asked = []

    def create_model(name, pretrained=True):
        asked.append((name, pretrained))
        return torch.nn.Conv2d(3, 1, 1)

    monkeypatch.setitem(sys.modules, "geffnet", SimpleNamespace(create_model=create_model))
    return asked


@pytest.fixture
def camera():
    eye = np.array([1.0, 2.0, 1.5])
    pose = look_at(eye, eye + np.array([1.0, 0.4, -0.1]), np.array([0.0, 0, 1]))
    return Camera(width=50, height=35, fx=40, fy=42, cx=23.2, cy=17.9, world_to_camera=pose)


def weights(folder, **extra):
    state = {"gain": torch.tensor([2.0]), "encoder.original_model.weight": torch.zeros(1, 3, 1, 1)}
    state |= {"encoder.original_model.bias": torch.zeros(1)} | extra
    torch.save({"model": {f"module.{name}": value for name, value in state.items()}, "iter": 3}, folder / "dsine.pt")
    return folder / "dsine.pt"


def image(camera):
    return np.full((camera.height, camera.width, 3), 0.25, np.float32)


KAPPA = {"kappa_head.weight": torch.zeros(1, 1, 1, 1), "kappa_head.bias": torch.zeros(1)}


@pytest.mark.parametrize(("is_old", "extra"), [(False, {}), (False, KAPPA), (True, {})])
def test_normals_along_its_rays_come_back_along_ours(tmp_path, encoder, camera, is_old, extra):
    program = write_program(tmp_path / "DSINE", is_old)
    estimator = open_estimator("dsine", weights(tmp_path, **extra), program)
    assert isinstance(estimator, NormalEstimator)
    assert encoder == [("tf_efficientnet_b5_ap", False)]
    rays = view_rays(camera)
    expected = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    found = estimator.normals(image(camera), camera)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_it_sees_black_around_the_picture_and_imagenets_colours(camera):
    seen = []

    def module(picture, intrins):
        seen.append((picture, intrins))
        return [torch.ones_like(picture)]

    DsineNormals(module).normals(image(camera), camera)
    ((picture, intrinsics),) = seen
    assert picture.shape == (1, 3, 64, 64)
    mean, deviation = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    torch.testing.assert_close(picture[0, :, 0, 0], -mean / deviation)
    torch.testing.assert_close(picture[0, :, 30, 30], (0.25 - mean) / deviation)
    inside = (picture[0, 0] > -1.5).nonzero()
    assert inside.amin(0).tolist() == [14, 7]
    assert inside.amax(0).tolist() == [14 + 34, 7 + 49]
    torch.testing.assert_close(
        intrinsics[0], torch.tensor([[40, 0, 23.2 - 0.5 + 7], [0, 42, 17.9 - 0.5 + 14], [0, 0, 1]])
    )


def test_its_common_names_are_gone_afterwards(tmp_path, encoder, monkeypatch):
    own = SimpleNamespace()
    monkeypatch.setitem(sys.modules, "utils", own)
    open_estimator("dsine", weights(tmp_path), write_program(tmp_path / "DSINE"))
    assert sys.modules["utils"] is own
    assert not [name for name in sys.modules if name.split(".")[0] == "models"]
    assert str(tmp_path / "DSINE") not in sys.path


def test_what_is_wrong_is_said_in_one_sentence(tmp_path, encoder, monkeypatch):
    program, file = write_program(tmp_path / "DSINE"), weights(tmp_path)

    def complaint(*arguments):
        with pytest.raises(ValueError) as caught:
            open_estimator(*arguments)
        return str(caught.value)

    assert "no normal estimator 'dsin'; there are dsine, marigold" in complaint("dsin", file, program)
    assert "non-commercial" in complaint("dsine", None, program)
    assert "git clone" in complaint("dsine", file, None)
    assert "no such file" in complaint("dsine", tmp_path / "none.pt", program)
    assert "not DSINE's program" in complaint("dsine", file, tmp_path)
    (tmp_path / "text.pt").write_text("no weights")
    assert "text.pt: not DSINE's weights" in complaint("dsine", tmp_path / "text.pt", program)
    torch.save({"model": {"other": torch.zeros(1)}}, tmp_path / "other.pt")
    assert "not for the program in" in complaint("dsine", tmp_path / "other.pt", program)
    monkeypatch.setitem(sys.modules, "geffnet", None)
    assert "pip install geffnet" in complaint("dsine", file, program)
