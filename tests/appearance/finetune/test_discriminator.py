"""Input and output of the discriminators."""

from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

from gsrain_engine.appearance.finetune.discriminator import (  # noqa: E402
    ClipFeatures,
    Discriminator,
    area_resized,
    augment_images,
)
from gsrain_engine.appearance.finetune.settings import PLACE  # noqa: E402
from gsrain_engine.appearance.finetune.step import adversarial  # noqa: E402


def _random(seed: int) -> object:
    return torch.Generator().manual_seed(seed)


def _pictures(count: int = 2, side: int = 40) -> object:
    return torch.rand(count, 3, side, side, generator=_random(0)) * 2 - 1


@pytest.fixture
def features() -> ClipFeatures:
    torch.manual_seed(0)
    return ClipFeatures.tiny()


@pytest.mark.parametrize("size", [(512, 512), (40, 96), (7, 5), (32, 31)])
def test_areas_are_torchs_areas(size: tuple[int, int]) -> None:
    pictures = torch.rand(1, 2, *size, generator=_random(3))
    expected = torch.nn.functional.interpolate(pictures, (32, 32), mode="area")
    assert torch.allclose(area_resized(pictures, 32), expected, atol=1e-6)


def test_features_are_taken_after_their_blocks(features: ClipFeatures) -> None:
    pictures = _pictures(side=32)
    first, second, whole = features(pictures)
    assert first.shape == second.shape == (2, 16, 4, 4) and whole.shape == (2, 16)
    model = features.vision.vision_model
    shown = (pictures * 0.5 + 0.5 - features.mean) / features.deviation
    flow = model.pre_layrnorm(model.embeddings(shown))
    for number, block in enumerate(model.encoder.layers, 1):
        flow = block(flow, attention_mask=None)
        flow = flow[0] if isinstance(flow, tuple) else flow
        for tap, seen in zip(features.taps, (first, second), strict=True):
            if number == tap:
                assert torch.allclose(seen[1, :, 2, 3], flow[1, 1 + 2 * 4 + 3], atol=1e-5)
    assert features.taps == (1, 2)


def test_clip_is_frozen_but_lets_gradients_through(features: ClipFeatures) -> None:
    pictures = _pictures().requires_grad_(True)
    features.train()
    features(pictures)[2].sum().backward()
    assert pictures.grad.abs().sum() > 0
    assert not features.vision.training and all(each.grad is None for each in features.parameters())


def test_clip_is_read_from_a_persons_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vision = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 6, "num_attention_heads": 2,
              "image_size": 32, "patch_size": 8, "projection_dim": 24}  # fmt: skip
    text = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2,
            "vocab_size": 32}  # fmt: skip
    clip = transformers.CLIPModel(transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=24))
    clip.save_pretrained(tmp_path / "clip")
    read = ClipFeatures.read(tmp_path / "clip")
    assert read.taps == (2, 4) and read.whole_channels == 24
    assert torch.equal(read.vision.visual_projection.weight, clip.visual_projection.weight)
    monkeypatch.setenv(PLACE, str(tmp_path / "clip"))
    assert ClipFeatures.read(None).map_channels == 16

    state = {name: each for name, each in clip.state_dict().items() if "visual_projection" not in name}
    clip.save_pretrained(tmp_path / "half", state_dict=state)
    with pytest.raises(ValueError, match=r"1 weights .* visual_projection\.weight"):
        ClipFeatures.read(tmp_path / "half")
    with pytest.raises(FileNotFoundError, match="clip-vit-base-patch32"):
        ClipFeatures.read(tmp_path)
    monkeypatch.setenv(PLACE, str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match=f"nowhere.*{PLACE}"):
        ClipFeatures.read(None)


def test_a_discriminator_learns_to_tell_bright_from_dark(features: ClipFeatures) -> None:
    judge = Discriminator(features, (), channels=16)
    assert not any("vision" in name for name in judge.state_dict())
    logits = judge(_pictures(), _random(1))
    assert [each.shape[1:] for each in logits] == [(1, 2, 2), (1, 2, 2), (1,)]
    adam = torch.optim.Adam(judge.parameters(), 5e-3)
    bright, dark = _pictures() * 0.3 + 0.6, _pictures() * 0.3 - 0.6
    losses = []
    for step in range(15):
        loss = adversarial(judge(bright, _random(step)), True) + adversarial(judge(dark, _random(step)), False)
        adam.zero_grad()
        loss.backward()
        adam.step()
        losses.append(loss.item())
    assert losses[-1] < 0.8 * losses[0]
    for layer in (judge.maps[0].first, judge.whole[0]):
        assert float(torch.linalg.matrix_norm(layer.weight.detach().flatten(1), 2)) < 1.2


def test_augmentation_follows_its_seed() -> None:
    pictures, kinds = _pictures(), ("color", "translation", "cutout")
    assert torch.equal(augment_images(pictures, kinds, _random(4)), augment_images(pictures, kinds, _random(4)))
    assert not torch.equal(augment_images(pictures, kinds, _random(4)), augment_images(pictures, kinds, _random(5)))
    assert torch.equal(augment_images(pictures, (), _random(4)), pictures)


def test_translation_moves_and_uncovers_grey() -> None:
    pictures = _pictures(count=8, side=40)
    moved = augment_images(pictures, ("translation",), _random(2))
    shifts = set()
    for before, after in zip(pictures, moved, strict=True):
        found = [
            (dy, dx)
            for dy in range(-5, 6)
            for dx in range(-5, 6)
            if torch.equal(after[:, 10:30, 10:30], before[:, 10 - dy : 30 - dy, 10 - dx : 30 - dx])
        ]
        ((dy, dx),) = found
        shifts.add((dy, dx))
        assert int((after == 0).all(0).sum()) == 40 * 40 - (40 - abs(dy)) * (40 - abs(dx))
    assert len(shifts) > 4


def test_cutout_leaves_a_hole_of_at_most_a_quarter() -> None:
    holes = (augment_images(_pictures(count=32), ("cutout",), _random(2)) == 0).all(1).flatten(1).float().mean(1)
    assert float(holes.max()) <= 0.25 and float(holes.min()) >= 0.25 / 4 * 0.9 and len(holes.unique()) > 8


def test_colours_change_as_drawn() -> None:
    pictures = _pictures(count=64)
    changed = augment_images(pictures, ("color",), _random(2))
    means = (changed - pictures).mean((1, 2, 3))
    assert float(means.abs().max()) <= 0.5 + 1e-5 and float(means.std()) == pytest.approx(1 / 12**0.5, rel=0.25)
    contrasts = changed.mean(1).std((1, 2)) / pictures.mean(1).std((1, 2))
    assert 0.5 <= float(contrasts.min()) < 0.7 and 1.3 < float(contrasts.max()) <= 1.5
