"""Rows of the table: weights of the transfer model, and how far a training has come; torch and diffusers read them."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from .containers import inside_zip
from .mutations import damaged_bytes
from .reader import Reader


def _weights() -> Any:
    return import_module("gsrain_engine.appearance.cyclegan_turbo.weights")


def _models() -> Any:
    return import_module("tests.appearance.cyclegan_turbo.published_checkpoints")


def _published(folder: Path) -> Path:
    models = _models()
    import_module("torch").save(models.published(models.trained_model()), folder / "clear2rainy.pkl")
    return folder / "clear2rainy.pkl"


def _own(folder: Path) -> Path:
    _weights().save_weights(_models().trained_model(), folder / "own.safetensors")
    return folder / "own.safetensors"


def _into_a_model() -> Callable[[Path], None]:
    model: list[Any] = []

    def read(path: Path) -> None:
        if not model:
            model.append(_models().untrained())
        file = _weights().open_weights(path)
        assert (
            file.takes_guides in (True, False)
            and (file.random_base_seed or 0) >= 0
            and isinstance(file.architecture, str)
        )
        file.delta(model[0])

    return read


def _state(folder: Path) -> Path:
    arrays = {"a": import_module("torch").arange(4.0)}
    _finetuning().CHECKPOINTS.write(folder / "state.safetensors", _header(), arrays)
    return folder / "state.safetensors"


def _read_state(path: Path) -> None:
    _finetuning().CHECKPOINTS.resume(path, _header(), dict)


def _finetuning() -> Any:
    return import_module("gsrain_engine.appearance.finetune.run")


def _header() -> Any:
    settings = import_module("gsrain_engine.appearance.finetune.settings").load_finetuning("tiny")
    return _finetuning().FinetuneHeader(step=3, seconds=1.5, perceptual=False, pictures="two", settings=settings)


_BYTES, _ZIP = (("*", damaged_bytes),), (("*", inside_zip(lambda _: damaged_bytes)),)

TURBO_READERS = (
    Reader("transfer-published", _published, _into_a_model(), ValueError, _ZIP, tries=8),
    Reader("transfer-own", _own, _into_a_model(), ValueError, _BYTES, tries=20),
    Reader("transfer-state", _state, _read_state, ValueError, _BYTES, tries=20),
)
"""Transfers, and what looks at them."""
