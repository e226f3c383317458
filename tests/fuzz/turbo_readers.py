"""Rows of the table: weights of the transfer model, and how far a training has come; torch and diffusers read them."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from .mutations import damaged_bytes, inside_zip
from .reader import Reader, one_file


def _weights() -> Any:
    return import_module("gsrain_engine.appearance.cyclegan_turbo.weights")


def _models() -> Any:
    return import_module("tests.appearance.cyclegan_turbo.published_checkpoints")


def _published(path: Path) -> None:
    import_module("torch").save(_models().published(_models().trained_model()), path)


def _own(path: Path) -> None:
    _weights().save_weights(_models().trained_model(), path)


def _into_a_model() -> Callable[[Path], None]:
    model: list[Any] = []

    def read(path: Path) -> None:
        if not model:
            model.append(_models().untrained())
        file = _weights().open_weights(path)
        assert file.takes_guides in (True, False) and isinstance(file.architecture, str)
        assert (file.random_base_seed or 0) >= 0
        file.delta(model[0])

    return read


def _state(path: Path) -> None:
    _finetuning().CHECKPOINTS.write(path, _header(), {"a": import_module("torch").arange(4.0)})


def _read_state(path: Path) -> None:
    _finetuning().CHECKPOINTS.resume(path, _header(), dict)


def _finetuning() -> Any:
    return import_module("gsrain_engine.appearance.finetune.run")


def _header() -> Any:
    settings = import_module("gsrain_engine.appearance.finetune.settings").load_finetuning("tiny")
    return _finetuning().FinetuneHeader(step=3, seconds=1.5, perceptual=False, pictures="two", settings=settings)


_BYTES, _ZIP = (("*", damaged_bytes),), (("*", inside_zip(lambda _: damaged_bytes)),)

TURBO_READERS = (
    Reader("transfer-published", one_file("clear2rainy.pkl", _published), _into_a_model(), ValueError, _ZIP, tries=8),
    Reader(
        "transfer-own",
        one_file("own.safetensors", lambda path: _weights().save_weights(_models().trained_model(), path)),
        _into_a_model(),
        ValueError,
        _BYTES,
        tries=20,
    ),
    Reader("transfer-state", one_file("state.safetensors", _state), _read_state, ValueError, _BYTES, tries=20),
)
"""Transfers, and what looks at them."""
