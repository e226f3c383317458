"""Extractors: each under its own name, with the right weights and no others."""

from importlib.util import find_spec

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.evaluation.fid import EXTRACTORS, open_extractor  # noqa: E402
from gsrain_engine.evaluation.fid_features import ExtractorChoice, resized  # noqa: E402
from gsrain_engine.evaluation.fid_torch_features import (  # noqa: E402
    INCEPTION_PLACE,
    Inception,
    build_with_weights,
    inception_weights,
    is_torchscript,
    matched_inception,
)
from gsrain_engine.evaluation.lpips_weights import read_arrays  # noqa: E402

from .random_networks import write_inception  # noqa: E402


@pytest.fixture(scope="module")
def inception_file(tmp_path_factory):
    return write_inception(tmp_path_factory.mktemp("weights") / "inception.safetensors")


@pytest.fixture(scope="module")
def picture():
    y, x = np.mgrid[0:299, 0:299]
    return np.stack([x * 0.8, y * 0.8, (x + y) % 256], axis=2).astype(np.uint8)


def test_inception_gives_what_the_network_of_fid_gives(inception_file):
    """Numbers of pytorch-fid's own InceptionV3 with these weights and this picture: once, every bit was the same."""
    network = build_with_weights(Inception, inception_weights(inception_file))
    y, x = np.mgrid[0:299, 0:299]
    picture = np.stack([x * 0.8, y * 0.8, (x + y) % 256], axis=2).astype(np.float32)
    found = network(torch.from_numpy(picture).permute(2, 0, 1)[None])[0].numpy()
    np.testing.assert_allclose(found[[0, 500, 1500, 2047]], (1.460849, 0, 0.9803747, 0.04222643), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose((found.mean(), found.std()), (4.257572, 5.851245), rtol=1e-4)


def test_only_inception_is_called_fid(inception_file, picture, monkeypatch):
    monkeypatch.setenv(INCEPTION_PLACE, str(inception_file.parent))
    extractor = open_extractor(ExtractorChoice())
    assert extractor.metric == "FID"
    assert extractor.described.startswith("Inception-v3 of 2015 (weights ")
    assert "published" not in extractor.described  # random numbers are not what pytorch-fid publishes
    assert extractor.key is not None
    features = extractor(picture[:100])
    assert (features.shape, features.dtype) == ((2048,), np.float32)
    pixels = open_extractor(ExtractorChoice(name="pixels16"))
    assert (pixels.metric, pixels.features) == ("FD-pixels16", 160)
    assert next(iter(EXTRACTORS)) == "inception"


def test_nothing_here_needs_torchvision():
    """Its builds are bound to single builds of torch, and peft looks for it when it is there."""
    assert find_spec("torchvision") is None


def test_wrong_weights_are_reported(inception_file, tmp_path):
    arrays = read_arrays(inception_file)

    def said(changed):
        with pytest.raises(ValueError, match="other: ") as caught:
            matched_inception(changed, "other")
        return str(caught.value)

    assert "Inception of 1000 classes, such as torchvision's" in said(
        {**arrays, "fc.weight": np.zeros((1000, 2048), np.float32)}
    )
    name = "Mixed_6d.branch7x7_2.conv.weight"
    assert f"{name} is missing" in said({key: each for key, each in arrays.items() if key != name})
    assert f"{name} is (160, 160, 7, 1), expected (160, 160, 1, 7)" in said(
        {**arrays, name: arrays[name].transpose(0, 1, 3, 2)}
    )
    assert "Inception with AuxLogits" in said({**arrays, "AuxLogits.conv0.bn.bias": np.zeros(3, np.float32)})
    assert "it has no Mixed_8a.bn.bias" in said({**arrays, "Mixed_8a.bn.bias": np.zeros(3, np.float32)})
    with pytest.raises(FileNotFoundError, match="nothing.pth: no such file"):
        open_extractor(ExtractorChoice(weights=tmp_path / "nothing.pth"))


def test_torchs_own_file_gives_the_same_arrays(inception_file, tmp_path):
    arrays = read_arrays(inception_file)
    torch.save({name: torch.from_numpy(array) for name, array in arrays.items()}, tmp_path / "inception.pth")
    assert not is_torchscript(tmp_path / "inception.pth")
    again = inception_weights(tmp_path / "inception.pth")
    assert set(again) == set(arrays) - {"fc.weight"}
    assert all(np.array_equal(again[name], arrays[name]) for name in again)


class _Pooled(torch.nn.Module):
    def forward(self, pictures):
        return pictures.mean(dim=(2, 3)).repeat(1, 683)[:, :2048]


class _Whole(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.layers = _Pooled()

    def forward(self, pictures):
        return self.layers(pictures)


@pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning", "ignore:.*torch.jit.*:FutureWarning")
def test_torchscript_runs_only_where_it_may(tmp_path, picture):
    file = tmp_path / "inception-2015-12-05.pt"
    torch.jit.script(_Whole()).save(str(file))
    assert is_torchscript(file)
    with pytest.raises(ValueError, match="is TorchScript, which brings a program of its own.*--torchscript"):
        open_extractor(ExtractorChoice(weights=file))
    extractor = open_extractor(ExtractorChoice(weights=file, allows_torchscript=True))
    expected = ((resized(picture, 299, 299) - 128) / 128).mean(axis=(0, 1))
    np.testing.assert_allclose(extractor(picture)[:3], expected, atol=1e-4)
    assert "TorchScript" in extractor.described
    torch.jit.script(_Pooled()).save(str(file))
    with pytest.raises(ValueError, match="not the TorchScript of Inception"):
        open_extractor(ExtractorChoice(weights=file, allows_torchscript=True))


def test_what_is_missing_is_said_with_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setenv(INCEPTION_PLACE, str(tmp_path))
    with pytest.raises(FileNotFoundError, match="no weights of Inception.*pt_inception-2015-12-05.*pixels16"):
        open_extractor(ExtractorChoice())
    with pytest.raises(ValueError, match="extractor 'fid': expected one of inception, pixels16"):
        open_extractor(ExtractorChoice(name="fid"))
    with pytest.raises(ValueError, match="pixels16 takes no weights"):
        open_extractor(ExtractorChoice(name="pixels16", weights=tmp_path))
