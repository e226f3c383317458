"""Commands whose results are hashed. They use nothing of the program but its command line."""

from dataclasses import dataclass

CROSSING = "saved/crossing"
"""The saved scene: 1,000 Gaussians, wet colors, a vehicle, a rig, marks, a camera path, rain with keys."""

WEATHERS = {
    "clear": "--rain 0", "8.5": "--rain 8.5 --no-mirror", "paper": "--preset paper",
    "wet": "--rain 8.5 --wetness 0.8 --no-mirror",
}  # fmt: skip
BACKENDS = "cpu", "opengl"
LOOKS = "points", "ellipsoids", "depth", "normals", "opacity", "overdraw", "layers"
SCENARIOS = "cut-in", "idm-traffic", "lead-braking", "stationary-lead"


@dataclass(frozen=True)
class Case:
    """One command, and the files it makes that are hashed."""

    name: str
    command: str
    """As typed after `gsrain`, in a folder that holds a copy of `saved`."""
    results: tuple[str, ...]
    """Kind and file, or a pattern for several files; the kinds are those of `digests_of`."""


Chain = tuple[Case, ...]
"""Cases that share a folder, in this order: later ones use files of earlier ones."""


def chains() -> list[Chain]:
    """Return all cases. The first chain goes alone, for it compiles kernels; others may run at the same time."""
    return [
        street(),
        street_stills(),
        stills("crossing", CROSSING),
        conversions(),
        looks(),
        recordings(),
        *((drives(scenario),) for scenario in SCENARIOS),
        own_drives(),
        measured_rain(),
        wet_looks(),
        (lidar(),),
        sweeps(),
    ]


def stills(name: str, scene: str, wet: str = WEATHERS["wet"]) -> Chain:
    """Return stills in four weathers by two back ends."""
    weathers = WEATHERS | {"wet": wet}
    return tuple(
        still(f"still/{name}.{backend}.{weather}", f"{scene} {options} --backend {backend} --size 160x96")
        for weather, options in weathers.items()
        for backend in BACKENDS
    )


def still(name: str, options: str) -> Case:
    """Return a still with its numbers."""
    results = f"pixels {name}.png", f"bytes {name}.png", f"numbers {name}.json"
    return Case(name, f"render {options} -o {name}.png --json {name}.json", results)


def street() -> Chain:
    """Return the built-in street with pictures of it, and what `info` prints about scenes and captures."""
    made = "numbers street.json", "numbers street/images/cameras.json", "scene street/scene"
    arrays = "pixels street/images/*.png", "pixels street/images/*.npy"
    check = "info street/images --check --overlay overlay.png --json capture.json"
    return (
        Case("street", "street street --rig nuscenes --moments 2 --width 96 --json street.json", (*made, *arrays)),
        Case("info/street", "info street/scene --json scene.json", ("numbers scene.json",)),
        Case("info/saved scene", f"info {CROSSING} --json saved.json", ("numbers saved.json",)),
        Case("info/capture", check, ("numbers capture.json", "pixels overlay.png")),
    )


def street_stills() -> Chain:
    """Return stills of the street; wet by one back end only, since its wet colors take longest and need none."""
    every = stills("street", "street", "--rain 8.5 --wet --no-mirror")
    return tuple(case for case in every if case.name != "still/street.opengl.wet")


def conversions() -> Chain:
    """Return one export of each format that can be written, and stills of one."""
    targets = {
        "crossing.ply": "", "crossing.splat": "", "crossing.spz": "", "wet.ply": "--wetness 1", "copy": "",
        "leveled": "--level --meters-per-unit 2", "turned": "--up -y",
    }  # fmt: skip
    exports = tuple(
        Case(
            f"convert/{name}",
            f"convert {CROSSING} {name} {options} --json {name}.json",
            (f"{'bytes' if '.' in name else 'scene'} {name}", f"numbers {name}.json"),
        )
        for name, options in targets.items()
    )
    read_again = (
        Case("convert/spz to ply", "convert crossing.spz spz.ply", ("bytes spz.ply",)),
        Case("convert/splat to ply", "convert crossing.splat splat.ply", ("bytes splat.ply",)),
    )
    return *exports, *read_again, *stills("converted", "crossing.spz", "--rain 8.5 --wet")


def looks() -> Chain:
    """Return what is shown instead of the picture, by both back ends."""
    return tuple(
        still(f"look/{look}.{backend}", f"{CROSSING} --mode {look} --backend {backend} --size 96x64")
        for look in LOOKS
        for backend in BACKENDS
    )


def recordings() -> Chain:
    """Return clips and frames with all passes, labels, and forms of files."""
    small = f"render {CROSSING} --size 64x48 --backend cpu"
    rig = f"render {CROSSING} --backend cpu --cameras"
    front = f"{rig} pair/FRONT --to 0.1 -o"
    passes = "--passes color,depth,alpha,labels --clear-pair sunny --motion-blur 2 --supersampling 2 --fps 4 --to 0.5"
    preset = f"render {CROSSING} --backend cpu --preset saved/settings/preset.yaml --camera saved/camera.json"
    frames = "pixels frames*/**/*.png", "numbers frames*/**/*.json", "numbers numbers.json"
    return (
        Case("recording/frames", f"{rig} pair -o frames {passes} --json numbers.json", frames),
        Case("recording/floats", f"{small} -o still.npy --depth --time 1", ("pixels still*.npy",)),
        Case("recording/exr", f"{small} -o still.exr --time 1", ("bytes still.exr",)),
        Case("recording/video", f"{small} -o clip.mp4 --to 1 --fps 8", ("bytes clip.mp4",)),
        Case("recording/roofs", f"{small} -o roofs.png --roofs --seed 5", ("pixels roofs.png",)),
        Case("recording/preset", f"{preset} -o preset.png", ("pixels preset.png",)),
        Case("recording/coco", f"{front} coco --labels coco", ("numbers coco/**/*.json", "pixels coco/**/*.png")),
        Case("recording/kitti", f"{front} kitti --labels kitti", ("bytes kitti/**/*.txt", "pixels kitti/**/*.png")),
    )


def drives(scenario: str) -> Case:
    """Return roll-outs of a shipped scenario by three agents, with rain and without."""
    agents = "--agent constant-velocity --agent oracle-idm --agent neuroncap-baseline"
    options = f"--rain 0,8.5 --duration 8 --width 96 --no-video --backend cpu -o {scenario} --json {scenario}.json"
    results = f"rollout {scenario}/*.jsonl", f"numbers {scenario}.json"
    return Case(f"drive/{scenario}", f"drive {scenario} {agents} {options}", results)


def own_drives() -> Chain:
    """Return a drive with one road user of each behavior, and drives by an agent that looks at pictures."""
    traffic = f"drive saved/settings/scenario.yaml --scene {CROSSING} --agent oracle-idm --no-video --backend cpu"
    agent = "--agent saved/brightness_agent.py --duration 1 --width 96 --no-video"
    seen = f"drive stationary-lead {agent} --rain 0,12 --no-mirror"
    return (
        Case(
            "drive/own scenario",
            f"{traffic} --export parquet,xosc -o traffic --json traffic.json",
            ("rollout traffic/*.jsonl", "numbers traffic.json", "bytes traffic/*.parquet"),
        ),
        *(
            Case(
                f"drive/pictures.{backend}",
                f"{seen} --seed 3 --backend {backend} -o {backend} --json {backend}.json",
                (f"rollout {backend}/*.jsonl", f"numbers {backend}.json"),
            )
            for backend in BACKENDS
        ),
    )


def measured_rain() -> Chain:
    """Return what a virtual disdrometer counts, and a calibration fitted to it."""
    meter = "disdrometer --area 0.2 --seconds 120 --record 60"
    meters = tuple(
        Case(f"disdrometer/{rain}", f"{meter} --rain {rain} -o {rain}.nc --json {rain}.json", (f"numbers {rain}.json",))
        for rain in ("1.2", "8.5")
    )
    preset = "disdrometer --preset saved/settings/preset.yaml --area 0.1 --seconds 30 --record 30"
    fit = "calibrate 1.2.nc 8.5.nc -o fit.yaml --intensities 1.2,8.5 --half-width 0.4 --resamples 20 --force"
    columns = "--columns saved/settings/columns.yaml"
    return (
        *meters,
        Case("disdrometer/preset", f"{preset} --json preset.json", ("numbers preset.json",)),
        Case("info/disdrometer", "info 8.5.nc --json info.json", ("numbers info.json",)),
        Case("info/table", f"info saved/drops.csv {columns} --json table.json", ("numbers table.json",)),
        Case("calibrate", f"{fit} --json calibrate.json", ("numbers calibrate.json",)),
    )


def wet_looks() -> Chain:
    """Return views made wet, a scene recolored to them, and how they compare."""
    views = f"transfer {CROSSING} --method wet --views rig --count 6 --width 96"
    recolor = f"recolor {CROSSING} --images wet -o recolored --iterations 4 --held-out 3"
    fid = "evaluate fid wet half --extractor pixels16"
    return (
        Case("transfer", f"{views} -o wet --json wet.json", ("numbers wet.json", "pixels wet/**/*.png")),
        Case("transfer/half", f"{views} -o half --wetness 0.3 --seed 2", ("pixels half/**/*.png",)),
        Case("recolor", f"{recolor} --json recolor.json", ("numbers recolor.json", "scene recolored")),
        Case("evaluate/images", "evaluate images half wet --json images.json", ("numbers images.json",)),
        Case("evaluate/consistency", "evaluate consistency wet half --json views.json", ("numbers views.json",)),
        Case("evaluate/fid", f"{fid} --resamples 20 --json fid.json", ("numbers fid.json",)),
    )


def lidar() -> Case:
    """Return a lidar's sweeps in rain."""
    options = "--sensor saved/settings/lidar.yaml --rain 0,8.5 --seeds 2 --sweeps 2 --json lidar.json"
    results = "numbers lidar.json", "arrays lidar/**/*.npz"
    return Case("evaluate/lidar", f"evaluate lidar {CROSSING} -o lidar {options}", results)


def sweeps() -> Chain:
    """Return a sweep of drives and one of frames."""
    made = {"drives": "rollout drives/rollouts/*.jsonl", "frames": "pixels frames/clips/**/*.png"}
    return tuple(
        Case(
            f"sweep/{name}",
            f"sweep saved/sweep/{name}.yaml -o {name} --workers 0 --json {name}.json",
            (f"numbers {name}.json", f"table {name}/jobs.jsonl", f"numbers {name}/summary.json", results),
        )
        for name, results in made.items()
    )
