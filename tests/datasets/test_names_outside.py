"""Files of captures that name files outside of the capture's folder: refused, unless a person allows it."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from colmap_files import write_binary, write_pictures, write_text
from datasets.test_capture_folder import views
from datasets.test_dgp import write_dgp
from datasets.test_nerfstudio import INTRINSICS, opengl_pose
from datasets.test_nuscenes import write_nuscenes, write_tables
from datasets.test_nuscenes_infos import write_infos
from gsrain_engine.datasets.capture import Capture, CaptureError, OutsideError
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.open_capture import open_capture
from mini_drive import MiniDrive


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder for a capture, and a person's own picture beside it."""
    (tmp_path / "capture").mkdir()
    Image.new("RGB", (64, 48), (250, 10, 10)).save(tmp_path / "secret.png")
    return tmp_path / "capture"


def nerfstudio(folder: Path, name: str) -> None:
    frames = [{"file_path": each, "transform_matrix": opengl_pose([1.0, 2.0, 3.0])} for each in ("a.png", name)]
    write_pictures(folder, ("a.png",))
    (folder / "transforms.json").write_text(json.dumps({**INTRINSICS, "frames": frames}))


def colmap(folder: Path, name: str) -> None:
    write_binary(folder / "sparse" / "0", ("a.png", name))
    write_pictures(folder / "images", ("a.png",))


def colmap_text(folder: Path, name: str) -> None:
    write_text(folder / "sparse", ("a.png", name))
    write_pictures(folder / "images", ("a.png",))


@pytest.mark.parametrize(("write", "up"), [(nerfstudio, "../"), (colmap, "../../"), (colmap_text, "../../")])
@pytest.mark.parametrize("kind", ["absolute", "dots", "link"])
def test_pictures_elsewhere_are_refused_unless_allowed(
    place: Path, write: Callable[[Path, str], None], up: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    secret = place.parent / "secret.png"
    name = {"absolute": str(secret), "dots": f"{up}secret.png", "link": "b.png"}[kind]
    write(place, name)
    if kind == "link":
        pictures = place if write is nerfstudio else place / "images"
        (pictures / "b.png").symlink_to(secret)
    with pytest.raises(OutsideError, match="leads out of .*--allow-outside"):
        open_capture(place)
    assert run(["info", str(place)]) == BAD_INPUT
    told = capsys.readouterr().err
    assert name in told and told.count("\n") == 1
    capture = open_capture(place, allow_outside=True)
    assert len(capture) == 2 and any(view.image[0, 0].tolist() == [250, 10, 10] for view in capture)
    assert run(["info", str(place), "--allow-outside"]) == 0
    assert run(["info", str(place)]) == BAD_INPUT, "what one command allows ends with it"


@pytest.mark.parametrize("field", ["mask_path", "depth_file_path", "ply_file_path"])
def test_nerfstudio_s_other_files_are_looked_at_too(place: Path, field: str) -> None:
    nerfstudio(place, "a.png")
    file = place / "transforms.json"
    values = json.loads(file.read_text())
    (values if field == "ply_file_path" else values["frames"][0])[field] = "../secret.png"
    file.write_text(json.dumps(values))
    with pytest.raises(OutsideError, match="secret.png"):
        open_capture(place)


def test_names_that_come_back_into_the_folder_are_fine(place: Path) -> None:
    nerfstudio(place, "images/../b.png")
    write_pictures(place, ("b.png",))
    (place / "images").mkdir()
    assert len(open_capture(place)) == 2
    (place.parent / "link").symlink_to(place)
    assert len(open_capture(place.parent / "link")) == 2, "the capture itself may be reached through a link"


def test_a_folder_of_pictures_behind_a_link_is_refused(place: Path) -> None:
    colmap(place, "a.png")
    (place / "images").rename(place.parent / "photos")
    (place / "images").symlink_to(place.parent / "photos")
    with pytest.raises(OutsideError, match="images"):
        open_capture(place)
    assert len(open_capture(place, allow_outside=True)) == 2


def test_masks_behind_links_are_refused(place: Path) -> None:
    colmap(place, "b.png")
    write_pictures(place / "images", ("b.png",))
    (place / "masks").mkdir()
    (place / "masks" / "a.png.png").symlink_to(place.parent / "secret.png")
    with pytest.raises(OutsideError, match="masks"):
        open_capture(place)


def test_our_own_folder(place: Path) -> None:
    list(write_views(place, views()))
    rows = json.loads((place / "cameras.json").read_text())
    rows[1]["name"] = "../secret"
    (place / "cameras.json").write_text(json.dumps(rows))
    with pytest.raises(OutsideError, match="secret"):
        open_capture(place)


@pytest.mark.parametrize("named", ["picture", "cloud", "boxes", "calibration", "ontology", "scene"])
def test_dgp(place: Path, named: str) -> None:
    file = write_dgp(place, MiniDrive())
    values, out = json.loads(file.read_text()), "../../../outside"
    cloud, image = (next(iter(datum["datum"].values())) for datum in values["data"][:2])
    if named == "picture":
        image["filename"] = out
    elif named == "cloud":
        cloud["filename"] = out
    elif named == "boxes":
        cloud["annotations"]["1"] = out
    elif named == "calibration":
        values["samples"][0]["calibration_key"] = out
    elif named == "ontology":
        values["ontologies"]["1"] = out
    else:
        splits = {"0": {"filenames": ["../scene_abc.json", "scene_07/scene_abc.json"]}}
        (place / "scene_dataset_v1.json").write_text(json.dumps({"scene_splits": splits}))
    file.write_text(json.dumps(values))
    with pytest.raises(OutsideError, match="leads out of"):
        open_capture(place)
    try:
        open_capture(place, allow_outside=True)
    except CaptureError as error:  # without its calibration nothing is left
        assert not isinstance(error, OutsideError)


def test_nuscenes(place: Path) -> None:
    tables = write_nuscenes(place, MiniDrive())
    tables["sample_data"][0]["filename"] = "samples/../../secret.png"
    write_tables(place, tables)
    with pytest.raises(OutsideError, match="secret"):
        open_capture(place)
    assert [250, 10, 10] in [view.image[0, 0].tolist() for view in open_capture(place, allow_outside=True)]


def test_nuscenes_infos(place: Path) -> None:
    write_infos(place, MiniDrive(), "1.x")
    picture = place / "samples" / "CAM_FRONT" / "0.jpg"
    picture.rename(place.parent / "0.jpg")
    picture.symlink_to(place.parent / "0.jpg")
    with pytest.raises(OutsideError, match="0.jpg"):
        open_capture(place)
    assert not open_capture(place, allow_outside=True).problems


@pytest.mark.parametrize("name", ["../up", "/root", "a/../../b", "", "a\\..\\b"])
def test_no_view_is_named_so_that_files_called_by_it_would_lie_elsewhere(name: str) -> None:
    from dataclasses import replace

    (first, *_) = views()
    with pytest.raises(CaptureError, match="can't be the name of a view"):
        Capture("names", (replace(first, name=name),))
