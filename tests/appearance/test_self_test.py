"""The self-test of published weights: a stand-in of the same layout, with its own result as the authors'."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

torch = pytest.importorskip("torch")
pytest.importorskip("diffusers")
pytest.importorskip("peft")

from app.main import run  # noqa: E402
from gsrain_engine.appearance import self_test  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo import translator  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.weights import PUBLISHED  # noqa: E402


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """An image and the result of a model of the published layout, which the self-test then opens."""
    weights = tmp_path / "clear2rainy.pkl"
    weights.touch()
    model = build_random_model(tiny(), normals=False, seed=2)
    model.record = PUBLISHED
    monkeypatch.setattr(self_test, "find_transfer_weights", lambda: weights)
    monkeypatch.setattr(translator, "open_model", lambda *_, **__: model)
    blocks = np.kron(np.random.default_rng(1).random((6, 9, 3)), np.ones((10, 10, 1)))
    Image.fromarray((255 * blocks).astype(np.uint8)).save(tmp_path / "in.png")
    Image.fromarray((255 * blocks).astype(np.uint8)).save(tmp_path / "out.png")
    made, _ = self_test.transferred_pair(weights, tmp_path / "in.png", tmp_path / "out.png")
    Image.fromarray(made).save(tmp_path / "out.png")
    return tmp_path / "in.png", tmp_path / "out.png"


def outcome_of(pair: tuple[Path, Path], folder: Path) -> tuple[int, dict]:
    code = run(["doctor", "--self-test", "--pair", *map(str, pair), "--json", str(folder / "doctor.json")])
    (first, *_) = json.loads((folder / "doctor.json").read_text())["self_test"]
    return code, first


def test_the_authors_own_result_passes_and_another_does_not(pair, tmp_path) -> None:
    code, found = outcome_of(pair, tmp_path)
    assert (found["model"], found["passed"]) == ("clear2rainy", True) and found["psnr_db"] > 60
    with Image.open(pair[1]) as image:
        changed = np.asarray(image).copy()
    changed[:30] = 255 - changed[:30]
    Image.fromarray(changed).save(pair[1])
    assert code == 0
    code, found = outcome_of(pair, tmp_path)
    assert (code, found["passed"]) == (1, False) and 0 < found["psnr_db"] < 35


def test_without_weights_or_pair_it_says_what_to_get(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.delenv(self_test.TEST_DATA, raising=False)
    assert run(["doctor", "--self-test", "--json", str(tmp_path / "doctor.json")]) == 0
    rows = json.loads((tmp_path / "doctor.json").read_text())["self_test"]
    assert [row["model"] for row in rows] == ["clear2rainy", "DSINE", "Inception", "detectors"]
    assert all(row["passed"] is None for row in rows) and "--pair IN OUT" in capsys.readouterr().out
    assert run(["doctor", "--pair", "a", "b"]) == 2
