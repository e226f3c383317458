"""Memory of an undo step beyond the scene, and its time. Prints JSON."""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gsrain_engine.editor.background_edits import find_floaters
from gsrain_engine.editor.edits import layers
from gsrain_engine.editor.edits.floaters import FloaterRules
from gsrain_engine.editor.edits.gaussians import CropBox, compact, crop, delete_selected, hide_selected
from gsrain_engine.editor.edits.level import level_from_ground
from gsrain_engine.editor.edits.transform import move_member, move_selected, preview_move
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.open import random_scene
from gsrain_engine.scene.scene import ColorGrading, Scene


def arrays_of(scene: Scene) -> Iterator[np.ndarray]:
    """All arrays that a scene holds on to, those of its masks among them."""
    for member in scene.members:
        gaussians, marks = member.gaussians, member.marks
        yield from (gaussians.means, gaussians.scales, gaussians.quaternions, gaussians.opacities, gaussians.sh)
        yield from (mask.words for mask in (marks.selected, marks.hidden, marks.deleted) if mask is not None)
    for masks in scene.selections.values():
        yield from (mask.words for mask in masks.values())


def added_bytes(before: Scene, after: Scene) -> int:
    known = {id(array) for array in arrays_of(before)}
    return sum({id(array): array.nbytes for array in arrays_of(after) if id(array) not in known}.values())


def similarity(quarter_turns: float = 0.0, scale: float = 1.0) -> np.ndarray:
    c, s = np.cos(quarter_turns * np.pi / 2), np.sin(quarter_turns * np.pi / 2)
    matrix = np.eye(4)
    matrix[:2, :2] = [[c, -s], [s, c]]
    matrix[:3, :3] *= scale
    matrix[:3, 3] = 1.0, 2.0, 0.5
    return matrix


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="random-1m", help="random-NUMBER; millions have SH degree 3")
    arguments = parser.parse_args()
    scene = random_scene(arguments.scene)
    key, count = scene.layers[0].key, len(scene.layers[0].gaussians)
    half = BitMask.of(np.random.default_rng(0).random(count) < 0.5)
    selected = scene.with_member(key, marks=replace(scene.layers[0].marks, selected=half))
    deleted = delete_selected(selected)
    two = layers.duplicate(scene, key)
    edits: dict[str, tuple[Scene, Callable[[Scene], Scene]]] = {
        "delete half": (selected, delete_selected),
        "hide half": (selected, hide_selected),
        "crop": (scene, lambda each: crop(each, CropBox((0.0, 10.0, 0.0), (8.0, 10.0, 5.0)))),
        "move layer": (scene, lambda each: move_member(each, key, similarity(0.5, 1.5))),
        "grade layer": (scene, lambda each: each.with_member(key, grading=ColorGrading(exposure_ev=1.0))),
        "duplicate layer": (scene, lambda each: layers.duplicate(each, key)),
        "frame of dragging half": (selected, lambda each: preview_move(each, None, similarity())),
        "shift half": (selected, lambda each: move_selected(each, similarity())),
        "turn and scale half": (selected, lambda each: move_selected(each, similarity(0.5, 1.5))),
        "separate half": (selected, layers.separate),
        "remove deleted for good": (deleted, compact),
        "merge with a copy": (two, lambda each: layers.merge(each, [layer.key for layer in each.layers])),
        "find floaters": (scene, lambda each: find_floaters(each, FloaterRules())),
        "level by the ground": (scene, level_from_ground),
    }
    numbers: dict[str, object] = {}
    for name, (before, edit) in edits.items():
        start = time.perf_counter()
        try:
            after = edit(before)
        except ValueError as refused:
            numbers[name] = {"refused": str(refused), "s": round(time.perf_counter() - start, 3)}
            continue
        seconds = time.perf_counter() - start
        start_from = scene if before is selected else before
        numbers[name] = {"MB": round(added_bytes(start_from, after) / 1e6, 3), "s": round(seconds, 4)}
    print(json.dumps({"gaussians": count, "edits": numbers}, indent=1))


if __name__ == "__main__":
    main()
