"""Paths that are no capture, or lead out of one: the nearest kind is named, and outside files need a permission."""

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from colmap_files import write_binary, write_pictures, write_text
from gsrain_engine.datasets.capture import CaptureError, OutsideError
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.io.arrays import read_json as read_json_of_captures
from gsrain_engine.datasets.layout_hints import nearest_layout
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.safe_io.files import read_json
from gsrain_engine.scene.formats.scene_files import read_scene

from .sample_captures import INTRINSICS, opengl_pose, views
from .sample_drives import RAW, damaged, edited, write_dgp, write_infos, write_kitti, write_nuscenes, write_sequence

# What is nearest to a folder that is no capture


def files(contents: dict[str, bytes]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        for name, content in contents.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return folder

    return write


def colmap_model(folder: Path) -> None:
    write_binary(folder / "sparse" / "0")


NO_OXTS, NO_CALIBRATION = {f"{RAW}/oxts": None}, {f"calib_{name}.txt": None for name in ("cam_to_cam", "velo_to_cam")}
NO_IMAGES = damaged(colmap_model, {"sparse/0/images.bin": None})
SCENES = files(dict.fromkeys(("cat.splat", "dog.spz", "meta.json", "notes.txt"), b"{}"))
PHONE = files({"IMG_1.HEIC": b"\0\0\0\x18ftypheic"})
KITTI360 = {
    "calibration/perspective.txt": b"",
    "data_2d_raw/2013_05_28_drive_0000_sync/image_00/data_rect/1.png": b"",
    "data_poses/2013_05_28_drive_0000_sync/poses.txt": b"",
}
NEAREST: list[tuple[Callable[[Path], Path], str]] = [
    (damaged(write_kitti, NO_OXTS, RAW), "KITTI raw without oxts"),
    (damaged(write_kitti, NO_OXTS), "KITTI raw without oxts"),
    (damaged(write_kitti, NO_OXTS | NO_CALIBRATION, RAW), "KITTI raw without oxts and calib_cam_to_cam.txt"),
    (damaged(write_sequence, {"sequences/00/times.txt": None}, "sequences/00"), "KITTI odometry without times.txt"),
    (damaged(write_nuscenes, {"v1.0-mini/sample_data.json": None}), "nuScenes without v1.0-*/sample_data.json"),
    (NO_IMAGES, "COLMAP without images.bin"),
    (files({"cameras.json": b"[]"}), "capture folder without pictures"),
    (files({"meta.json": b'{"title": "my pictures"}'}), "SOG without its pictures (*.webp)"),
    (SCENES, "a folder of scenes (give one of the files in it: cat.splat, dog.spz)"),
    (files({"drive_0.mcap": b""}), "a ROS 2 bag without metadata.yaml (give the .mcap or .db3"),
    (
        files(
            dict.fromkeys((f"calibration/{name}.feather" for name in ("intrinsics", "egovehicle_SE3_sensor")), b"")
            | {"sensors/cameras/ring_front_center/1.jpg": b""}
        ),
        "Argoverse 2 without city_SE3_egovehicle.feather",
    ),
    (
        lambda folder: files(KITTI360)(folder) / "data_2d_raw",
        "KITTI-360 (give the folder that has data_2d_raw, calibration and data_poses in it",
    ),
    (files({"camera/front_camera/poses.json": b"[]", "camera/front_camera/intrinsics.json": b"{}"}), "PandaSet (it"),
    (files({"mav0/cam0/data/1.png": b"", "mav0/cam0/sensor.yaml": b""}), "EuRoC (it"),
    (PHONE, "a folder of pictures of formats that can't be read (convert them to JPEG or PNG): IMG_1.HEIC"),
]


@pytest.mark.parametrize(("write", "kind"), NEAREST, ids=[kind for _, kind in NEAREST])
def test_the_nearest_kind_is_named(
    tmp_path: Path, write: Callable[[Path], Path], kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["info", str(write(tmp_path))]) == BAD_INPUT
    printed = capsys.readouterr().err
    assert f"nearest is {kind}" in printed and printed.count("\n") == 1


POSES_OF_OTHERS = {
    "cameras.csv": (b"#name,x,y,alt,heading,pitch,roll,f,px,py\n", "RealityCapture"),
    "cameras.xml": (b'<?xml version="1.0"?>\n<document version="2.0.0">\n<chunk label="Chunk 1">', "Metashape"),
    "corrected_cameras/17.json": (b'{"t_00": 1.0, "t_01": 0.0}', "Polycam"),
    "metadata": (b'{"w": 720, "poses": [[0, 0, 0, 1, 0, 0, 0]]}', "Record3D"),
    "reconstruction.json": (b"[{}]", "OpenSfM"),
    "sfm_data.json": (b'{"sfm_data_version": "0.3"}', "OpenMVG"),
    "scan.nvm": (b"NVM_V3\n\n2\n", "VisualSFM"),
    "kitti_infos_train.pkl": (b"\x80\x04]\x94.", "MMDetection3D"),
}


@pytest.mark.parametrize("name", POSES_OF_OTHERS)
def test_poses_of_other_programs_beside_pictures_are_named(name: str, tmp_path: Path) -> None:
    content, program = POSES_OF_OTHERS[name]
    for place in (tmp_path / "scan/images", tmp_path / "scan"):  # beside the folder of pictures, and in it
        write_pictures(tmp_path / "scan/images")
        files({name: content, "a.xml": b"<gpx/>"})(
            tmp_path / "scan" if place.name == "images" else tmp_path / "scan/images"
        )
        for opened in (tmp_path / "scan/images", tmp_path / "scan"):
            if place.name == "images" or opened.name == "images":
                problems = " ".join(open_capture(opened).problems)
                assert f"{name} has poses of {program}, which are not read: " in problems
        shutil.rmtree(tmp_path / "scan")
    files({"about.xml": b"<gpx/>", "rows.csv": b"a,b\n1,2\n", "metadata": b"{}"})(tmp_path / "other")
    write_pictures(tmp_path / "other")
    assert "has poses of" not in " ".join(open_capture(tmp_path / "other").problems)


@pytest.mark.parametrize("read", [read_json, read_json_of_captures])
def test_json_may_begin_with_a_byte_order_mark(tmp_path: Path, read: Callable[[Path], Any]) -> None:
    (tmp_path / "a.json").write_text('{"fx": 5}', encoding="utf-8-sig")
    assert read(tmp_path / "a.json") == {"fx": 5}


def test_tables_of_other_types_are_named_in_plain_words(tmp_path: Path) -> None:
    write_nuscenes(tmp_path)
    (table,) = tmp_path.rglob("sample_data.json")
    table.write_text('[{"token": 5}]')
    with pytest.raises(CaptureError, match=r"sample_data.json: Expected text, got a whole number - at `\$\[0\]"):
        open_capture(tmp_path)


def test_paths_that_are_near_to_nothing_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_pictures(tmp_path / "garden")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "notes.txt").write_text("no capture")
    for hidden in (".rainy views.lock", "rainy views.lock", ".rainy_views"):
        (tmp_path / hidden).touch()
    assert nearest_layout(tmp_path / "notes") is None and nearest_layout(tmp_path / "notes" / "notes.txt") is None
    for path, message in (
        (tmp_path / "gardem", "gardem: no such file or folder; did you mean garden?"),
        (tmp_path / "rainy views", "rainy views: no such file or folder$"),
        (Path("street"), "street: no such file or folder; gsrain street DIR writes pictures"),
        (tmp_path / "notes", "notes: not a capture that is known; expected one of capture folder, "),
        (tmp_path / "garden" / "a.png", "a.png: not a capture"),
    ):
        with pytest.raises(CaptureError, match=message):
            open_capture(path)

    def refuse(_: Path) -> list[Path]:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("gsrain_engine.datasets.capture_folder.images_in", refuse)
    with pytest.raises(CaptureError, match="not a capture that is known"):
        open_capture(tmp_path / "notes")


def test_pictures_that_are_opened_or_left_out_are_explained(tmp_path: Path) -> None:
    write_pictures(NO_IMAGES(tmp_path / "a") / "images")
    capture = open_capture(tmp_path / "a")
    assert not capture.has_poses
    assert any("nearest to the folder is COLMAP without images.bin" in each for each in capture.problems)
    write_pictures(PHONE(tmp_path / "b"))
    Image.new("RGB", (8, 8)).save(tmp_path / "b" / "small.webp")  # a picture in WebP makes no SOG
    problems = "\n".join(open_capture(tmp_path / "b").problems)
    assert "1 more picture is left out" in problems and "IMG_1.HEIC" in problems and "nearest" not in problems


def test_a_folder_too_high_names_the_captures_and_scenes_below_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_sequence(tmp_path / "data" / "drives" / "first")
    write_pictures(tmp_path / "data" / "thumbs")
    for below, name in (("data", "drives/first"), ("data/drives", "first")):
        assert run(["info", str(tmp_path / below)]) == BAD_INPUT
        assert f"give a folder in it: {name} (KITTI odometry)" in capsys.readouterr().err
    assert run(["transfer", str(tmp_path), "-o", str(tmp_path / "out")]) == BAD_INPUT
    assert "give a folder in it: data/thumbs (image folder)" in capsys.readouterr().err
    with pytest.raises(SceneFormatError, match=r"give one of the files in it: cat.splat, dog.spz$"):
        read_scene(SCENES(tmp_path / "a"))


# Names that lead out of the capture


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder for a capture, and a person's own picture in the folder above."""
    (tmp_path / "capture").mkdir()
    Image.new("RGB", (64, 48), (250, 10, 10)).save(tmp_path / "secret.png")
    return tmp_path / "capture"


def nerfstudio(folder: Path, name: str, field: str = "") -> None:
    frames = [{"file_path": each, "transform_matrix": opengl_pose([1.0, 2.0, 3.0])} for each in ("a.png", name)]
    values = {**INTRINSICS, "frames": frames}
    if field:
        (values if field == "ply_file_path" else frames[0])[field] = "../secret.png"
    write_pictures(folder, ("a.png",))
    (folder / "transforms.json").write_text(json.dumps(values))


def colmap(folder: Path, name: str, write: Any = write_binary, below: str = "sparse/0") -> None:
    write(folder / below, ("a.png", name))
    write_pictures(folder / "images", ("a.png",))


TEXT = partial(colmap, write=write_text, below="sparse")


@pytest.mark.parametrize(("write", "up"), [(nerfstudio, "../"), (colmap, "../../"), (TEXT, "../../")])
@pytest.mark.parametrize("kind", ["absolute", "dots", "link"])
def test_pictures_elsewhere_are_refused_unless_allowed(
    place: Path, write: Callable[[Path, str], None], up: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    secret = place.parent / "secret.png"
    name = {"absolute": str(secret), "dots": f"{up}secret.png", "link": "b.png"}[kind]
    write(place, name)
    if kind == "link":
        (place / ("" if write is nerfstudio else "images") / "b.png").symlink_to(secret)
    with pytest.raises(OutsideError, match="leads out of .*--allow-outside"):
        open_capture(place)
    capture = open_capture(place, allow_outside=True)
    assert len(capture) == 2 and any(view.image[0, 0].tolist() == [250, 10, 10] for view in capture)
    assert run(["info", str(place), "--allow-outside"]) == 0
    assert run(["info", str(place)]) == BAD_INPUT, "what one command allows ends with it"
    printed = capsys.readouterr().err
    assert name in printed and printed.count("\n") == 1


def linked_pictures(folder: Path) -> None:
    colmap(folder, "a.png")
    (folder / "images").rename(folder.parent / "photos")
    (folder / "images").symlink_to(folder.parent / "photos")


def linked_mask(folder: Path) -> None:
    colmap(folder, "b.png")
    write_pictures(folder / "images", ("b.png",))
    (folder / "masks").mkdir()
    (folder / "masks" / "a.png.png").symlink_to(folder.parent / "secret.png")


def own_folder(folder: Path) -> None:
    list(write_views(folder, views()))


def infos(folder: Path) -> None:
    write_infos(folder)
    picture = folder / "samples" / "CAM_FRONT" / "0.jpg"
    picture.rename(folder.parent / "0.jpg")
    picture.symlink_to(folder.parent / "0.jpg")


def dgp(change: Callable[[Any], object]) -> Callable[[Path], Path]:
    return damaged(write_dgp, {"scene_07/scene_abc.json": edited(change)})


OUT = "../../../outside"
ELSEWHERE = edited(lambda rows: rows[1].update(name="../secret"))
FIRST_FILE = edited(lambda rows: rows[0].update(filename="samples/../../secret.png"))
SCENE = b'{"scene_splits": {"0": {"filenames": ["../scene_abc.json", "scene_07/scene_abc.json"]}}}'


@pytest.mark.parametrize(
    ("write", "name"),
    [
        *((partial(nerfstudio, name="a.png", field=field), "secret.png")
          for field in ("mask_path", "depth_file_path", "ply_file_path")),
        (linked_pictures, "images"),
        (linked_mask, "masks"),
        (damaged(own_folder, {"cameras.json": ELSEWHERE}), "secret"),
        (damaged(write_nuscenes, {"v1.0-mini/sample_data.json": FIRST_FILE}), "secret"),
        (infos, "0.jpg"),
        (damaged(write_dgp, {"scene_dataset_v1.json": SCENE}), "scene_abc"),
        *((dgp(change), "outside") for change in (
            lambda values: values["data"][0]["datum"]["point_cloud"].update(filename=OUT),
            lambda values: values["data"][0]["datum"]["point_cloud"]["annotations"].update({"1": OUT}),
            lambda values: values["data"][1]["datum"]["image"].update(filename=OUT),
            lambda values: values["samples"][0].update(calibration_key=OUT),
            lambda values: values["ontologies"].update({"1": OUT}),
        )),
    ],
)  # fmt: skip
def test_every_file_that_a_capture_names_is_checked(place: Path, write: Callable[[Path], None], name: str) -> None:
    write(place)
    with pytest.raises(OutsideError, match=name):
        open_capture(place)
    try:
        assert len(open_capture(place, allow_outside=True)) > 0
    except CaptureError as error:  # without its calibration nothing is left, say
        assert not isinstance(error, OutsideError)


def test_names_that_come_back_into_the_folder_are_fine(place: Path) -> None:
    nerfstudio(place, "images/../b.png")
    write_pictures(place, ("b.png",))
    (place / "images").mkdir()
    assert len(open_capture(place)) == 2
    (place.parent / "link").symlink_to(place)
    assert len(open_capture(place.parent / "link")) == 2, "the capture itself may be reached through a link"
