"""Marigold from a folder: a tiny pipeline of the same classes with random weights."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers")
transformers = pytest.importorskip("transformers")

from gsrain_engine.appearance.normal_models import from_right_up_backward  # noqa: E402
from gsrain_engine.appearance.normals import (  # noqa: E402
    NormalEstimator,
    open_estimator,
)
from gsrain_engine.scene.camera import (  # noqa: E402
    Camera,
    look_at,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("marigold")
    words = {"<|startoftext|>": 0, "<|endoftext|>": 1, "a</w>": 2, "a": 3}
    (folder / "vocab.json").write_text(json.dumps(words))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    text = transformers.CLIPTextConfig(
        vocab_size=4, hidden_size=8, intermediate_size=8, num_hidden_layers=1, num_attention_heads=2,
        bos_token_id=0, eos_token_id=1, pad_token_id=1,
    )  # fmt: skip
    pipeline = diffusers.MarigoldNormalsPipeline(
        unet=diffusers.UNet2DConditionModel(
            in_channels=8, out_channels=4, block_out_channels=(8, 8), layers_per_block=1, norm_num_groups=4,
            down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"),
            up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"), cross_attention_dim=8, attention_head_dim=2,
        ),
        vae=diffusers.AutoencoderKL(
            block_out_channels=(8, 8), down_block_types=("DownEncoderBlock2D",) * 2,
            up_block_types=("UpDecoderBlock2D",) * 2, norm_num_groups=4, latent_channels=4,
        ),
        scheduler=diffusers.DDIMScheduler(prediction_type="v_prediction"),
        text_encoder=transformers.CLIPTextModel(text),
        tokenizer=transformers.CLIPTokenizer(
            str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=77
        ),
        prediction_type="normals",
        default_denoising_steps=1,
        default_processing_resolution=32,
    )  # fmt: skip
    pipeline.save_pretrained(folder / "model")
    return folder / "model"


def test_it_is_the_pipelines_prediction_turned_to_the_world(folder):
    eye = np.array([0.0, 0.0, 1.5])
    camera = Camera.from_fov(40, 30, 60, look_at(eye, np.array([1.0, 1.0, 1.2]), np.array([0.0, 0, 1])))
    image = np.random.default_rng(0).random((30, 40, 3), dtype=np.float32)
    estimator = open_estimator("marigold", folder)
    assert isinstance(estimator, NormalEstimator)
    found = estimator.normals(image, camera)
    noise = torch.Generator().manual_seed(0)
    raw = estimator.pipeline(image, generator=noise).prediction[0]
    np.testing.assert_allclose(found, from_right_up_backward(raw, camera), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-5)
    assert found.std() > 0.01
    assert found.tobytes() == estimator.normals(image, camera).tobytes()


def test_another_folder_is_refused(tmp_path):
    with pytest.raises(ValueError, match="not a MarigoldNormalsPipeline"):
        open_estimator("marigold", tmp_path)
    with pytest.raises(ValueError, match="hf download"):
        open_estimator("marigold", None)
