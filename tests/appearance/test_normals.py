"""Normals: from depth, between axis conventions, as a gray guide, and by estimators that a user installed."""

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from appearance.dsine_program import write_program
from gsrain_engine.appearance.normals import (
    NormalEstimator,
    normals_from_depth,
    normals_to_gray,
    open_estimator,
    right_down_outward,
    view_rays,
)
from gsrain_engine.scene.camera import Camera, look_at

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")

from gsrain_engine.appearance.normal_models import (  # noqa: E402
    DsineNormals,
    from_right_down_outward,
    from_right_up_backward,
)

UP = np.array([0.0, 0.0, 1.0])

# From depth


def camera(forward=(1.0, 0.2, -0.15), width=96, height=64) -> Camera:
    eye = np.array([0.0, 0.0, 1.5])
    return Camera.from_fov(width, height, 60, look_at(eye, eye + np.array(forward), UP))


def plane_depth(camera: Camera, normal: np.ndarray, offset: float) -> np.ndarray:
    """View depth of the plane normal . x = offset; 0 where no ray hits it within 60 m."""
    with np.errstate(divide="ignore"):
        depth = (offset - normal @ camera.position) / (view_rays(camera) @ normal)
    return np.where((depth > 0) & (depth < 60), depth, 0).astype(np.float32)


@pytest.mark.parametrize("normal", [(0, 0, 1), (-1, 0, 0), (-0.8, 0.6, 0), (-0.6, 0, 0.8)])
def test_a_plane_has_its_own_normal_where_it_has_depth(normal):
    normal = np.array(normal, float)
    depth = plane_depth(camera(), normal, 0 if normal[2] else -8)
    near = (depth > 0) & (depth < 25)
    assert near.sum() > 500
    found = normals_from_depth(depth, camera())
    np.testing.assert_allclose(np.linalg.norm(found[near], axis=-1), 1, atol=1e-5)
    assert np.quantile(found[near] @ normal, 0.02) > 0.98 and not found[depth == 0].any()


# Axis conventions and the gray guide. Looking along +x, right is -y: a wall on the left, facing right, has (0, -1, 0).

AHEAD = camera((1.0, 0.0, 0.0), 8, 6)
GROUND, FACING, ON_THE_LEFT, CEILING = (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)


def everywhere(normal) -> np.ndarray:
    return np.broadcast_to(np.float32(normal), (6, 8, 3))


@pytest.mark.parametrize(
    ("normal", "outward", "backward", "gray"),
    [
        (GROUND, (0, 1, 0), (0, 1, 0), 0.79),
        (FACING, (0, 0, 1), (0, 0, 1), 0.56),
        (ON_THE_LEFT, (-1, 0, 0), (1, 0, 0), 0.35),
        (CEILING, (0, -1, 0), (0, -1, 0), 0.21),
    ],
)
def test_conventions_of_estimators_and_the_luma_that_pillow_makes_of_them(normal, outward, backward, gray):
    world = everywhere(normal)
    np.testing.assert_allclose(right_down_outward(world, AHEAD), everywhere(outward), atol=1e-6)
    np.testing.assert_allclose(from_right_down_outward(everywhere(outward), AHEAD), world, atol=1e-6)
    np.testing.assert_allclose(from_right_up_backward(everywhere(backward), AHEAD), world, atol=1e-6)
    guide = (normals_to_gray(world, AHEAD, "luma") + 1) / 2
    picture = np.round((right_down_outward(world, AHEAD) + 1) / 2 * 255).astype(np.uint8)
    for shares in (np.asarray(Image.fromarray(picture).convert("L")) / 255, np.full((6, 8), gray)):
        np.testing.assert_allclose(guide, shares, atol=0.006)


def test_up_is_the_same_for_any_camera_and_the_unknown_is_neither():
    for forward in ((1, 0, 0), (0.2, 1, -0.4), (-1, 0.1, 0.3)):
        for normal, value in ((GROUND, 1), (FACING, 0), (CEILING, -1), ((0, 0, 0), 0)):
            assert (normals_to_gray(everywhere(normal), camera(forward, 8, 6), "up") == value).all()
    assert not normals_to_gray(everywhere((0, 0, 0)), AHEAD, "luma").any()


# DSINE, replaced by a program of the same files, names and calls

TURNED = replace(camera((1.0, 0.4, -0.1), 50, 35), fx=40, fy=42, cx=23.2, cy=17.9)
PICTURE = np.full((35, 50, 3), 0.25, np.float32)


@pytest.fixture
def encoder(monkeypatch):
    """Replaces geffnet; lists which weights were requested from the network."""
    asked = []

    def create_model(name, pretrained=True):
        asked.append((name, pretrained))
        return torch.nn.Conv2d(3, 1, 1)

    monkeypatch.setitem(sys.modules, "geffnet", SimpleNamespace(create_model=create_model))
    return asked


def weights(folder, **extra):
    state = {"gain": torch.tensor([2.0]), "encoder.original_model.weight": torch.zeros(1, 3, 1, 1)}
    state |= {"encoder.original_model.bias": torch.zeros(1)} | extra
    torch.save({"model": {f"module.{name}": value for name, value in state.items()}, "iter": 3}, folder / "dsine.pt")
    return folder / "dsine.pt"


KAPPA = {"kappa_head.weight": torch.zeros(1, 1, 1, 1), "kappa_head.bias": torch.zeros(1)}


@pytest.mark.parametrize(("is_old", "extra"), [(False, {}), (False, KAPPA), (True, {})])
def test_normals_along_its_rays_come_back_along_ours(tmp_path, encoder, is_old, extra, monkeypatch):
    program, own = write_program(tmp_path / "DSINE", is_old), SimpleNamespace()
    monkeypatch.setitem(sys.modules, "utils", own)
    file = weights(tmp_path, **extra)
    estimator = open_estimator("dsine", file, program)
    assert isinstance(estimator, NormalEstimator) and encoder == [("tf_efficientnet_b5_ap", False)]
    monkeypatch.setenv("GSRAIN_DSINE_WEIGHTS", str(file))
    monkeypatch.setenv("GSRAIN_DSINE", str(program))
    placed = open_estimator("dsine", None)
    assert placed.normals(PICTURE, TURNED).tobytes() == estimator.normals(PICTURE, TURNED).tobytes()
    rays = view_rays(TURNED)
    found = estimator.normals(PICTURE, TURNED)
    np.testing.assert_allclose(found, -rays / np.linalg.norm(rays, axis=-1, keepdims=True), atol=1e-6)
    # Its common names are gone afterwards.
    assert sys.modules["utils"] is own and str(program) not in sys.path
    assert not [name for name in sys.modules if name.split(".")[0] == "models"]


def test_it_gets_black_around_the_picture_and_imagenets_colors():
    inputs = []

    def module(picture, intrins):
        inputs.extend((picture[0], intrins[0]))
        return [torch.ones_like(picture)]

    DsineNormals(module).normals(PICTURE, TURNED)
    mean, deviation = (torch.tensor(each)[:, None, None] for each in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    padded = torch.zeros(3, 64, 64)
    padded[:, 14 : 14 + 35, 7 : 7 + 50] = 0.25
    torch.testing.assert_close(inputs[0], (padded - mean) / deviation)
    lens = [[40, 0, 23.2 - 0.5 + 7], [0, 42, 17.9 - 0.5 + 14], [0, 0, 1]]
    torch.testing.assert_close(inputs[1], torch.tensor(lens))


def test_other_names_files_and_programs_are_refused(tmp_path, encoder, monkeypatch):
    program, file = write_program(tmp_path / "DSINE"), weights(tmp_path)
    (tmp_path / "text.pt").write_text("no weights")
    torch.save({"model": {"other": torch.zeros(1)}}, tmp_path / "other.pt")

    def refused(match, *arguments):
        with pytest.raises(ValueError, match=match):
            open_estimator(*arguments)

    refused("'dsin'.*dsine, marigold", "dsin", file, program)
    refused("non-commercial", "dsine", None, program)
    refused("git clone", "dsine", file, None)
    refused(r"none\.pt", "dsine", tmp_path / "none.pt", program)
    refused(tmp_path.name, "dsine", file, tmp_path)
    refused(r"text\.pt", "dsine", tmp_path / "text.pt", program)
    refused(r"other\.pt.*DSINE", "dsine", tmp_path / "other.pt", program)
    refused(tmp_path.name, "marigold", tmp_path)
    refused("hf download", "marigold", None)
    monkeypatch.setitem(sys.modules, "geffnet", None)
    refused("pip install geffnet", "dsine", file, program)


# Marigold: a tiny pipeline of the same classes with random weights


def test_marigold_is_the_pipelines_prediction_turned_to_the_world(tmp_path):
    torch.manual_seed(0)
    words = tmp_path / "vocab.json", tmp_path / "merges.txt"
    words[0].write_text(json.dumps({"<|startoftext|>": 0, "<|endoftext|>": 1, "a</w>": 2, "a": 3}))
    words[1].write_text("#version: 0.2\n")
    text = transformers.CLIPTextConfig(
        vocab_size=4, hidden_size=8, intermediate_size=8, num_hidden_layers=1, num_attention_heads=2,
        bos_token_id=0, eos_token_id=1, pad_token_id=1,
    )  # fmt: skip
    pipeline = diffusers.MarigoldNormalsPipeline(
        unet=diffusers.UNet2DConditionModel(
            in_channels=8, out_channels=4, block_out_channels=(8,), layers_per_block=1, norm_num_groups=4,
            down_block_types=("CrossAttnDownBlock2D",), up_block_types=("CrossAttnUpBlock2D",), cross_attention_dim=8,
            attention_head_dim=2,
        ),
        vae=diffusers.AutoencoderKL(block_out_channels=(8,), norm_num_groups=4),
        scheduler=diffusers.DDIMScheduler(prediction_type="v_prediction"),
        text_encoder=transformers.CLIPTextModel(text),
        tokenizer=transformers.CLIPTokenizer(*map(str, words), model_max_length=77),
        prediction_type="normals", default_denoising_steps=1, default_processing_resolution=32,
    )  # fmt: skip
    pipeline.save_pretrained(tmp_path / "model")
    picture = np.random.default_rng(0).random((35, 50, 3), dtype=np.float32)
    estimator = open_estimator("marigold", tmp_path / "model")
    found = estimator.normals(picture, TURNED)
    raw = estimator.pipeline(picture, generator=torch.Generator().manual_seed(0)).prediction[0]
    np.testing.assert_allclose(found, from_right_up_backward(raw, TURNED), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-5)
    assert found.std() > 0.01 and found.tobytes() == estimator.normals(picture, TURNED).tobytes()
