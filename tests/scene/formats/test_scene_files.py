"""Any file or folder in, any out: names choose the format, and a failure leaves what was there."""

import os
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats.registry import read_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.open import scene_hash
from gsrain_engine.scene.scene import Layer, Scene

from .sample_files import assert_equal, sample_gaussians, written

PLAYBOT = "scenes/playbot/playbot_lod3_31k_sh2"
WRITTEN = [".ply", ".splat", ".spz"]


def single(gaussians: Gaussians) -> Scene:
    return Scene("a", (Layer("a", gaussians),), up=(0.0, -1.0, 0.0))


@pytest.mark.parametrize(
    ("file", "name"),
    [
        (f"{PLAYBOT}.ply", "playbot_lod3_31k_sh2"),
        (f"{PLAYBOT}.compressed.ply", "playbot_lod3_31k_sh2"),
        (f"{PLAYBOT}.v4.spz", "playbot_lod3_31k_sh2.v4"),
        ("scenes/minimal/minimal.ksplat", "minimal"),
    ],
)
def test_a_single_file_becomes_one_layer_that_stands_upright(file: str, name: str, test_data: Path) -> None:
    scene = read_scene(test_data / file)
    (layer,) = scene.layers
    assert (scene.name, layer.name, layer.kind, layer.visible) == (name, name, "background", True)
    assert (scene.up, scene.metres_per_unit, scene.actors) == ((0.0, -1.0, 0.0), 1.0, ())
    (part,) = scene.parts()
    np.testing.assert_allclose(part.gaussians.means @ part.to_world[2, :3], -part.gaussians.means[:, 1])


def test_a_sog_folder_is_read_as_its_zip_file(test_data: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(test_data / f"{PLAYBOT}.sog") as archive:
        archive.extractall(tmp_path / "bot")
    expected = read_gaussians(test_data / f"{PLAYBOT}.sog")
    for path in (tmp_path / "bot", tmp_path / "bot" / "meta.json"):
        scene = read_scene(path)
        assert scene.name == "bot"
        assert_equal(scene.layers[0].gaussians, expected)


@pytest.mark.parametrize("suffix", [*WRITTEN, ".PLY", ""])
def test_every_format_that_is_written_is_read(suffix: str, tmp_path: Path) -> None:
    gaussians = sample_gaussians(sh_degree=0)
    target = tmp_path / "new" / "folder" / f"scene{suffix}"
    write_scene(single(gaussians), str(target))
    (layer,) = read_scene(str(target)).layers
    np.testing.assert_allclose(layer.gaussians.means, gaussians.means, atol=1e-4)
    if suffix == ".ply":
        write_scene(read_scene(target), tmp_path / "b.ply")
        assert_equal(read_scene(tmp_path / "b.ply").layers[0].gaussians, layer.gaussians, rtol=1e-6)


def test_a_name_that_is_no_unicode_can_be_saved(tmp_path: Path) -> None:
    path = tmp_path / "r\udcfcck.ply"
    try:
        write_scene(single(sample_gaussians(3)), path)
    except (OSError, UnicodeError):
        pytest.skip("this file system takes Unicode names only")
    write_scene(read_scene(path), tmp_path / "saved")
    assert read_scene(tmp_path / "saved").layers[0].name == "r?ck"


# What is refused


@pytest.mark.parametrize("name", ["a.obj", "meta.json", "a.spalt"])
def test_formats_that_are_not_written_are_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match=rf"{name}: .*must end in \.compressed\.ply, \.ply, \.splat,? ") as error:
        write_scene(single(sample_gaussians(3)), tmp_path / name)
    assert ("did you mean .splat?" in str(error.value)) == (name == "a.spalt")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("Stret.ply", r"no such file or folder \(did you mean street\.ply\?\)$"),
        ("street.pyl", r"must end in .*\(did you mean \.ply\?\)$"),
        ("a.obj", r"must end in \.compressed\.ply, \.ply, .*\.sog.*meta\.json"),
        ("none", "no such file or folder$"),
        ("rainy.splat", "no such file or folder$"),
        ("none/scene.json", "no such file or folder$"),
        ("pipe.ply", "not a file"),
        ("photos", r"scene\.json .* \(its meta\.json is none of SOG.*\); give one of the files in it: a\.ply$"),
    ],
)
def test_names_of_no_scene_are_refused(name: str, problem: str, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for file in ("street.ply", "street.pyl", "a.obj", "photos/a.ply", "photos/meta.json", ".rainy.splat.lock"):
        (tmp_path / file).write_bytes(b"v 0 0 0")
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(SceneFormatError, match=rf"{name}: .*{problem}"):
        read_scene(tmp_path / name)


@pytest.mark.parametrize("file", ["a.ply", "a.splat", "a.spz", "a.ksplat", "a.sog", "saved"])
def test_what_the_system_refuses_to_open_is_named(file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_scene(single(sample_gaussians(3)), tmp_path / "saved")
    if file != "saved":
        (tmp_path / file).write_bytes(bytes(64))
    real = os.open

    def locked(path: object, *arguments: Any, **options: Any) -> Any:
        if Path(str(path)).is_relative_to(tmp_path):  # permissions do not stop root, under whom tests may run
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, *arguments, **options)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(os, "open", locked)
    with pytest.raises(SceneFormatError, match="Permission denied$") as error:
        read_scene(tmp_path / file)
    assert str(error.value).startswith(str(tmp_path / file))


@pytest.mark.parametrize(
    ("suffix", "scale", "reach", "error", "problem"),
    [
        *((suffix, np.inf, 1, SceneFormatError, "3 of 3 Gaussians have a scale") for suffix in WRITTEN),
        (".spz", 1, 1e8, SceneFormatError, "SPZ holds means"),
        *((suffix, 1, 1, OSError, "No space left") for suffix in WRITTEN),
    ],
)
def test_a_failure_leaves_the_old_file(
    suffix: str, scale: float, reach: float, error: type[Exception], problem: str, tmp_path: Path
) -> None:
    path, some = tmp_path / f"a{suffix}", sample_gaussians(3)
    write_scene(single(some), path)
    before = path.read_bytes()
    bad = replace(some, means=some.means * np.float32(reach), scales=some.scales * np.float32(scale))
    full = OSError(28, "No space left on device") if error is OSError else None
    with patch("os.fsync", side_effect=full), pytest.raises(error, match=problem) as raised:
        write_scene(single(bad), path)
    assert f"a{suffix}: " in str(raised.value) or f"a{suffix}'" in str(raised.value)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_a_splat_of_nothing_or_over_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match="at least one Gaussian"):
        write_scene(Scene("a"), tmp_path / "a.splat")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "folder.ply" / "a").write_bytes(b"")
    with pytest.raises(SceneFormatError, match=r"no scene\.json"):
        write_scene(single(sample_gaussians(3)), tmp_path / "folder.ply")


def test_the_last_iteration_of_a_training_is_read_from_its_folder(tmp_path: Path) -> None:
    expected = sample_gaussians(30, seed=2)
    for number, gaussians in ((7000, sample_gaussians(20)), (30000, expected)):
        place = tmp_path / f"garden/point_cloud/iteration_{number}"
        place.mkdir(parents=True)
        (place / "point_cloud.ply").write_bytes(written(gaussians, ".ply"))
    (tmp_path / "garden/cfg_args").write_text("Namespace(sh_degree=3)")
    scene = read_scene(tmp_path / "garden")
    assert scene.name == "garden" and scene.up_is_assumed
    assert_equal(scene.layers[0].gaussians, expected)
    before = scene_hash(str(tmp_path / "garden"))
    (tmp_path / "garden/point_cloud/iteration_7000/point_cloud.ply").unlink()
    assert scene_hash(str(tmp_path / "garden")) == before
