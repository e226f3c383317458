"""Rules of nuScenes' schema, checked on the tables of a folder by their names alone."""

import json
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

LINKS = {
    "sample_data": {"sample_token": "sample", "ego_pose_token": "ego_pose",
                    "calibrated_sensor_token": "calibrated_sensor"},
    "calibrated_sensor": {"sensor_token": "sensor"},
    "sample": {"scene_token": "scene"},
    "scene": {"log_token": "log", "first_sample_token": "sample", "last_sample_token": "sample"},
    "instance": {"category_token": "category", "first_annotation_token": "sample_annotation",
                 "last_annotation_token": "sample_annotation"},
    "sample_annotation": {"sample_token": "sample", "instance_token": "instance", "visibility_token": "visibility"},
    "map": {}, "log": {}, "sensor": {}, "category": {}, "attribute": {}, "visibility": {}, "ego_pose": {},
}  # fmt: skip
"""Fields of each of the thirteen tables that hold a token, and the table of that."""


def read_tables(root):
    (folder,) = Path(root).glob("v1.0-*")
    return {name: json.loads((folder / f"{name}.json").read_text()) for name in LINKS}


def check_tables(root):
    """Assert what the development kit relies on; returns the tables."""
    tables = read_tables(root)
    rows = {name: {each["token"]: each for each in found} for name, found in tables.items()}
    for name, fields in LINKS.items():
        assert len(rows[name]) == len(tables[name]), name
        for each in tables[name]:
            for field, other in fields.items():
                assert each[field] in rows[other], (name, field)
    for each in tables["sample_annotation"]:
        assert set(each["attribute_tokens"]) <= set(rows["attribute"]) and min(each["size"]) > 0
    for each in tables["map"]:
        assert set(each["log_tokens"]) <= set(rows["log"]) and (root / each["filename"]).is_file()
    for each in tables["sample_data"]:
        calibrated = rows["calibrated_sensor"][each["calibrated_sensor_token"]]
        sensor = rows["sensor"][calibrated["sensor_token"]]
        assert (root / each["filename"]).is_file() and Path(each["filename"]).parent.name == sensor["channel"]
        assert sensor["modality"] == {"jpg": "camera", "pcd": "lidar"}[each["fileformat"]]
        assert np.shape(calibrated["camera_intrinsic"]) == ((3, 3) if sensor["modality"] == "camera" else (0,))
    _check_chains(tables["sample"], "scene_token")
    _check_chains(tables["sample_data"], "calibrated_sensor_token")
    _check_chains(tables["sample_annotation"], "instance_token", ordered=False)
    for each in tables["scene"]:
        assert each["nbr_samples"] == len(tables["sample"])
    for each in tables["instance"]:
        own = [row for row in tables["sample_annotation"] if row["instance_token"] == each["token"]]
        assert each["nbr_annotations"] == len(own)
        assert (each["first_annotation_token"], each["last_annotation_token"]) == (own[0]["token"], own[-1]["token"])
    return tables


def _check_chains(table, by, ordered=True):
    """Assert that the rows of each chain lead from the first to the last and back, in order of time."""
    rows, chains = {each["token"]: each for each in table}, defaultdict(list)
    for each in table:
        chains[each[by]].append(each)
    for chain in chains.values():
        (first,) = (each for each in chain if each["prev"] == "")
        walked = [first]
        while walked[-1]["next"]:
            walked.append(rows[walked[-1]["next"]])
            assert walked[-1]["prev"] == walked[-2]["token"]
        assert len(walked) == len(chain)
        if ordered:
            assert [each["timestamp"] for each in walked] == sorted(each["timestamp"] for each in chain)


def pose_of(row):
    matrix = np.eye(4)
    w, x, y, z = row["rotation"]
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat([x, y, z, w]).as_matrix(), row["translation"]
    return matrix


def box_corners_of(row):
    """Corners of an annotation in the world, (8, 3)."""
    width, length, height = row["size"]
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    local = signs * [length / 2, width / 2, height / 2]
    pose = pose_of(row)
    return local @ pose[:3, :3].T + pose[:3, 3]
