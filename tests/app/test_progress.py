"""Bars that show how far a command is."""

import pytest

from app.console import progress_bar


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """Empty folder for compiled code."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


@pytest.mark.parametrize("draws", [True, False])
def test_the_first_time_it_is_said_that_code_is_compiled(draws, kernels, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich's name for a terminal
    with progress_bar("Rendering", 2, draws=draws) as advance:
        advance()
    assert ("code for its processor is compiled" in capsys.readouterr().err) == draws
    (kernels / "raster").mkdir()
    (kernels / "raster" / "tiles.count.nbi").touch()
    with progress_bar("Rendering", 2, draws=draws) as advance:
        advance()
    assert "compiled" not in capsys.readouterr().err


def test_files_get_no_word_of_compiling(kernels, capsys):
    with progress_bar("Rendering", 1, draws=True):
        pass
    assert "compiled" not in capsys.readouterr().err
