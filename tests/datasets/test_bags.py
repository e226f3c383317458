"""Bags of ROS 2 and MCAP files: the miniature drive comes back exactly, and damage costs only what it hits."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.datasets.bags.containers import BagMessage, McapContainer, Place, Topic
from gsrain_engine.datasets.bags.messages import read_calibration, read_cloud, read_image
from gsrain_engine.datasets.bags.pixels import colors_of, is_picture, with_colors
from gsrain_engine.datasets.bags.reader import read_bag_recording
from gsrain_engine.datasets.capture import CaptureError, Lens
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from mini_drive import MiniDrive

from .sample_bags import (
    CLOUDS,
    IMAGES,
    STORE,
    K,
    camera_info,
    cloud,
    cloud_rows,
    drive_messages,
    raw_image,
    ros,
    transform,
    write_bag,
    write_foxglove,
)

DRIVE = MiniDrive()
NAMES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo")
IMAGE, CLOUD, INFO = NAMES


def message(value, kind):
    return BagMessage(Topic("/topic", kind, "cdr"), Place(0), 0, bytes(STORE.serialize_cdr(value, kind)))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "sqlite3-zstd"])
@pytest.mark.parametrize("poses", ["tf", "odometry"])
def test_a_bag_of_ros_2_is_the_drive(storage, poses, tmp_path):
    capture = open_capture(write_bag(tmp_path / "bag", drive_messages(DRIVE, poses), storage))
    DRIVE.check(capture, has_boxes=False)
    assert capture.sensors == ("front",) and not capture.problems
    assert capture[2].image[0, 0].tolist() == pytest.approx([80, 90, 160], abs=3)
    np.testing.assert_array_equal(capture.sweeps[0].intensities, 9)


@pytest.mark.parametrize(("encoding", "compression"), [("json", "ZSTD"), ("protobuf", "LZ4"), ("json", "NONE")])
def test_foxglove_s_schemas_are_the_drive(encoding, compression, tmp_path):
    file = write_foxglove(tmp_path / "drive.mcap", DRIVE, encoding, compression)
    assert capture_format(file).name.startswith("ROS 2 bag")
    DRIVE.check(open_capture(file), has_boxes=False)


def test_unsorted_times_and_messages_before_their_transforms_change_nothing(tmp_path):
    messages = drive_messages(DRIVE)
    shuffled = [messages[k] for k in np.random.default_rng(0).permutation(len(messages))]
    DRIVE.check(open_capture(write_bag(tmp_path / "bag", shuffled)), has_boxes=False)


def test_poses_between_transforms_are_interpolated_and_none_are_made_up_far_outside(tmp_path):
    rare = [each for each in drive_messages(DRIVE) if each[0] != "/tf" or each[2] != DRIVE.time(1)]
    DRIVE.check(open_capture(write_bag(tmp_path / "between", rare)), has_boxes=False)
    early = [each for each in drive_messages(DRIVE) if each[0] != "/tf" or each[2] < DRIVE.time(2)]
    capture = open_capture(write_bag(tmp_path / "early", early))
    assert len(capture) == 2
    assert "no transform from 'base_link' to 'map' is recorded at its time" in capture.problems[0]


def test_without_transforms_the_pictures_have_no_poses(tmp_path):
    recording = read_bag_recording(write_bag(tmp_path / "bag", drive_messages(DRIVE, "none")))
    assert [topic.name for topic in recording.others] == ["/front/camera_info", "/labels"]
    capture = recording.capture
    assert not capture.has_poses and len(capture) == len(capture.sweeps) == 3
    assert "no transforms (/tf) and no odometry" in capture.problems[-1]


@pytest.mark.parametrize(
    "encoding",
    ["rgb8", "bgr8", "BGR8", "8UC3", "rgba8", "bgra8", "mono8", "bayer_rggb8", "bayer_grbg8", "bayer_bggr8", "uyvy",
     "yuyv"],
)  # fmt: skip
def test_pixels_of_every_encoding_come_back(encoding):
    channels = {"rgba8": 4, "bgra8": 4, "mono8": 1, "uyvy": 2, "yuyv": 2}.get(encoding, 1 if "bayer" in encoding else 3)
    pixels = np.random.default_rng(1).integers(60, 180, (8, 12, channels), np.uint8)
    recorded = read_image(message(raw_image(pixels, encoding, 5.0, padding=4), IMAGE))
    colors = colors_of(recorded)
    again = read_image(recorded_with(recorded, with_colors(recorded, np.copy)))
    assert (again.encoding, again.stamp, again.height, again.width) == (encoding, recorded.stamp, 8, 12)
    if channels == 2:  # chroma of two pixels each
        assert np.abs(colors_of(again).astype(int) - colors).mean() < 12
        return
    np.testing.assert_array_equal(again.data.reshape(pixels.shape), pixels)
    if encoding.lower().startswith("bgr"):
        np.testing.assert_array_equal(colors, pixels[..., 2::-1])
    assert with_colors(recorded, lambda same: same) is None


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("encoding", ["mono16", "bayer_rggb16", "bayer_GBRG16"])
def test_16_bits_are_read_in_either_order_and_come_back_to_the_bit(encoding, order):
    values = np.random.default_rng(1).integers(0, 65536, (8, 12), np.uint16)
    stored = values.astype(f"{order}u2").view(np.uint8).reshape(8, 24)
    told = raw_image(stored, encoding, 5.0, padding=4)
    told = replace(told, width=12, is_bigendian=int(order == ">"))
    recorded = read_image(message(told, IMAGE))
    colors = colors_of(recorded)
    if encoding == "mono16":
        np.testing.assert_allclose(colors[..., 1], values / 257, atol=0.5)
    again = read_image(recorded_with(recorded, with_colors(recorded, np.copy)))
    assert (again.encoding, again.step) == (encoding, 24)
    np.testing.assert_array_equal(again.data.reshape(8, 24), stored)
    half = with_colors(recorded, lambda colors: (colors // 2).astype(np.uint8))
    darker = colors_of(read_image(recorded_with(recorded, half)))
    assert abs(darker.mean() - colors.mean() / 2) < 4


@pytest.mark.parametrize(("encoding", "first"), [("nv12", 1), ("NV21", 2)])
def test_planes_of_brightness_and_color_are_read_and_written(encoding, first):
    import cv2

    smooth = np.stack(np.broadcast_arrays(np.linspace(40, 200, 8)[:, None], np.linspace(60, 180, 12), 120.0), axis=-1)
    wanted = smooth.astype(np.uint8)
    planes = cv2.cvtColor(wanted, cv2.COLOR_RGB2YCrCb)[::2, ::2]  # V, then U, over all of 0..255
    # Brightness and color as television has them: 16..235 and 16..240.
    luma = np.rint(16 + cv2.cvtColor(wanted, cv2.COLOR_RGB2YCrCb)[..., 0].astype(float) * 219 / 255).astype(np.uint8)
    pairs = np.rint(128 + (planes[..., [2, 1]][..., :: 1 if first == 1 else -1].astype(float) - 128) * 224 / 255)
    rows = np.concatenate([luma, pairs.astype(np.uint8).reshape(4, 12)])
    told = replace(raw_image(rows, encoding, 5.0, padding=4), height=8)
    recorded = read_image(message(told, IMAGE))
    colors = colors_of(recorded)
    assert is_picture(recorded) and np.abs(colors.astype(int) - wanted).max() < 20
    again = read_image(recorded_with(recorded, with_colors(recorded, np.copy)))
    assert np.abs(colors_of(again).astype(int) - colors).mean() < 3
    with pytest.raises(ValueError, match=f"12x7 px of {encoding}"):
        colors_of(read_image(message(replace(told, height=7), IMAGE)))


def recorded_with(image, data):
    return BagMessage(image.topic, Place(0), 0, data)


def test_depth_and_video_are_no_pictures():
    assert not is_picture(read_image(message(raw_image(np.zeros((4, 4, 2), np.uint8), "16UC1", 0.0), IMAGE)))


def test_calibrations_tell_the_lens_unless_the_picture_is_rectified(tmp_path):
    values = (-0.3, 0.1, 0.001, 0.002, 0.0)
    for k, (model, d, lens) in enumerate((
        ("plumb_bob", values, Lens("opencv", values)),
        ("equidistant", values[:4], Lens("fisheye", values[:4])),
    )):  # fmt: skip
        messages = [
            ("/front/camera_info", *each[1:3], camera_info(each[2], d, model)) if "info" in each[0] else each
            for each in drive_messages(DRIVE)
        ]
        assert open_capture(write_bag(tmp_path / f"raw{k}", messages))[0].lens == lens
        rectified = [("/front/image_rect", *each[1:]) if each[0] == IMAGES else each for each in messages]
        assert open_capture(write_bag(tmp_path / f"rect{k}", rectified))[0].lens is None


def test_a_region_and_bins_move_the_calibration():
    value = camera_info(0.0)
    value = replace(
        value, roi=replace(value.roi, x_offset=8, y_offset=4, width=32, height=24), binning_x=2, binning_y=2
    )
    found = read_calibration(message(value, INFO))
    assert (found.width, found.height) == (16, 12)
    # The ray through a corner of the full picture's pixel (8, 4) hits the corner of the first pixel.
    k = K.reshape(3, 3)
    ray = [(7.5 - k[0, 2]) / k[0, 0], (3.5 - k[1, 2]) / k[1, 1], 1.0]
    np.testing.assert_allclose(found.matrix @ ray, [-0.5, -0.5, 1.0], atol=1e-12)


# Damage


def lying(kind, change):
    """A message that says something else about itself."""
    points = cloud(cloud_rows(DRIVE.lidar_points(0)), 1.0)
    value = points if kind == CLOUD else raw_image(np.zeros((4, 6, 3), np.uint8), "rgb8", 1.0)
    return message(replace(value, **change), kind)


@pytest.mark.parametrize(
    ("kind", "change", "named"),
    [
        (CLOUD, {"width": 10**6}, "says that it has 1x1000000 points of 32 bytes"),
        (CLOUD, {"height": 2**31, "width": 2**31, "row_step": 0}, "points of 32 bytes in"),
        (CLOUD, {"point_step": 8}, "lies outside of the 8 bytes of a point"),
        (CLOUD, {"fields": []}, "has no field 'x'"),
        (IMAGE, {"step": 3}, "says that it is 6x4 px of rgb8 with 3 bytes a row"),
        (IMAGE, {"height": 2**31}, "and has 72 bytes"),
        (IMAGE, {"encoding": "bayer_rggb8", "width": 100}, "100x4 px of bayer_rggb8"),
    ],
)
def test_lying_messages_are_named(kind, change, named):
    with pytest.raises(ValueError, match=named):
        read_cloud(lying(kind, change)) if kind == CLOUD else colors_of(read_image(lying(kind, change)))


def test_cut_off_messages_are_named():
    whole = message(raw_image(np.zeros((4, 6, 3), np.uint8), "rgb8", 1.0), IMAGE)
    for count in (0, 3, 20, 60):
        with pytest.raises(ValueError, match="not a sensor_msgs/msg/Image"):
            read_image(whole._replace(data=whole.data[:count]))


def test_a_broken_message_costs_itself_alone(tmp_path):
    messages = drive_messages(DRIVE)
    clouds = [k for k, each in enumerate(messages) if each[0] == CLOUDS]
    topic, kind, time, value = messages[clouds[1]]
    messages[clouds[1]] = topic, kind, time, replace(value, width=10**7)
    capture = open_capture(write_bag(tmp_path / "bag", messages))
    assert len(capture) == 3 and len(capture.sweeps) == 2
    (problem,) = capture.problems
    assert problem.startswith(
        "a message of /lidar/points left out: not a sensor_msgs/msg/PointCloud2: says that it has"
    )


def without(*topics):
    return [each for each in drive_messages(DRIVE) if each[0] not in topics]


def circle():
    back = ros("tf2_msgs/msg/TFMessage", transforms=[transform("front", "map", np.eye(4), DRIVE.time(0))])
    return [*drive_messages(DRIVE), ("/tf_static", "tf2_msgs/msg/TFMessage", DRIVE.time(0), back)]


def skewed():
    time = DRIVE.time(0)
    sensors = [transform("nowhere", "front", np.eye(4), time), transform("map", "lidar", np.eye(4), time)]
    still = ros("tf2_msgs/msg/TFMessage", transforms=sensors)
    return [*without("/tf_static"), ("/tf_static", "tf2_msgs/msg/TFMessage", time, still)]


VIDEO = raw_image(np.zeros((4, 4, 1), np.uint8), "nv24", DRIVE.time(0))


def test_topics_that_are_left_out_are_named_with_their_encodings(tmp_path):
    bag = write_bag(tmp_path / "bag", [*drive_messages(DRIVE), ("/rear/image", IMAGE, DRIVE.time(0), VIDEO)])
    (problem,) = open_capture(bag).problems
    assert problem.startswith("/rear/image left out: ") and "nv24" in problem
    lonely = [*without(IMAGES), ("/rear/image", IMAGE, DRIVE.time(0), VIDEO)]
    with pytest.raises(CaptureError, match=r"/rear/image left out: .*nv24"):
        open_capture(write_bag(tmp_path / "lonely", lonely))


@pytest.mark.parametrize(
    ("messages", "named"),
    [
        (without("/front/camera_info"), r"no calibration \(CameraInfo\) of it is recorded"),
        (
            without(IMAGES),
            r"no picture that can be used: its topics are .*/front/camera_info \(sensor_msgs/msg/CameraInfo",
        ),
        ([], "no picture that can be used: it holds no messages"),
        (circle(), "go round in a circle"),
    ],
    ids=["calibration", "pictures", "messages", "circle"],
)
def test_what_is_missing_is_named(messages, named, tmp_path):
    with pytest.raises(CaptureError, match=named):
        open_capture(write_bag(tmp_path / "bag", messages))


def test_sensors_of_another_tree_are_named(tmp_path):
    capture = open_capture(write_bag(tmp_path / "bag", skewed()))
    assert len(capture) == 3 and not capture.sweeps
    assert "no transform from 'lidar' to 'nowhere' is recorded" in capture.problems[0]


def test_cut_off_and_foreign_files_are_named(tmp_path):
    file = next(write_bag(tmp_path / "bag", drive_messages(DRIVE)).glob("*.mcap"))
    content = file.read_bytes()
    for count in (0, 7, 60, len(content) // 2):
        file.write_bytes(content[:count])
        with pytest.raises(CaptureError, match=r"\.mcap: not an MCAP file that can be read to its end"):
            list(McapContainer(file).copy(tmp_path / "copy.mcap", lambda each: None))
    assert not (tmp_path / "copy.mcap").exists()
    file.write_bytes(content.replace(b"\x89MCAP", b"\x89XXXX"))
    with pytest.raises(CaptureError, match="not an MCAP file"):
        open_capture(file)
    other = tmp_path / "other.db3"
    other.write_bytes(b"no database at all" * 100)
    with pytest.raises(CaptureError, match="other.db3: not the database of a ROS 2 bag"):
        open_capture(other)


def test_a_file_without_its_end_gives_what_comes_before(tmp_path):
    file = write_foxglove(tmp_path / "drive.mcap", MiniDrive(samples=2))
    file.write_bytes(file.read_bytes()[:-30])
    capture = open_capture(file)
    assert len(capture) == 2 and "it is cut off" in capture.problems[-1]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("rosbag2_bagfile_information: [", "not the list of a ROS 2 bag's files"),
        ("rosbag2_bagfile_information: {relative_file_paths: [../other.mcap]}", "leads out of"),
        ("rosbag2_bagfile_information: {relative_file_paths: [a.db3], compression_format: zstd, "
         "compression_mode: FILE}", "ros2 bag convert"),
        ("rosbag2_bagfile_information: {relative_file_paths: [a.mcap]}", "no such file"),
    ],
)  # fmt: skip
def test_lists_of_files_are_checked(text, named, tmp_path):
    folder = write_bag(tmp_path / "bag", drive_messages(DRIVE))
    (folder / "metadata.yaml").write_text(text)
    with pytest.raises(CaptureError, match=named):
        open_capture(folder)
