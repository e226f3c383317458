"""Links in scene folders: they are followed, and saving never touches what they lead to."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache, write_scene_folder
from gsrain_engine.scene.scene import Layer

from .sample_gaussians import assert_equal, sample_gaussians
from .test_scene_folder import folder as folder  # a fixture
from .test_scene_folder import sample_scene


@pytest.fixture
def far(folder: Path, tmp_path: Path) -> Path:
    """The file of the first layer, moved elsewhere; a link stands in its place."""
    file = next((folder / "layers").glob("000-*.ply"))
    far = tmp_path / "another disk" / "big.ply"
    far.parent.mkdir()
    shutil.move(file, far)
    file.symlink_to(far)
    return far


def test_a_file_elsewhere_is_read_through_its_link(folder: Path, far: Path) -> None:
    scene = read_scene(folder)
    assert_equal(scene.layers[0].gaussians, sample_scene().layers[0].gaussians)


def test_saving_leaves_what_a_link_leads_to(folder: Path, far: Path) -> None:
    before = far.read_bytes()
    scene = read_scene(folder)
    write_scene(replace(scene, layers=(Layer("road & kerb", sample_gaussians(9, seed=4)), *scene.layers[1:])), folder)
    assert far.read_bytes() == before
    assert not [file for file in (folder / "layers").iterdir() if file.is_symlink()]  # the link itself went
    assert len(read_scene(folder).layers[0].gaussians) == 9


def test_what_has_not_changed_stays_a_link(folder: Path, far: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    write_scene(replace(scene, name="renamed"), folder, known)
    assert next((folder / "layers").glob("000-*.ply")).resolve() == far
    assert read_scene(folder).name == "renamed"


def test_an_autosave_beside_it_does_not_depend_on_the_link(folder: Path, far: Path, tmp_path: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    write_scene_folder(scene, tmp_path / "kept", known, linking=True)
    shutil.rmtree(folder)
    assert_equal(read_scene(tmp_path / "kept").layers[0].gaussians, scene.layers[0].gaussians)
    assert not [file for file in (tmp_path / "kept").rglob("*") if file.is_symlink()]


def test_on_a_disk_without_second_names_an_autosave_is_a_copy(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    known = FileCache()
    scene = read_scene(folder, known)
    monkeypatch.setattr(os, "link", refused)
    write_scene_folder(scene, tmp_path / "kept", known, linking=True)
    for file in (folder / "layers").glob("*.ply"):
        copy = tmp_path / "kept/layers" / file.name
        assert copy.read_bytes() == file.read_bytes() and not copy.samefile(file)


def test_what_a_killed_autosave_left_is_not_written_through(folder: Path, tmp_path: Path) -> None:
    """Its unfinished file may be another name of one that is whole."""
    known = FileCache()
    scene = read_scene(folder, known)
    whole = {file.read_bytes(): file for file in sorted((folder / "layers").glob("*.ply"))}
    first, other = list(whole.values())[:2]
    write_scene_folder(replace(scene, layers=()), tmp_path / "kept")
    (tmp_path / "kept/layers").mkdir(exist_ok=True)
    label = first.name.removeprefix("000-").rpartition("-")[0]
    os.link(other, tmp_path / f"kept/layers/.000-{label}.part")
    write_scene_folder(scene, tmp_path / "kept", known, linking=True)
    assert set(whole) == {file.read_bytes() for file in whole.values()}
    assert_equal(read_scene(tmp_path / "kept").layers[0].gaussians, scene.layers[0].gaussians)


def test_scenes_that_share_a_linked_folder_leave_each_others_files(folder: Path, tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shutil.move(folder / "layers", shared)
    (folder / "layers").symlink_to(shared)
    before = {file.name for file in shared.iterdir()}
    scene = read_scene(folder)
    write_scene(replace(scene, layers=(Layer("other", sample_gaussians(5, seed=8)),)), folder)
    assert before < {file.name for file in shared.iterdir()}
    assert [layer.name for layer in read_scene(folder).layers] == ["other"]


def test_links_that_lead_nowhere_or_in_a_circle_are_refused(folder: Path, far: Path) -> None:
    far.unlink()
    with pytest.raises(SceneFormatError, match=r"scene\.json: there is no file 'layers/000-.*a link to .*big\.ply"):
        read_scene(folder)
    link = next((folder / "layers").glob("000-*.ply"))
    link.unlink()
    link.symlink_to(link.name)
    with pytest.raises(SceneFormatError, match=r"scene\.json: there is no file 'layers/000-"):
        read_scene(folder)


def test_what_is_no_file_is_not_waited_for(folder: Path) -> None:
    file = next((folder / "layers").glob("000-*.ply"))
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(SceneFormatError, match=r"scene\.json: there is no file 'layers/000-"):
        read_scene(folder)


@pytest.mark.parametrize(
    "name", ["x" * 300 + ".ply", "layers/\u00e9\u2028.ply", ".", "layers", "layers/../scene.json/x.ply"]
)
def test_names_that_no_file_has_are_refused(name: str, folder: Path) -> None:
    text = (folder / "scene.json").read_text()
    file = next((folder / "layers").glob("000-*.ply"))
    (folder / "scene.json").write_text(text.replace(f"layers/{file.name}", name))
    with pytest.raises(SceneFormatError, match=r"scene\.json: "):
        read_scene(folder)
