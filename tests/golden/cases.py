"""Commands whose results are hashed, each with the files that it makes; they use nothing of the program but its command line."""

from dataclasses import dataclass

CROSSING = "saved/crossing"
"""The saved scene: 700 Gaussians, wet colors, a vehicle, a rig, marks, a camera path, rain with keys."""

SIZE = ("--size", "160x96")
WEATHERS = {
    "clear": ("--rain", "0"),
    "8.5": ("--rain", "8.5"),
    "wet": ("--rain", "8.5", "--wetness", "0.8"),
    "paper": ("--preset", "paper"),
}
LOOKS = ("points", "ellipsoids", "depth", "normals", "opacity", "overdraw", "layers")
SCENARIOS = ("cut-in", "idm-traffic", "lead-braking", "stationary-lead")


@dataclass(frozen=True)
class Case:
    """One command, run in a folder of its own results beside `saved`, and what of its files is hashed.

    `results` are kind and file, or a pattern for several: "pixels", "bytes", "arrays", "numbers" (JSON), "table"
    (JSON lines), "rollout", "scene" (a scene folder).
    """

    name: str
    arguments: tuple[str, ...]
    results: tuple[tuple[str, str], ...] = ()


Chain = tuple[Case, ...]
"""Cases that use each other's files, in this order."""


def chains() -> list[Chain]:
    """Return all cases; chains may run at the same time, but the first goes alone: it compiles kernels, builds the street."""
    return [
        _street(),
        _stills("street", "street", ("--wet",)),
        _stills("crossing", CROSSING, WEATHERS["wet"]),
        _converted(),
        _recordings(),
        *(_drives(name) for name in SCENARIOS),
        _own_drives(),
        _rain_measured(),
        _appearance(),
        _lidar(),
        _sweeps(),
    ]


def stills_of_saved_scene() -> Chain:
    """Return the stills of the saved scene, which a test makes again."""
    return _stills("crossing", CROSSING, WEATHERS["wet"])


def _render(name: str, scene: str, *options: str, size: tuple[str, ...] = SIZE) -> Case:
    """Make a still with its numbers; its hashes are those of its pixels, of the file, and of the numbers."""
    file = f"{name}.png"
    arguments = ("render", scene, "-o", file, *size, *options, "--json", f"{name}.json")
    return Case(name, arguments, (("pixels", file), ("bytes", file), ("numbers", f"{name}.json")))


def _stills(name: str, scene: str, wet: tuple[str, ...], *options: str) -> Chain:
    weathers = WEATHERS | {"wet": wet if wet[0] == "--rain" else (*WEATHERS["8.5"], *wet)}
    return tuple(
        _render(f"still/{name}.{backend}.{weather}", scene, *options, *chosen, "--backend", backend)
        for weather, chosen in weathers.items()
        for backend in ("cpu", "opengl")
    )


def _street() -> Chain:
    images = tuple(("pixels", f"street/images/*{end}") for end in (".png", ".npy"))
    written = ("street", "street", "--rig", "nuscenes", "--moments", "2", "--width", "96", "--json", "street.json")
    return (
        Case("street", written, (("numbers", "street.json"), ("numbers", "street/images/cameras.json"), *images,
                                 ("scene", "street/scene"))),
        Case("info/street", ("info", "street/scene", "--json", "info.json"), (("numbers", "info.json"),)),
        Case("info/saved scene", ("info", CROSSING, "--json", "info_saved.json"), (("numbers", "info_saved.json"),)),
        Case("info/capture", ("info", "street/images", "--check", "--overlay", "overlay.png", "--json", "info_capture.json"),
             (("numbers", "info_capture.json"), ("pixels", "overlay.png"))),
    )  # fmt: skip


def _converted() -> Chain:
    files = {f"crossing{end}": () for end in (".ply", ".splat", ".spz")} | {
        "wet.ply": ("--wetness", "1"),
        "copy": (),
        "leveled": ("--level", "--metres-per-unit", "2", "--up", "-y"),
    }
    written = tuple(
        Case(
            f"convert/{name}",
            ("convert", CROSSING, name, *options, "--json", f"{name}.json"),
            (("bytes" if "." in name else "scene", name), ("numbers", f"{name}.json")),
        )
        for name, options in files.items()
    )
    again = Case("convert/spz to ply", ("convert", "crossing.spz", "again.ply"), (("bytes", "again.ply"),))
    stills = _stills("converted", "crossing.spz", ("--wet",), "--up", "z", "--camera", "saved/camera.json")
    return *written, again, *stills


def _recordings() -> Chain:
    looks = tuple(
        _render(f"look/{look}.{backend}", CROSSING, "--look", look, "--backend", backend, size=("--size", "96x64"))
        for look in LOOKS
        for backend in ("cpu", "opengl")
    )
    frames = ("--fps", "4", "--to", "0.5", "--passes", "color,depth,alpha,labels", "--twin", "--motion-blur", "2",
              "--supersampling", "2", "--cameras", "pair", "--backend", "cpu")  # fmt: skip
    small = ("--size", "64x48", "--backend", "cpu")
    return (
        *looks,
        Case("recording/frames", ("render", CROSSING, "-o", "frames", *frames, "--json", "frames.json"),
             (("pixels", "frames*/**/*.png"), ("numbers", "frames*/**/*.json"), ("numbers", "frames.json"))),
        Case("recording/floats", ("render", CROSSING, "-o", "still.npy", "--depth", "--time", "1", *small),
             (("pixels", "still*.npy"),)),
        Case("recording/exr", ("render", CROSSING, "-o", "still.exr", "--time", "1", *small), (("bytes", "still.exr"),)),
        Case("recording/video", ("render", CROSSING, "-o", "clip.mp4", "--to", "1", "--fps", "8", *small),
             (("bytes", "clip.mp4"),)),
        Case("recording/roofs", ("render", CROSSING, "-o", "roofs.png", "--roofs", "--seed", "5", *small),
             (("pixels", "roofs.png"),)),
        Case("recording/preset", ("render", CROSSING, "-o", "preset.png", "--preset", "saved/settings/preset.yaml", *small),
             (("pixels", "preset.png"),)),
        Case("recording/labels", ("render", CROSSING, "-o", "coco", "--labels", "coco", "--cameras", "pair/FRONT",
                                  "--frame", "1", "--backend", "cpu"), (("numbers", "coco/**/*.json"), ("pixels", "coco/**/*.png"))),
        Case("recording/kitti", ("render", CROSSING, "-o", "kitti", "--labels", "kitti", "--cameras", "pair/FRONT",
                                 "--to", "0.1", "--backend", "cpu"), (("bytes", "kitti/**/*.txt"),)),
    )  # fmt: skip


def _drives(scenario: str) -> Chain:
    agents = [each for name in ("constant-velocity", "oracle-idm", "neuroncap-baseline") for each in ("--agent", name)]
    options = ("--rain", "0,8.5", "--duration", "8", "--width", "96", "--no-video", "--backend", "cpu")
    arguments = ("drive", scenario, *agents, *options, "-o", scenario, "--json", f"{scenario}.json")
    return (
        Case(f"drive/{scenario}", arguments, (("rollout", f"{scenario}/*.jsonl"), ("numbers", f"{scenario}.json"))),
    )


def _own_drives() -> Chain:
    traffic = ("drive", "saved/settings/scenario.yaml", "--scene", CROSSING, "--agent", "oracle-idm",
               "--export", "parquet,xosc", "--backend", "cpu", "--no-video")  # fmt: skip
    seen = ("drive", "stationary-lead", "--agent", "saved/brightness_agent.py", "--rain", "0,12", "--duration", "1",
            "--width", "96", "--no-video", "--seed", "3")  # fmt: skip
    return (
        Case("drive/own scenario", (*traffic, "-o", "traffic", "--json", "traffic.json"),
             (("rollout", "traffic/*.jsonl"), ("numbers", "traffic.json"), ("bytes", "traffic/*.xosc"))),
        *(
            Case(f"drive/pictures.{backend}", (*seen, "--backend", backend, "-o", backend, "--json", f"{backend}.json"),
                 (("rollout", f"{backend}/*.jsonl"), ("numbers", f"{backend}.json")))
            for backend in ("cpu", "opengl")
        ),
    )  # fmt: skip


def _rain_measured() -> Chain:
    cases = [
        Case(f"disdrometer/{rain}", ("disdrometer", "--rain", rain, "--area", "0.2", "--seconds", "240", "--record", "60",
                                     "-o", f"{rain}.nc", "--json", f"{rain}.json"), (("numbers", f"{rain}.json"),))
        for rain in ("1.2", "8.5")
    ]  # fmt: skip
    preset = (
        "disdrometer",
        "--preset",
        "saved/settings/preset.yaml",
        "--area",
        "0.1",
        "--seconds",
        "30",
        "--record",
        "30",
    )
    return (
        *cases,
        Case("disdrometer/preset", (*preset, "--json", "preset.json"), (("numbers", "preset.json"),)),
        Case("info/disdrometer", ("info", "8.5.nc", "--json", "info.json"), (("numbers", "info.json"),)),
        Case("info/table", ("info", "saved/drops.csv", "--columns", "saved/settings/columns.yaml", "--json", "table.json"),
             (("numbers", "table.json"),)),
        Case("calibrate", ("calibrate", "1.2.nc", "8.5.nc", "-o", "fitted.yaml", "--intensities", "1.2,8.5", "--half-width",
                           "0.4", "--resamples", "20", "--force", "--json", "calibrate.json"),
             (("numbers", "calibrate.json"),)),
    )  # fmt: skip


def _appearance() -> Chain:
    rig = ("--views", "rig", "--count", "6", "--width", "64")
    return (
        Case("transfer", ("transfer", CROSSING, "-o", "wet", "--method", "wet", *rig, "--json", "transfer.json"),
             (("numbers", "transfer.json"), ("pixels", "wet/**/*.png"))),
        Case("transfer/half", ("transfer", CROSSING, "-o", "half", "--method", "wet", "--wetness", "0.3", "--seed", "2", *rig),
             (("pixels", "half/**/*.png"),)),
        Case("recolor", ("recolor", CROSSING, "--images", "wet", "-o", "recolored", "--iterations", "4", "--held-out", "3",
                         "--json", "recolor.json"), (("numbers", "recolor.json"), ("scene", "recolored"))),
        Case("evaluate/images", ("evaluate", "images", "half", "wet", "--json", "images.json"), (("numbers", "images.json"),)),
        Case("evaluate/consistency", ("evaluate", "consistency", "wet", "half", "--json", "consistency.json"),
             (("numbers", "consistency.json"),)),
        Case("evaluate/fid", ("evaluate", "fid", "wet", "half", "--extractor", "pixels16", "--resamples", "20",
                              "--json", "fid.json"), (("numbers", "fid.json"),)),
    )  # fmt: skip


def _lidar() -> Chain:
    sensor = ("--sensor", "saved/settings/lidar.yaml", "--rain", "0,8.5", "--seeds", "2", "--sweeps", "2")
    return (
        Case("evaluate/lidar", ("evaluate", "lidar", CROSSING, "-o", "lidar", *sensor, "--json", "lidar.json"),
             (("numbers", "lidar.json"), ("arrays", "lidar/**/*.npz"))),
    )  # fmt: skip


def _sweeps() -> Chain:
    return tuple(
        Case(f"sweep/{name}", ("sweep", f"saved/sweep/{name}.yaml", "-o", name, "--workers", "0", "--json", f"{name}.json"),
             (("numbers", f"{name}.json"), ("table", f"{name}/jobs.jsonl"), ("numbers", f"{name}/summary.json"),
              ("rollout", f"{name}/rollouts/*.jsonl"), ("pixels", f"{name}/clips/**/*.png")))
        for name in ("drives", "frames")
    )  # fmt: skip
