"""Rainy copies of bags, Waymo, nuScenes and KITTI: other pixels and points, everything else byte for byte."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from datasets.sample_bags import (
    CLOUD,
    CLOUDS,
    IMAGES,
    STORE,
    cloud,
    cloud_rows,
    drive_messages,
    raw_image,
    rosbag2,
    write_bag,
    write_foxglove,
)
from datasets.sample_drives import (
    segment_tables,
    write_argoverse2,
    write_dgp,
    write_frames,
    write_kitti,
    write_kitti360,
    write_kitti_objects,
    write_nuscenes,
    write_segment,
    write_sequence,
)
from gsrain_engine.datasets import open_capture as captures
from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.datasets.io.records import records_in
from gsrain_engine.datasets.open_capture import CaptureFormat, open_capture
from gsrain_engine.datasets.waymo import parsed, unpacked_ranges
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.recordings.folders import FileCopies
from gsrain_engine.recordings.lidar import LidarRain
from gsrain_engine.recordings.rainy_recording import open_recording
from gsrain_engine.safe_io.files import whole_file
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.progress import Progress
from mini_drive import MiniDrive

DRIVE = MiniDrive()


@dataclass
class Negatives:
    """Pictures that show at once whether they were replaced."""

    threads: int = 2

    def begin(self, view):
        return lambda photo: 255 - photo


def rainy_copy(source: Path, target: Path, intensity_mm_h: float = 60.0) -> LidarRain | None:
    recording = open_recording(source)
    rain = RainSettings(intensity_mm_h=intensity_mm_h)
    lidar = LidarRain(recording.capture, rain, SENSORS["64"], full=None, estimates_range=True)
    files = FileCopies()
    for _ in recording.write(target, Negatives(), lidar, files):
        pass
    assert_all_changes_are_named(source, target, files)
    return lidar


def assert_all_changes_are_named(source: Path, target: Path, files: FileCopies) -> None:
    if source.is_file():
        assert files.changed == [target.name]
        return
    home = source.parent if target.joinpath(source.name).is_dir() else source
    home = source.parents[1] if target.joinpath("sequences").is_dir() and source.parent.name == "sequences" else home
    differ = {
        each.relative_to(target).as_posix()
        for each in target.rglob("*")
        if each.is_file() and each.read_bytes() != (home / each.relative_to(target)).read_bytes()
    }
    assert differ <= set(files.changed) and len(files.changed) == len(set(files.changed))


def assert_pictures_are_negatives(source: Path, target: Path) -> None:
    clear, rainy = open_capture(source), open_capture(target)
    assert [view.name for view in rainy] == [view.name for view in clear]
    for own, other in zip(rainy, clear, strict=True):
        # The road's height is found from the lidar.
        np.testing.assert_allclose(own.camera.world_to_camera, other.camera.world_to_camera, atol=0.02)
        assert own.time_s == other.time_s and own.lens == other.lens
        assert np.abs(255 - own.image.astype(int) - other.image).mean() < 3


def assert_lidar_is_in_rain(source: Path, target: Path) -> None:
    clear, rainy = open_capture(source), open_capture(target)
    for own, other in zip(rainy.sweeps, clear.sweeps, strict=True):
        assert own.time_s == other.time_s
        assert 0 < len(own.points_m) < len(other.points_m)
        nearest = np.linalg.norm(own.points_m[:, None] - other.points_m[None], axis=2).min(axis=1)
        assert np.median(nearest) < 0.2


def messages_of(folder: Path):
    with rosbag2.Reader(folder) as reader:
        return [(each.topic, each.msgtype, time, data) for each, time, data in reader.messages()]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "sqlite3-zstd"])
def test_rosbags_reads_a_bag_whose_other_messages_are_the_same(storage, tmp_path):
    source, target = write_bag(tmp_path / "bag", drive_messages(DRIVE), storage), tmp_path / "rainy"
    before = {file: file.read_bytes() for file in source.iterdir()}
    rainy_copy(source, target)
    assert before == {file: file.read_bytes() for file in source.iterdir()}
    assert sorted(each.name for each in target.iterdir()) == sorted(each.name for each in source.iterdir())
    assert (target / "metadata.yaml").read_bytes() == (source / "metadata.yaml").read_bytes()
    for clear, rainy in zip(messages_of(source), messages_of(target), strict=True):
        assert clear[:3] == rainy[:3]
        assert (clear[3] != rainy[3]) == (clear[0] in (IMAGES, CLOUDS))
        if clear[0] == CLOUDS:
            check_cloud(STORE.deserialize_cdr(rainy[3], rainy[1]), STORE.deserialize_cdr(clear[3], clear[1]))
    assert_pictures_are_negatives(source, target)
    assert_lidar_is_in_rain(source, target)


def check_cloud(rainy, clear):
    rows, before = (np.frombuffer(each.data.tobytes(), CLOUD) for each in (rainy, clear))
    assert (rainy.width, rainy.row_step, rainy.is_dense) == (len(rows), 32 * len(rows), clear.is_dense)
    assert len(rows) < len(before) and rainy.header == clear.header
    away = np.stack([rows[axis] for axis in "xyz"], 1)[:, None] - np.stack([before[axis] for axis in "xyz"], 1)[None]
    rings = before["ring"][np.linalg.norm(away, axis=2).argmin(axis=1)]
    assert (rows["ring"] == rings).mean() > 0.9  # noise moves few points past a neighbor
    assert rows["intensity"].max() <= 9 and (rows["intensity"] == np.rint(rows["intensity"])).all()


def test_organized_clouds_keep_their_size_and_raw_images_their_encoding(tmp_path):
    rows, time = cloud_rows(DRIVE.lidar_points(0))[:480], DRIVE.time(0)
    rows["x"][7] = np.nan
    pixels = np.full((48, 64, 3), (10, 60, 200), np.uint8)
    messages = [each for each in drive_messages(DRIVE) if each[0] not in (IMAGES, CLOUDS)]
    messages += [
        (CLOUDS, "sensor_msgs/msg/PointCloud2", time, cloud(rows, time, height=16)),
        ("/front/image_raw", "sensor_msgs/msg/Image", time, raw_image(pixels, "bgr8", time, padding=8)),
    ]
    rainy_copy(write_bag(tmp_path / "bag", messages), tmp_path / "rainy")
    found = {topic: STORE.deserialize_cdr(data, kind) for topic, kind, _, data in messages_of(tmp_path / "rainy")}
    image, points = found["/front/image_raw"], found[CLOUDS]
    assert (image.encoding, image.step, image.data[:3].tolist()) == ("bgr8", 3 * 64, [245, 195, 55])
    assert (points.height, points.width, points.is_dense) == (16, 30, False)
    rainy = np.frombuffer(points.data.tobytes(), CLOUD)
    np.testing.assert_array_equal(rainy["ring"], rows["ring"])
    lost = np.isnan(rainy["x"])
    assert lost[7] and 1 < lost.sum() < 480


def test_mcap_s_own_reader_finds_all_that_an_mcap_file_had(tmp_path):
    from mcap.reader import make_reader

    source, target = write_foxglove(tmp_path / "drive.mcap", DRIVE), tmp_path / "rainy.mcap"
    rainy_copy(source, target)
    contents = []
    for file in (source, target):
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            header, summary = reader.get_header(), reader.get_summary()
            messages = [
                (
                    s.name,
                    s.data,
                    c.topic,
                    c.message_encoding,
                    c.metadata,
                    m.log_time,
                    m.publish_time,
                    m.sequence,
                    m.data,
                )
                for s, c, m in reader.iter_messages()
            ]
            more = [(each.name, each.data, each.create_time) for each in reader.iter_attachments()]
            more += [(each.name, each.metadata) for each in reader.iter_metadata()]
            contents.append((header, more, messages, summary.statistics.message_count))
    (header, more, clear, count), found = contents
    assert (header, more, count) == (found[0], found[1], found[3]) and more
    for own, other in zip(found[2], clear, strict=True):
        assert own[:-1] == other[:-1]
        changed = own[2] in ("/front/image", "/points")
        assert (own[-1] != other[-1]) == changed
        if changed:  # the other fields stay
            values = json.loads(own[-1]), json.loads(other[-1])
            assert [name for name in values[1] if values[0][name] != values[1][name]] == ["data"]
    assert_pictures_are_negatives(source, target)
    assert_lidar_is_in_rain(source, target)


def test_frames_of_waymo_keep_labels_and_fields_that_are_not_read(tmp_path):
    extra = b"\xfa\x07\x05hello"  # field 127, of a later version

    def later(_, frame):
        frame.MergeFromString(extra)

    source, target = tmp_path / "segment.tfrecord", tmp_path / "rainy.tfrecord"
    write_frames(source, DRIVE, change=later)
    rainy_copy(source, target)
    for (_, clear), (_, rainy) in zip(records_in(source), records_in(target), strict=True):
        assert extra in rainy and clear != rainy
        before, after = parsed("Frame", clear), parsed("Frame", rainy)
        first, second = (unpacked_ranges(each.lasers[0].ri_return1.range_image_compressed) for each in (before, after))
        lost, there = second[..., 0] == -1, first[..., 0] > 0
        assert 0 < (lost & there).sum() < there.sum() and (second[lost & there] == -1).all()
        assert (second[~there] == first[~there]).all()
        np.testing.assert_array_equal(second[..., 2:][~lost], first[..., 2:][~lost])
        for each in (before, after):
            del each.images[:], each.lasers[:]
        assert before == after
    assert_pictures_are_negatives(source, target)
    assert_lidar_is_in_rain(source, target)


def test_tables_of_waymo_have_other_images_and_ranges_alone(tmp_path):
    from pyarrow import parquet

    source, target = tmp_path / "waymo", tmp_path / "rainy"
    write_segment(source, segment_tables(DRIVE))
    rainy_copy(source, target)
    changed = {
        "camera_image": ["[CameraImageComponent].image"],
        "lidar": ["[LiDARComponent].range_image_return1.values"],
    }
    for file in source.rglob("*.parquet"):
        copy = target / file.relative_to(source)
        if file.parent.name not in changed:
            assert copy.read_bytes() == file.read_bytes()
            continue
        clear, rainy = parquet.read_table(file), parquet.read_table(copy)
        assert rainy.schema == clear.schema
        others = [name for name in clear.column_names if not clear[name].equals(rainy[name])]
        assert others == changed[file.parent.name]
    assert_pictures_are_negatives(source, target)
    assert_lidar_is_in_rain(source, target)


def whole_nuscenes(folder: Path) -> tuple[Path, Path]:
    write_nuscenes(folder)
    return folder, folder


def raw_kitti(folder: Path) -> tuple[Path, Path]:
    return write_kitti(folder), folder


def kitti360(folder: Path) -> tuple[Path, Path]:
    write_kitti360(folder)
    return folder, folder


def odometry(folder: Path) -> tuple[Path, Path]:
    return write_sequence(folder), folder


def argoverse(folder: Path) -> tuple[Path, Path]:
    return 2 * (write_argoverse2(folder),)


def dgp(folder: Path) -> tuple[Path, Path]:
    write_dgp(folder)
    return folder, folder


def kitti_objects(folder: Path) -> tuple[Path, Path]:
    write_kitti_objects(folder)
    return folder, folder


@pytest.mark.parametrize("write", [whole_nuscenes, raw_kitti, kitti360, odometry, argoverse, dgp, kitti_objects])
def test_folders_have_other_pictures_and_lidar_alone(write, tmp_path):
    source, whole = write(tmp_path / "drive")
    target = tmp_path / "rainy"
    before = {file: file.read_bytes() for file in whole.rglob("*") if file.is_file()}
    rainy_copy(source, target)
    assert before == {file: file.read_bytes() for file in whole.rglob("*") if file.is_file()}
    for file, content in before.items():
        same = (target / file.relative_to(whole)).read_bytes() == content
        is_turn = file.suffix in (".bin", ".npz") or file.parent.name == "lidar"
        assert same == (file.suffix != ".jpg" and not is_turn), file
    assert_pictures_are_negatives(source, target)
    assert_lidar_is_in_rain(source, target)


def test_turns_of_argoverse_and_dgp_keep_their_columns_types_and_compression(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    source = write_argoverse2(tmp_path / "av2")
    rainy_copy(source, tmp_path / "rainy")
    for file in (source / "sensors" / "lidar").iterdir():
        content = (tmp_path / "rainy" / file.relative_to(source)).read_bytes()
        clear, rainy = (arrow.ipc.open_file(each).read_all() for each in (file.read_bytes(), content))
        assert rainy.schema.types == clear.schema.types and rainy.column_names == clear.column_names
        assert b"\x28\xb5\x2f\xfd" in content and b"pandas" in rainy.schema.metadata
        assert json.loads(rainy.schema.metadata[b"pandas"])["index_columns"][0]["stop"] == len(rainy) < len(clear)
        columns = {name: np.array(clear[name]) for name in clear.column_names}
        rows = np.searchsorted(columns["offset_ns"], np.array(rainy["offset_ns"]))
        assert (np.diff(rows) > 0).all()
        np.testing.assert_array_equal(np.array(rainy["laser_number"]), columns["laser_number"][rows])
        ranges = [np.linalg.norm([np.array(t[a], float) for a in "xyz"], axis=0) for t in (clear, rainy)]
        assert np.median(np.abs(ranges[1] - ranges[0][rows])) < 0.1
    write_dgp(tmp_path / "dgp")
    (lidar,) = tmp_path.glob("dgp/scene_07/point_cloud/LIDAR")
    with np.load(lidar / "0.npz") as archive:
        np.savez(lidar / "0.npz", other=np.arange(3), data=archive["data"])
    rainy_copy(tmp_path / "dgp", tmp_path / "rainy_dgp")
    with np.load(lidar / "0.npz") as clear, np.load(tmp_path / "rainy_dgp/scene_07/point_cloud/LIDAR/0.npz") as rainy:
        assert rainy.files == clear.files and (rainy["other"] == clear["other"]).all()
        assert rainy["data"].dtype == clear["data"].dtype and 0 < len(rainy["data"]) < len(clear["data"])


def test_a_format_of_a_package_writes_its_copies_itself(tmp_path, monkeypatch):
    """Here a recording is one array of images."""
    photos = np.arange(2 * 24 * 32 * 3, dtype=np.uint8).reshape(2, 24, 32, 3)
    np.save(tmp_path / "drive.npy", photos)

    def read(path):
        stored = np.load(path)
        camera = Camera.from_fov(32, 24, 60.0, look_at(*np.array([[0.0, 0, 1.5], [1, 0, 1.5], [0, 0, 1]])))
        return Capture("drive", tuple(CaptureFrame(str(k), camera, lambda k=k: stored[k], k) for k in range(2)))

    def write(capture, source, target, pictures, lidar, files):
        with whole_file(target) as copy, copy.open("wb") as stream:
            np.save(stream, np.stack([pictures.begin(view)(view.image) for view in capture]))
        files.changed.append(target.name)
        yield Progress(1.0, source.name)

    row = CaptureFormat("array", lambda path: path.suffix == ".npy", read, write=write)
    monkeypatch.setattr(captures, "FORMATS", (row, *captures.FORMATS))
    rainy_copy(tmp_path / "drive.npy", tmp_path / "rainy.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "rainy.npy"), 255 - photos)


def test_a_bag_s_progress_is_by_finished_images_and_clouds(tmp_path):
    recording = open_recording(write_bag(tmp_path / "bag", drive_messages(DRIVE)))
    lidar = LidarRain(
        recording.capture, RainSettings(intensity_mm_h=60), SENSORS["64"], full=None, estimates_range=True
    )
    steps = [each.fraction for each in recording.write(tmp_path / "rainy", Negatives(), lidar, FileCopies())]
    images_and_clouds = 2 * DRIVE.samples
    np.testing.assert_allclose(steps[:images_and_clouds], np.arange(1, images_and_clouds + 1) / images_and_clouds)
    assert all(each == 1 for each in steps[images_and_clouds:])


def test_without_rain_the_points_stay(tmp_path):
    source, target = write_bag(tmp_path / "bag", drive_messages(DRIVE)), tmp_path / "dry"
    rainy_copy(source, target, intensity_mm_h=0.0)
    for clear, dry in zip(messages_of(source), messages_of(target), strict=True):
        assert clear[:3] == dry[:3] and (clear[3] == dry[3]) == (clear[0] != IMAGES)
