"""Networks of one level in place of `tiny`, where torch is there."""

import importlib.util

import pytest


@pytest.fixture
def small_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    if importlib.util.find_spec("torch") is None:
        pytest.skip("needs torch")
    from gsrain_engine.appearance.cyclegan_turbo.model import ARCHITECTURES
    from gsrain_engine.appearance.finetune import run as start

    from .small_training import small

    monkeypatch.setattr(start, "tiny", small)
    monkeypatch.setitem(ARCHITECTURES, "tiny", small)
