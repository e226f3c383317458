"""`gsrain doctor` and the files of cyclegan-turbo."""

import json

import pytest

from app import doctor
from gsrain_engine.appearance.cyclegan_turbo import weight_paths
from gsrain_engine.appearance.cyclegan_turbo.model import sd_turbo


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A machine on which nothing lies yet."""
    for variable, folder in (("XDG_DATA_HOME", "data"), ("XDG_CACHE_HOME", "cache"), ("HF_HOME", "hub")):
        monkeypatch.setenv(variable, str(tmp_path / folder))
    for variable in (weight_paths.BASE_VARIABLE, weight_paths.WEIGHTS_VARIABLE, "HF_HUB_CACHE"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


def _lay_down(base, *, width=320):
    first, last = sd_turbo().betas
    unet = dict(sd_turbo().unet) | {"block_out_channels": [width, 640, 1280, 1280]}
    schedule = {"beta_start": first, "beta_end": last, "beta_schedule": "scaled_linear", "prediction_type": "epsilon"}
    for file, fields in (
        ("unet/config.json", unet),
        ("vae/config.json", sd_turbo().vae),
        ("scheduler/scheduler_config.json", schedule),
    ):
        (base / file).parent.mkdir(parents=True, exist_ok=True)
        (base / file).write_text(json.dumps(fields))


def test_what_is_missing_comes_with_how_to_get_it(home):
    base, weights = doctor.find_base_model(), doctor.find_transfer_weights()
    assert not base.found and not weights.found
    assert "hf download stabilityai/sd-turbo" in base.what and str(weight_paths.data_folder() / "sd-turbo") in base.what
    assert weight_paths.PUBLISHED_URL in weights.what and str(weight_paths.data_folder() / "transfer") in weights.what
    assert not doctor.find_text_encoder().found


def test_a_whole_base_of_the_right_architecture_is_found(home, monkeypatch):
    base = home / "sd-turbo"
    monkeypatch.setenv(weight_paths.BASE_VARIABLE, str(base))
    _lay_down(base)
    assert "unet: no weights" in doctor.find_base_model().what
    for part in ("unet", "vae"):
        (base / part / "diffusion_pytorch_model.safetensors").touch()
    assert doctor.find_base_model() == ("SD-Turbo (base of cyclegan-turbo)", True, str(base))
    _lay_down(base, width=128)
    other = doctor.find_base_model()
    assert not other.found
    assert "block_out_channels is [128, 640, 1280, 1280]" in other.what


def test_the_text_encoder_is_needed_once(home, monkeypatch):
    base = home / "sd-turbo"
    monkeypatch.setenv(weight_paths.BASE_VARIABLE, str(base))
    _lay_down(base)
    assert "comes with SD-Turbo" in doctor.find_text_encoder().what
    (base / "tokenizer").mkdir()
    (base / "text_encoder").mkdir()
    (base / "text_encoder" / "config.json").write_text("{}")
    assert doctor.find_text_encoder().what == str(base / "text_encoder")
    weight_paths.captions_file().parent.mkdir(parents=True)
    weight_paths.captions_file().touch()
    assert "captions are kept in" in doctor.find_text_encoder().what


def test_weights_are_named_with_their_size(home):
    folder = weight_paths.data_folder() / "transfer"
    folder.mkdir(parents=True)
    (folder / "clear2rainy.pkl").write_bytes(bytes(3_000_000))
    found = doctor.find_transfer_weights()
    assert found.found
    assert found.what == f"{folder / 'clear2rainy.pkl'} (3 MB)"
