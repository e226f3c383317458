"""Stills of the saved scene are what they were: to the byte where they were made, elsewhere within 60 dB."""

import json

import numpy as np
import pytest

from app.main import run

from .cases import CROSSING, stills
from .digests import pixels_of
from .machine import machine
from .run import HERE, copy_saved, results_of

GOLDEN = json.loads((HERE / "hashes.json").read_text(encoding="utf-8"))
LEAST_DB = 60.0


@pytest.fixture(scope="module")
def is_same_machine():
    return machine() == GOLDEN["machine"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("golden")
    copy_saved(folder)
    return folder


@pytest.mark.parametrize("case", stills("crossing", CROSSING), ids=lambda case: case.name)
def test_a_still_is_what_it_was(case, folder, is_same_machine, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert run(case.command.split()) == 0, capsys.readouterr().err
    if is_same_machine:
        found = results_of(case, folder)
        assert found == {name: GOLDEN["hashes"][name] for name in found}
    file = f"{case.name.rpartition('/')[2]}.png"
    assert psnr_db(pixels_of(folder / "still" / file), pixels_of(HERE / "pictures" / file)) >= LEAST_DB


def psnr_db(pixels, golden):
    """Peak signal-to-noise ratio of two pictures of 8 bits, in dB."""
    error = np.mean((pixels.astype(np.float64) - golden) ** 2)
    return np.inf if error == 0 else 10 * np.log10(255**2 / error)
