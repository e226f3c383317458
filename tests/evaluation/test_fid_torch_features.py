"""The Inception extractor: its numbers, its name, and the right weights and no others."""

from importlib.util import find_spec

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.evaluation.fid import open_extractor  # noqa: E402
from gsrain_engine.evaluation.fid_features import ExtractorChoice, resized  # noqa: E402
from gsrain_engine.evaluation.fid_torch_features import (  # noqa: E402
    INCEPTION_PLACE,
    Inception,
    build_with_weights,
    inception_weights,
    is_torchscript,
)
from gsrain_engine.evaluation.lpips_weights import read_arrays, write_arrays  # noqa: E402

from .random_networks import write_inception  # noqa: E402


@pytest.fixture(scope="module")
def inception_file(tmp_path_factory):
    return write_inception(tmp_path_factory.mktemp("weights") / "inception.safetensors")


@pytest.fixture(scope="module")
def picture():
    y, x = np.mgrid[0:299, 0:299]
    return np.stack([x * 0.8, y * 0.8, (x + y) % 256], axis=2)


def test_inception_gives_the_features_of_pytorch_fid(inception_file, picture, monkeypatch):
    """Numbers of pytorch-fid's own InceptionV3 with these weights and this image; once, every bit was equal."""
    network = build_with_weights(Inception, inception_weights(inception_file))
    found = network(torch.from_numpy(picture.astype(np.float32)).permute(2, 0, 1)[None])[0].numpy()
    np.testing.assert_allclose(found[[0, 500, 1500, 2047]], (1.460849, 0, 0.9803747, 0.04222643), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose((found.mean(), found.std()), (4.257572, 5.851245), rtol=1e-4)
    monkeypatch.setenv(INCEPTION_PLACE, str(inception_file.parent))
    extractor = open_extractor(ExtractorChoice())
    assert extractor.metric == "FID" and extractor.key is not None
    assert "published" not in extractor.described  # the weights are random
    features = extractor(picture.astype(np.uint8)[:100])
    assert (features.shape, features.dtype) == ((2048,), np.float32)


def test_nothing_here_needs_torchvision():
    """Its builds are bound to single builds of torch, and peft looks for it when it is there."""
    assert find_spec("torchvision") is None


SEVEN = "Mixed_6d.branch7x7_2.conv.weight"


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"fc.weight": np.zeros((1000, 2048), np.float32)}, "1000 classes"),
        ({SEVEN: None}, f"{SEVEN} is missing"),
        ({SEVEN: np.zeros((160, 160, 7, 1), np.float32)}, rf"{SEVEN} is .*7, 1\), expected \(160, 160, 1, 7\)"),
        ({"AuxLogits.conv0.bn.bias": np.zeros(3, np.float32)}, "AuxLogits"),
        ({"Mixed_8a.bn.bias": np.zeros(3, np.float32)}, "Mixed_8a.bn.bias"),
    ],
)  # fmt: skip
def test_wrong_weights_are_named(change, names, inception_file, tmp_path):
    arrays = {name: array for name, array in (read_arrays(inception_file) | change).items() if array is not None}
    write_arrays(tmp_path / "other.safetensors", arrays)
    with pytest.raises(ValueError, match=f"other.safetensors: .*{names}"):
        inception_weights(tmp_path / "other.safetensors")


def test_torchs_own_file_gives_the_same_arrays(inception_file, tmp_path):
    arrays = read_arrays(inception_file)
    torch.save({name: torch.from_numpy(array) for name, array in arrays.items()}, tmp_path / "inception.pth")
    assert not is_torchscript(tmp_path / "inception.pth")
    found = inception_weights(tmp_path / "inception.pth")
    assert set(found) == set(arrays) - {"fc.weight"}
    assert all(np.array_equal(found[name], arrays[name]) for name in found)


class _Pooled(torch.nn.Module):
    def forward(self, pictures):
        return pictures.mean(dim=(2, 3)).repeat(1, 683)[:, :2048]


class _Whole(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.layers = _Pooled()


@pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning", "ignore:.*torch.jit.*:FutureWarning")
def test_torchscript_runs_only_where_it_may(tmp_path, picture):
    file = tmp_path / "inception-2015-12-05.pt"
    torch.jit.script(_Whole()).save(str(file))
    assert is_torchscript(file)
    with pytest.raises(ValueError, match="--torchscript"):
        open_extractor(ExtractorChoice(weights=file))
    extractor = open_extractor(ExtractorChoice(weights=file, allows_torchscript=True))
    expected = ((resized(picture.astype(np.uint8), 299, 299) - 128) / 128).mean(axis=(0, 1))
    np.testing.assert_allclose(extractor(picture.astype(np.uint8))[:3], expected, atol=1e-4)
    assert "TorchScript" in extractor.described
    torch.jit.script(_Pooled()).save(str(file))
    with pytest.raises(ValueError, match="not the TorchScript of Inception"):
        open_extractor(ExtractorChoice(weights=file, allows_torchscript=True))


def test_missing_weights_and_unknown_extractors(tmp_path, monkeypatch):
    monkeypatch.setenv(INCEPTION_PLACE, str(tmp_path))
    for choice, kind, names in (
        (ExtractorChoice(), FileNotFoundError, "pt_inception-2015-12-05.*pixels16"),
        (ExtractorChoice(weights=tmp_path / "nothing.pth"), FileNotFoundError, "nothing.pth"),
        (ExtractorChoice(name="fid"), ValueError, "'fid'.*inception, pixels16"),
        (ExtractorChoice(name="pixels16", weights=tmp_path), ValueError, "pixels16"),
    ):
        with pytest.raises(kind, match=names):
            open_extractor(choice)
