"""Real commands on small inputs: what they write, and what is wrong with what something that ended them has left."""

import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import av
import msgspec
import numpy as np
from PIL import Image

from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.open import random_scene
from gsrain_engine.simulation.rollout_io import read_rollout
from gsrain_engine.sweep.results import rows_in
from small_capture import small_capture
from sweep.small_sweep import sweep_of, write_road, write_scenario


@dataclass(frozen=True)
class Command:
    """A command, and how its output is looked at."""

    name: str
    arguments: tuple[str, ...]
    """With {in} and {out} for the folders of inputs and outputs."""
    goes_on: tuple[str, ...] = ()
    """Options that resume a stopped command."""

    def line(self, inputs: Path, outputs: Path) -> list[str]:
        """The arguments of `gsrain`."""
        return [each.replace("{in}", str(inputs)).replace("{out}", str(outputs)) for each in self.arguments]

    def again(self, inputs: Path, outputs: Path) -> list[str]:
        """The arguments to run it once more, and to go on from a checkpoint where there is one."""
        has_checkpoint = any(outputs.glob("*.checkpoint.npz"))
        return self.line(inputs, outputs) + (list(self.goes_on) if has_checkpoint else [])


def write_inputs(folder: Path) -> None:
    """Write what the commands read."""
    write_scene(random_scene("random-20k"), folder / "random")
    road = write_road(folder / "road")
    scenario = write_scenario(folder / "short.yaml", road)
    sweep = sweep_of([scenario], seeds=2)
    (folder / "sweep.yaml").write_bytes(msgspec.yaml.encode(sweep))
    for _ in write_views(folder / "capture", small_capture()):
        pass
    (folder / "often.yaml").write_text("saved_every: 3\nmeasured_every: 6\n")


_CLIP = ("--size", "96x64", "--duration", "0.5", "--rain", "8.5", "--backend", "cpu")

COMMANDS = (
    Command("convert to .ply", ("convert", "{in}/random", "{out}/a.ply")),
    Command("convert to .splat", ("convert", "{in}/random", "{out}/a.splat")),
    Command("convert to .spz", ("convert", "{in}/random", "{out}/a.spz")),
    Command("convert to a scene folder", ("convert", "{in}/random", "{out}/scene")),
    Command("record an MP4", ("render", "{in}/road", "-o", "{out}/a.mp4", *_CLIP)),
    Command("record a WebM", ("render", "{in}/road", "-o", "{out}/a.webm", *_CLIP)),
    Command("record pictures", ("render", "{in}/road", "-o", "{out}/frames", "--passes", "color,depth,labels", *_CLIP)),
    Command("record EXR", ("render", "{in}/road", "-o", "{out}/exr", "--codec", "exr", "--depth", *_CLIP)),
    Command(
        "drive",
        ("drive", "{in}/short.yaml", "-o", "{out}/drive", "--agent", "constant-velocity", "--rain", "0,8.5",
         "--export", "parquet", "--backend", "cpu", "--json", "{out}/drive.json"),
    ),
    Command("sweep", ("sweep", "{in}/sweep.yaml", "-o", "{out}/sweep", "--workers", "0")),
    Command(
        "reconstruct",
        ("reconstruct", "{in}/capture", "-o", "{out}/fitted", "--config", "{in}/often.yaml", "--steps", "12",
         "--gaussians", "1500", "--device", "cpu", "--json", "{out}/fitted.json"),
        ("--resume",),
    ),
    Command("transfer", ("transfer", "{in}/capture", "-o", "{out}/rainy")),
    Command("recolor", ("recolor", "{in}/road", "--images", "{in}/capture", "-o", "{out}/wet")),
)  # fmt: skip


def complaints(folder: Path) -> list[str]:
    """Damaged or incomplete files among the results in a folder."""
    found: list[str] = []
    for file in sorted(folder.rglob("*")):
        inner = [part for part in file.relative_to(folder).parts if part.startswith(".")]
        if inner or not file.is_file():
            continue
        look = _LOOKS.get(file.suffix)
        try:
            if look is not None:
                look(file)
        except Exception as error:  # whatever its reader says of it
            found.append(f"{file.relative_to(folder)}: {type(error).__name__}: {error}")
    return found


def leftovers(folder: Path) -> list[str]:
    """Files and folders that were to be renamed, or removed."""
    return sorted(str(each.relative_to(folder)) for each in folder.rglob(".*") if not each.name.startswith(".numba"))


def _video(file: Path) -> None:
    """Check that an interrupted video plays up to its end; without a first group of frames, nothing is left of it."""
    if file.stat().st_size < 4096:
        return
    with av.open(str(file)) as container, suppress(av.error.InvalidDataError):
        for _ in container.decode(video=0):
            pass


def _picture(file: Path) -> None:
    with Image.open(file) as image:
        image.load()


def _archive(file: Path) -> None:
    with np.load(file, allow_pickle=False) as archive:
        for name in archive.files:
            archive[name]


def _rows(file: Path) -> None:
    if file.parent.name == "rows":
        assert len(rows_in(file.read_bytes())) == 1


def _text(file: Path) -> None:
    if file.suffix == ".html":
        assert file.read_text().rstrip().endswith("</html>")
    elif file.suffix == ".json":
        msgspec.json.decode(file.read_bytes())
        if file.name == "scene.json":
            read_scene(file.parent)


def _lines(file: Path) -> None:
    if file.name in ("log.jsonl", "jobs.jsonl"):
        for line in file.read_bytes().splitlines():
            msgspec.json.decode(line)
    else:
        read_rollout(file)


_LOOKS: dict[str, Callable[[Path], object]] = {
    ".splat": read_scene, ".spz": read_scene, ".mp4": _video, ".webm": _video, ".png": _picture, ".npz": _archive,
    ".npy": np.load, ".parquet": _rows, ".html": _text, ".json": _text, ".jsonl": _lines,
    ".zip": lambda file: zipfile.ZipFile(file).testzip(),
    ".ply": lambda file: None if (file.parent.parent / "scene.json").exists() else read_scene(file),
}  # fmt: skip
