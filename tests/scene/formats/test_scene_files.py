"""Any file or folder in, any out: names choose the format, and a failure leaves what was there."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.registry import FORMATS
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.sog import read_sog
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene

from .sample_gaussians import assert_equal, sample_gaussians

PLAYBOT = "scenes/playbot/playbot_lod3_31k_sh2"


def single(gaussians: Gaussians) -> Scene:
    return Scene("a", (Layer("a", gaussians),), up=(0.0, -1.0, 0.0))


@pytest.mark.parametrize(
    ("file", "name", "count"),
    [
        (f"{PLAYBOT}.ply", "playbot_lod3_31k_sh2", 31000),
        (f"{PLAYBOT}.compressed.ply", "playbot_lod3_31k_sh2", 31000),
        (f"{PLAYBOT}.sog", "playbot_lod3_31k_sh2", 31000),
        (f"{PLAYBOT}.v4.spz", "playbot_lod3_31k_sh2.v4", 31000),
        ("scenes/plant.splat", "plant", 113648),
        ("scenes/minimal/minimal.ksplat", "minimal", 4),
    ],
)
def test_a_single_file_becomes_one_layer(file: str, name: str, count: int, test_data: Path) -> None:
    scene = read_scene(test_data / file)
    (layer,) = scene.layers
    assert (scene.name, layer.name, layer.kind, layer.visible) == (name, name, "background", True)
    assert len(layer.gaussians) == count
    assert (scene.up, scene.metres_per_unit, scene.actors) == ((0.0, -1.0, 0.0), 1.0, ())


def test_an_upright_capture_stands_in_the_world(test_data: Path) -> None:
    # The pot of the plant is at the bottom, and wide; -y is up in the file.
    (part,) = read_scene(test_data / "scenes/plant.splat").parts()
    up = part.gaussians.means @ part.to_world[2, :3]
    np.testing.assert_allclose(up, -part.gaussians.means[:, 1])


def test_a_sog_folder_is_read_as_its_zip_file(test_data: Path, tmp_path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(test_data / f"{PLAYBOT}.sog") as archive:
        archive.extractall(tmp_path / "bot")
    expected = read_sog(test_data / f"{PLAYBOT}.sog")
    for path in (tmp_path / "bot", tmp_path / "bot" / "meta.json"):
        scene = read_scene(path)
        assert scene.name == "bot"
        assert_equal(scene.layers[0].gaussians, expected)


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz", ""])
def test_every_format_that_is_written_is_read(suffix: str, tmp_path: Path) -> None:
    gaussians = sample_gaussians(sh_degree=0)
    target = tmp_path / "new" / "folder" / f"scene{suffix}"
    write_scene(single(gaussians), str(target))
    (layer,) = read_scene(str(target)).layers
    np.testing.assert_allclose(layer.gaussians.means, gaussians.means, atol=1e-4)
    np.testing.assert_allclose(np.log(layer.gaussians.scales), np.log(gaussians.scales), atol=0.04)
    np.testing.assert_allclose(layer.gaussians.opacities, gaussians.opacities, atol=0.003)


def test_conversion_keeps_a_plain_file_to_the_bit(tmp_path: Path) -> None:
    write_scene(single(sample_gaussians()), tmp_path / "a.ply")
    write_scene(read_scene(tmp_path / "a.ply"), tmp_path / "b.ply")
    a, b = (read_scene(tmp_path / name).layers[0].gaussians for name in ("a.ply", "b.ply"))
    assert_equal(b, a, rtol=1e-6)


def test_the_suffix_may_be_in_capitals(tmp_path: Path) -> None:
    write_scene(single(sample_gaussians(3)), tmp_path / "A.PLY")
    assert (tmp_path / "A.PLY").read_bytes().startswith(b"ply\n")
    assert read_scene(tmp_path / "A.PLY").name == "A"


@pytest.mark.parametrize("name", ["a.obj", "a.compressed.ply", "a.ksplat", "a.sog"])
def test_formats_that_are_not_written_are_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(
        SceneFormatError,
        match=r"a(\.obj: can't be|.* is read but not) written: the name must end in \.ply, \.splat or \.spz$",
    ):
        write_scene(single(sample_gaussians(3)), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_unknown_files_are_refused_with_what_is_known(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0")
    with pytest.raises(SceneFormatError, match=r"must end in \.compressed\.ply, \.ply, .*\.sog or meta\.json"):
        read_scene(tmp_path / "a.obj")


def test_slips_of_the_hand_are_pointed_out(tmp_path: Path) -> None:
    (tmp_path / "street.ply").write_bytes(b"")
    (tmp_path / "street.pyl").write_bytes(b"")
    with pytest.raises(SceneFormatError, match=r"no such file or folder \(did you mean street\.ply\?\)$"):
        read_scene(tmp_path / "Stret.ply")
    with pytest.raises(SceneFormatError, match=r"or meta\.json \(did you mean \.ply\?\)$"):
        read_scene(tmp_path / "street.pyl")
    with pytest.raises(SceneFormatError, match=r"a\.spalt: can't be written: .* or \.spz \(did you mean \.splat\?\)$"):
        write_scene(single(sample_gaussians(3)), tmp_path / "a.spalt")


@pytest.mark.parametrize("file", ["a.ply", "a.splat", "a.spz", "a.ksplat", "a.sog", "saved"])
def test_what_the_system_refuses_to_open_is_one_line(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(single(sample_gaussians(3)), tmp_path / "saved")
    if file != "saved":
        (tmp_path / file).write_bytes(bytes(64))
    real = os.open

    def locked(path: object, *arguments: Any, **options: Any) -> Any:
        if Path(str(path)).is_relative_to(tmp_path):  # permissions do not stop root, under whom tests may run
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, *arguments, **options)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(os, "open", locked)
    with pytest.raises(SceneFormatError, match="can't be read: Permission denied$") as error:
        read_scene(tmp_path / file)
    assert str(error.value).startswith(str(tmp_path / file))


def test_a_name_that_is_no_unicode_can_be_saved(tmp_path: Path) -> None:
    path = tmp_path / "r\udcfcck.ply"
    try:
        write_scene(single(sample_gaussians(3)), path)
    except (OSError, UnicodeError):
        pytest.skip("this file system takes Unicode names only")
    write_scene(read_scene(path), tmp_path / "saved")
    assert read_scene(tmp_path / "saved").layers[0].name == "r?ck"


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz"])
def test_values_that_could_not_be_read_again_replace_nothing(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    write_scene(single(sample_gaussians(3)), path)
    before = path.read_bytes()
    some = sample_gaussians(3)
    bad = Gaussians(some.means, some.scales * np.float32(np.inf), some.quaternions, some.opacities, some.sh)
    with pytest.raises(
        SceneFormatError, match=f"a\\{suffix}: 3 of 3 Gaussians have a scale that is not a finite number"
    ):
        write_scene(single(bad), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_splat_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match="at least one Gaussian; there is none to write"):
        write_scene(Scene("a"), tmp_path / "a.splat")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    for name in ("none.ply", "none", "none.obj", "none/scene.json"):
        with pytest.raises(SceneFormatError, match=f"{name}: there is no such file or folder$"):
            read_scene(tmp_path / name)
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(SceneFormatError, match="not a file"):
        read_scene(tmp_path / "pipe.ply")
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "folder.ply" / "a").write_bytes(b"")
    with pytest.raises(SceneFormatError, match=r"no scene\.json"):
        write_scene(single(sample_gaussians(3)), tmp_path / "folder.ply")


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz"])
def test_a_failure_leaves_the_old_file(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / f"a{suffix}"
    write_scene(single(sample_gaussians(3)), path)
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            write_scene(single(sample_gaussians(4)), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_format_cannot_hold_is_refused_and_the_old_file_stays(tmp_path: Path) -> None:
    some = sample_gaussians(3)
    write_scene(single(some), tmp_path / "a.spz")
    before = (tmp_path / "a.spz").read_bytes()
    far = Gaussians(some.means * 1e8, some.scales, some.quaternions, some.opacities, some.sh)
    with pytest.raises(SceneFormatError, match=r"a\.spz: SPZ holds means up to"):
        write_scene(single(far), tmp_path / "a.spz")
    assert (tmp_path / "a.spz").read_bytes() == before


def test_every_row_of_the_table_describes_itself() -> None:
    assert len({row.suffix for row in FORMATS}) == len(FORMATS)
    for row in FORMATS:
        assert row.suffix == row.suffix.lower() and row.description and row.read.__doc__
