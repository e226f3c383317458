"""Hashes of files by what they hold: pixels, arrays, numbers, roll-outs, scene folders."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

LEFT_OUT = "seconds", "program", "software", "version", "scene_hash", "inputs"
"""Beginnings of keys of JSON whose values differ between runs and versions."""


def digest_of(data: bytes) -> str:
    """Return SHA-256 as hex digits."""
    return hashlib.sha256(data).hexdigest()


def digests_of(kind: str, path: Path, name: str) -> dict[str, str]:
    """Hash one file or scene folder; each name begins with `name`."""
    match kind:
        case "bytes":
            return {f"{name} (bytes)": digest_of(path.read_bytes())}
        case "pixels":
            return {f"{name} (pixels)": _array_digest(pixels_of(path))}
        case "arrays":
            with np.load(path) as arrays:
                return {f"{name} ({key})": _array_digest(arrays[key]) for key in sorted(arrays)}
        case "numbers":
            return {f"{name} (numbers)": _plain_digest(json.loads(path.read_bytes()))}
        case "table":
            return {f"{name} (values)": _leaves_digest([json.loads(line) for line in path.read_bytes().splitlines()])}
        case "rollout":
            return _rollout(path, name)
        case "scene":
            return _scene(path, name)
    raise ValueError(f"no kind of result {kind!r}")


def pixels_of(path: Path) -> np.ndarray:
    """Return the decoded pixels of a picture, or the array of an NPY file."""
    if path.suffix == ".npy":
        return np.load(path)
    with Image.open(path) as picture:
        return np.asarray(picture)


def _array_digest(array: np.ndarray) -> str:
    return digest_of(f"{array.dtype.str} {array.shape} ".encode() + np.ascontiguousarray(array).tobytes())


def _plain_digest(values: Any) -> str:
    return digest_of(json.dumps(_lasting(values), sort_keys=True).encode())


def _lasting(values: Any) -> Any:
    """Return plain values without those that differ from run to run."""
    if isinstance(values, dict):
        return {key: _lasting(each) for key, each in values.items() if not key.startswith(LEFT_OUT)}
    return [_lasting(each) for each in values] if isinstance(values, list) else values


def _leaves_digest(values: Any) -> str:
    """Hash values without their names and order: what stays where keys are renamed."""
    return digest_of("\n".join(sorted(_leaves(_lasting(values)))).encode())


def _leaves(values: Any) -> list[str]:
    if isinstance(values, dict | list):
        inner = values.values() if isinstance(values, dict) else values
        return [leaf for each in inner for leaf in _leaves(each)]
    return [json.dumps(values)]


def _rollout(path: Path, name: str) -> dict[str, str]:
    """Hash the settings in a roll-out's first line, with their names and without, and the bytes of all steps."""
    head, _, steps = path.read_bytes().partition(b"\n")
    return {
        f"{name} (head)": digest_of(head),
        f"{name} (values of head)": _leaves_digest(json.loads(head)),
        f"{name} (steps)": digest_of(steps),
    }


def _scene(folder: Path, name: str) -> dict[str, str]:
    """Hash each part of `scene.json`, and bytes and arrays of the other files, whose names lose the hash in them."""
    found = {}
    for key, values in json.loads((folder / "scene.json").read_bytes()).items():
        found[f"{name}/scene.json: {key}"] = digest_of(json.dumps(values, sort_keys=True).encode())
    for file in sorted(folder.glob("*/*")):
        label = f"{name}/{file.parent.name}/{file.name.rpartition('-')[0]}{''.join(file.suffixes)}"
        found[f"{label} (bytes)"] = digest_of(file.read_bytes())
        if file.suffix == ".ply":
            found |= {f"{label} ({key})": _array_digest(array) for key, array in _vertices(file).items()}
        elif file.suffix == ".npy":
            found[f"{label} (array)"] = _array_digest(np.load(file))
    return found


def _vertices(file: Path) -> dict[str, np.ndarray]:
    """Read the columns of a binary PLY of floats, by the prefixes of their names."""
    head, _, body = file.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in head.decode().splitlines()]
    names = [words[2] for words in lines if words[0] == "property"]
    table = np.frombuffer(body, "<f4").reshape(-1, len(names))
    groups: dict[str, list[int]] = {}
    for k, each in enumerate(names):
        groups.setdefault(each.rstrip("0123456789").rstrip("_"), []).append(k)
    return {group: table[:, columns] for group, columns in groups.items()}
