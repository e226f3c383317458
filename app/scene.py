"""`gsrain info` and `convert`: inspection and conversion of scenes; options about scenes."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from gsrain_engine.choices import READ_FORMATS, WRITTEN_FORMATS
from gsrain_engine.plugins import SCENE_FORMATS, find_extensions
from gsrain_engine.safe_io.file_kinds import find_file_kind

from .console import counted, print, print_lines, progress_bar, run_with_progress, wide_console
from .options import AllowOutside, JsonFile, Orientation, check_within, flag, let_names_lead_outside, option
from .outputs import check_image, check_scene_target, check_writable, lock_outputs, write_numbers

if TYPE_CHECKING:
    from gsrain_engine.datasets.capture import Capture
    from gsrain_engine.datasets.pose_check import PoseCheck
    from gsrain_engine.datasets.summary import CaptureSummary
    from gsrain_engine.report.table import Cell
    from gsrain_engine.scene.camera_path import CameraPath
    from gsrain_engine.scene.named_view import NamedView
    from gsrain_engine.scene.scene import Actor, Layer, Scene


Columns = Annotated[
    Path | None, option("YAML file that describes the columns of a disdrometer table of unknown format.")
]


# gsrain info


def info(
    scene: Annotated[str, option('Scene, capture or disdrometer file; "street" is the built-in scene.')],
    /,
    *,
    check: Annotated[bool, flag("Capture: read all images, and check the poses.")] = False,
    overlay: Annotated[Path | None, option("Capture: write an image of views with points and boxes.")] = None,
    columns: Columns = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Print what a scene holds (counts, bounds, harmonics, memory) or a capture (cameras, lidar, boxes, problems).

    Of a disdrometer file: instrument, records, drops, rain, rejected records with reasons, and agreement of its rates.
    Of any other file, such as a camera path or a checkpoint: its kind, by its content, and what to do with it.
    """
    from gsrain_engine.datasets.open_capture import capture_format, capture_hint
    from gsrain_engine.datasets.open_source import names_scene
    from gsrain_engine.scene.formats.scene_files import INNER_SCENE
    from gsrain_engine.scene.open import scene_folder_of

    check_image("--overlay", overlay)
    check_writable(overlay, json)
    let_names_lead_outside(allow_outside)
    path, is_scene = Path(scene), names_scene(scene)
    inner = scene_folder_of(path / INNER_SCENE)
    if not is_scene and capture_format(scene) is not None:
        numbers = capture_info(path, check, overlay)
        if inner is not None:  # the output of gsrain street also holds a scene
            numbers |= _scene_info(scene)
    elif check or overlay is not None:
        raise ValueError(f"{scene}: --check and --overlay are for captures, and this is none that is known")
    elif not is_scene and inner is None and path.is_dir():
        found = "neither a scene (scene.json, meta.json of SOG, or scene.pth of HUGSIM) nor a capture that is known"
        raise ValueError(f"{scene}: {found}{capture_hint(path)}")
    elif columns is None and not is_scene and (kind := find_file_kind(path)) is not None and kind.is_used:
        print(f"{scene}: {kind.words}")
        numbers = {"kind": kind.words}
    elif columns is not None or (not is_scene and path.is_file()):
        numbers = disdrometer_info(path, columns)
    else:
        numbers = _scene_info(scene)
    write_numbers(json, numbers)


def _scene_info(scene: str) -> dict[str, Any]:
    """Print a scene's contents; returns the printed numbers."""
    from gsrain_engine.scene.open import load_scene

    opened = load_scene(scene)
    rows = [_member(each) for each in opened.members]
    numbers = {
        "scene": opened.name,
        "gaussians": opened.gaussian_count,
        **count_flagged(opened.members),
        "memory_bytes": sum(row["memory_bytes"] for row in rows),
        "metres_per_unit": opened.metres_per_unit,
        "metres_per_unit_is_assumed": opened.unit_is_assumed,
        "up": list(opened.up),
        "up_is_assumed": opened.up_is_assumed,
        "origin": list(opened.origin),
        "rigs": {name: [camera.name for camera in cameras] for name, cameras in opened.rigs.items()},
        "named_views": [
            {"name": view.name, "time_s": view.time_s, "intensity_mm_h": view.intensity_mm_h} for view in opened.views
        ],
        "members": rows,
        **_extent(opened),
    }
    _print(opened, numbers)
    return numbers


def _member(member: "Layer | Actor") -> dict[str, Any]:
    import numpy as np

    from gsrain_engine.scene.scene import Layer, bounds

    gaussians, marks = member.gaussians, count_flagged([member])
    low, high = bounds(gaussians) if len(gaussians) else (np.zeros(3), np.zeros(3))
    return {
        "name": member.name,
        "kind": member.kind if isinstance(member, Layer) else member.class_name,
        "gaussians": len(gaussians) - marks["deleted"],
        **marks,
        "sh_degree": gaussians.sh_degree,
        "minimum": [round(float(v), 3) for v in low],
        "maximum": [round(float(v), 3) for v in high],
        "wet_colors": member.wet_sh is not None,
        "memory_bytes": gaussians.nbytes + (member.wet_sh.nbytes if member.wet_sh is not None else 0),
    }


def _extent(scene: "Scene") -> dict[str, Any]:
    """Return the extent of the dense core and of the shell around it, in the world (meters, z up)."""
    import numpy as np

    from gsrain_engine.editor.viewport.camera import find_scene_core

    core = find_scene_core(scene)
    low, high = ([round(float(v), 3) for v in corner] for corner in (core.low, core.high))
    numbers: dict[str, Any] = {"core_m": {"minimum": low, "maximum": high}, "shell": None}
    if core.shell is not None:
        count = sum(int(np.count_nonzero(core.shell.holds(part))) for part in scene.parts())
        share = round(count / max(scene.gaussian_count, 1), 4)
        numbers["shell"] = {"gaussians": count, "share": share, "radius_m": round(core.shell.radius_m, 3)}
    return numbers


def _print(scene: "Scene", numbers: dict[str, Any]) -> None:
    from gsrain_engine.report.table import Table, columns

    console = wide_console()
    flags = flagged_text({kind: numbers[kind] for kind in ("deleted", "hidden")})
    size = f"{numbers['memory_bytes'] / 2**20:.1f} MiB"
    console.print(f"{scene.name}: {numbers['gaussians']:,} Gaussians{flags}, {size}")
    unit, up = (" (assumed)" * is_assumed for is_assumed in (scene.unit_is_assumed, scene.up_is_assumed))
    direction = ", ".join(f"{v + 0.0:g}" for v in scene.up)  # avoids -0
    console.print(f"1 unit = {scene.metres_per_unit:g} m{unit}, up = ({direction}){up}")
    if any(scene.origin):
        place = ", ".join(f"{v:.10g}" for v in scene.origin)
        console.print(f"its origin is ({place}) of the file's coordinates; positions are relative to it")
    corners = zip("xyz", numbers["core_m"]["minimum"], numbers["core_m"]["maximum"], strict=True)
    ranges = ", ".join(f"{axis} {low + 0.0:.4g} to {high + 0.0:.4g}" for axis, low, high in corners)
    console.print(f"most of it lies at {ranges} m in the world (z up); below, each in its own units and axes")
    shell = numbers["shell"]
    if shell is not None:
        console.print(
            f"far shell, such as a sky: {shell['gaussians']:,} Gaussians ({100 * shell['share']:.2g} %), "
            f"{shell['radius_m']:.4g} m from the middle"
        )
    for name, cameras in numbers["rigs"].items():
        console.print(f"rig {name}: {', '.join(cameras)}")
    if scene.views:
        console.print(f"views: {', '.join(map(_described, scene.views))}")
    titled = columns({"name": "", "kind": "", "Gaussians": ",", "SH degree": "", "wet": "", "minimum": "",
                      "maximum": "", "MiB": ".1f"})  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for row in numbers["members"]:
        corners = [" ".join(f"{v + 0.0:g}" for v in row[key]) for key in ("minimum", "maximum")]
        about = row["name"], row["kind"], row["gaussians"], row["sh_degree"], bool(row["wet_colors"])
        rows.append((*about, *corners, row["memory_bytes"] / 2**20))
    print_lines(Table("Members", titled, rows).text)


def _described(view: "NamedView") -> str:
    return view.name + (f" ({view.contents})" if view.contents else "")


def count_flagged(members: "Sequence[Layer | Actor]") -> dict[str, int]:
    """Count deleted Gaussians, and hidden ones that are not deleted."""
    deleted = hidden = 0
    for flags in (member.marks for member in members):
        deleted += flags.deleted.size if flags.deleted is not None else 0
        if flags.hidden is not None:
            hidden += (flags.hidden if flags.deleted is None else flags.hidden - flags.deleted).size
    return {"deleted": deleted, "hidden": hidden}


def flagged_text(counts: dict[str, int]) -> str:
    """Return the counts in parentheses, or "" if all are zero."""
    words = [f"{count:,} {kind}" for kind, count in counts.items() if count]
    return f" ({', '.join(words)})" if words else ""


def disdrometer_info(file: Path, columns: Path | None) -> dict[str, Any]:
    """Print the contents of a disdrometer file; returns the numbers. Raises `ValueError`."""
    # here, as they load xarray, which the other commands don't need
    from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
    from gsrain_engine.disdrometer.spectra import UnknownKindError
    from gsrain_engine.disdrometer.tables import load_columns
    from gsrain_engine.scene.formats.registry import unknown_format

    try:
        measured = open_disdrometer_file(file, columns and load_columns(columns)).measured()
    except UnknownKindError as error:
        if error.kind is not None:
            found = f"neither a scene, nor a capture, nor a disdrometer file; it is {error.kind}"
            raise ValueError(f"{file}: {found}") from None
        raise ValueError(f"{file}: {unknown_format(file)}; nor measured rain: {error.problem}") from None
    print_lines("\n".join(measured.lines))
    return measured.numbers()


# Captures


def capture_info(path: Path, check: bool, overlay: Path | None) -> dict[str, Any]:
    """Print the contents of a capture; `check` reads all images and checks poses, `overlay` is an image to write.

    Returns the printed numbers. Raises `CaptureError`.
    """
    from PIL import Image

    from gsrain_engine.datasets.bags.containers import recognizes_bag
    from gsrain_engine.datasets.bags.reader import read_bag_recording
    from gsrain_engine.datasets.open_capture import capture_format, open_capture
    from gsrain_engine.datasets.summary import contact_sheet, summarized
    from gsrain_engine.render.images import write_image

    found = capture_format(path)
    others: tuple[str, ...] = ()
    if recognizes_bag(path):
        bag = read_bag_recording(path)
        capture, others = bag.capture, tuple(topic.name for topic in bag.others)
    else:
        capture = open_capture(path)
    checks: tuple[PoseCheck, ...] = ()
    if check:
        capture, checks = _checked(capture)
    summary = summarized(capture)
    kind = found.name if found is not None else ""
    _print_capture(summary, kind, checks, check)
    if others:
        print(f"topics that rain does not change: {', '.join(others)}")
    if overlay is not None:
        write_image(overlay, Image.fromarray(contact_sheet(capture)))
        print(f"{overlay}: points and boxes drawn into views")
    numbers = {"capture": summary.name, "format": kind, **asdict(summary)}
    numbers |= {"other_topics": list(others)} if others else {}
    return numbers | ({"checks": [asdict(each) for each in checks]} if check else {})


def _checked(capture: "Capture") -> "tuple[Capture, tuple[PoseCheck, ...]]":
    from gsrain_engine.datasets.capture import readable_images
    from gsrain_engine.datasets.pose_check import check_poses

    with progress_bar("Checking", 2.0) as advance:
        done = 0.0

        def show(fraction: float) -> None:
            nonlocal done
            advance(fraction - done)
            done = fraction

        capture = readable_images(capture, show)
        checks = check_poses(capture, lambda fraction: show(1.0 + fraction))
        show(2.0)  # also if there is nothing to check poses with
        return capture, checks


def _print_capture(summary: "CaptureSummary", kind: str, checks: "tuple[PoseCheck, ...]", checked: bool) -> None:
    from gsrain_engine.report.table import Table, columns

    console = wide_console()
    lasts = f" over {summary.seconds:.1f} s" if summary.seconds >= 0.05 else ""
    console.print(f"{summary.name}: {kind}, {counted(summary.views, 'view')}{lasts}")
    if summary.has_poses:
        up = ", ".join(f"{round(value, 3) + 0.0:g}" for value in summary.up)
        console.print(f"{_places(summary)}; up = ({up})")
    if summary.points:
        console.print(f"{counted(summary.points, 'point')} on surfaces")
    if summary.sweeps:
        console.print(f"lidar: {counted(summary.sweeps, 'sweep')}, {counted(summary.lidar_points, 'point')}")
    if summary.boxes:
        console.print(f"boxes: {', '.join(f'{count} {name}' for name, count in summary.boxes.items())}")
    if summary.has:
        console.print(f"each view has: {', '.join(summary.has)}")
    for name, counts in summary.attributes.items():
        console.print(f"{name}: {', '.join(f'{value} ({count})' for value, count in counts.items())}")
    rows: list[tuple[Cell, ...]] = []
    for each in summary.sensors:
        size = f"{each.width}x{each.height}"
        if each.sizes > 1:
            (a, b), (c, d) = each.smallest_px, each.largest_px
            size = f"{a}x{b} to {c}x{d} ({each.sizes} sizes)"
        focal, fov = f"{each.focal_px[0]:.1f} {each.focal_px[1]:.1f}", f"{each.horizontal_fov_deg:.1f} deg"
        rows.append((each.name or "-", each.views, size, focal, fov, each.lens.partition(" ")[0] or "straight"))
    print_lines(Table("Cameras", columns(_CAMERA_COLUMNS), rows).text)
    for each in checks:
        console.print(f"{each.verdict}: {each.told}")
    if checked and not checks and summary.has_poses:
        console.print("poses: nothing to check them by (no lidar, and no neighboring views that share enough)")
    for problem in summary.problems:
        console.print(f"problem: {problem}")


_CAMERA_COLUMNS = "camera", "views", "size", "focal length px", "field of view", "lens"


def _places(summary: "CaptureSummary") -> str:
    sizes = [high - low for low, high in zip(summary.minimum, summary.maximum, strict=True)]
    if max(sizes) < 1e-6:
        return "the camera stood still"
    unit = "m" if summary.is_metric else "units of unknown length"
    course = f"; their way is {summary.course:.2f} {unit} long" if summary.course > 0 else ""
    return f"the cameras stood within {' x '.join(f'{size:.2f}' for size in sizes)} {unit}{course}"


# gsrain convert


_INSTALLED = [f".{each.name.lower()}" for each in find_extensions(SCENE_FORMATS)]
_READ, _WRITTEN = (" ".join([*ours, *_INSTALLED]) for ours in (READ_FORMATS, WRITTEN_FORMATS))


def convert(
    source: Annotated[str, option(f"Scene file ({_READ}) or folder.")],
    target: Annotated[Path, option(f"File to write ({_WRITTEN}), or a folder for a scene folder.")],
    /,
    *,
    wetness: Annotated[
        float | None, option("Bake in the colors of a wetness, 0..1; default for a file: 0, with --wet 1.")
    ] = None,
    wet: Annotated[
        bool, flag("Compute wet colors first if the scene has none, as in render: a folder gets both sets of colors.")
    ] = False,
    orientation: Orientation | None = None,
    level: Annotated[bool, flag("Find the ground, and rotate the scene until it is level.")] = False,
    camera_height: Annotated[
        float | None, option("Level the scene, and scale it to this height of its cameras in m.")
    ] = None,
    drive: Annotated[
        str | None,
        option(
            "Add an ego vehicle with a front camera that drives along a camera path: own for the scene's, or a "
            "file (ours, nerfstudio's, cameras.json of 3DGS, a .glb). gsrain drive needs one."
        ),
    ] = None,
    speed: Annotated[float | None, option("Speed of --drive in m/s; default: its own times, or walking pace.")] = None,
    json: JsonFile = None,
) -> None:
    """Convert a scene. A scene folder stores orientation and unit, and a large one a level-of-detail tree.

    A single file gets all visible layers, and actors at their place at time 0, in meters and its format's axes; a .usdz
    keeps layers, tracks and rigs. One line names what the file leaves out.
    """
    from gsrain_engine.editor.edits.level import level_from_ground, set_camera_height
    from gsrain_engine.scene.formats.registry import lost_in_file
    from gsrain_engine.scene.formats.scene_files import names_scene_folder, write_scene
    from gsrain_engine.scene.lod_tree import MIN_GAUSSIANS
    from gsrain_engine.scene.open import load_scene, load_sorted_scene, sorted_with_trees
    from gsrain_engine.scene.transforms import with_wetness_baked

    check_within("--wetness", wetness, 0, 1)
    check_scene_target(target)
    check_writable(json)
    # wet colors are cached for the order in which render draws
    scene = (orientation or Orientation()).of(load_sorted_scene(source) if wet else load_scene(source))
    lock_outputs(target)
    if level or camera_height is not None:
        scene = level_from_ground(scene)
        up = ", ".join(f"{v:.4g}" for v in scene.up)
        print(f"up = ({up}) in the scene's axes, the ground {scene.ground_m:.3g} m high")
    if camera_height is not None:
        scene = set_camera_height(scene, camera_height)
        print(f"1 unit = {scene.metres_per_unit:.4g} m")
    if speed is not None and drive is None:
        raise ValueError(f"--speed {speed:g}: is that of --drive, which is not asked for")
    if drive is not None:
        scene = _driven(scene, drive, speed)
    if wet and not scene.has_rainy_light:
        from gsrain_engine.recolor.cached_colors import cached_wet_scene  # kernels take a second to load

        scene = run_with_progress(cached_wet_scene(scene))
    if wet and wetness is None and not names_scene_folder(target):
        wetness = 1.0
    if wetness is not None:
        if all(each.wet_sh is None for each in scene.members):
            raise ValueError(f"--wetness {wetness:g}: {source} has no wet colors; --wet computes them first")
        scene = with_wetness_baked(scene, wetness)
    is_large = names_scene_folder(target) and scene.gaussian_count >= MIN_GAUSSIANS
    write_scene(sorted_with_trees(scene) if is_large else scene, target, in_drawing_order=is_large)
    if names_scene_folder(target):
        count, left_out = scene.gaussian_count, 0
        print(f"{target}: {count:,} Gaussians{flagged_text(count_flagged(scene.members))}")
    else:
        left_out = sum(part.left_out.size for part in scene.parts() if part.left_out is not None)
        count = sum(len(part.gaussians) for part in scene.parts()) - left_out
        flags = f"; {left_out:,} deleted or hidden ones are left out" if left_out else ""
        print(f"{target}: {count:,} Gaussians{flags}")
        lost = lost_in_file(scene, target)
        if lost:
            print(f"{target.name} leaves out: {', '.join(lost)}")
    write_numbers(json, {"gaussians": count, "left_out": left_out})


def _driven(scene: "Scene", drive: str, speed: float | None) -> "Scene":
    """Let an ego vehicle drive along a path, at its own times, or at the given or assumed speed."""
    from gsrain_engine.editor.edits.actors import drive_along, drive_along_own_path
    from gsrain_engine.scene.camera_path_io import read_camera_path

    path = scene.path if drive == "own" else read_camera_path(drive, scene)
    if path is None:
        return drive_along_own_path(scene)  # raises the reason
    timing = timed_path(path, speed, scene.metres_per_unit)
    if timing.line is not None:
        print(f"{drive}: {timing.line}")
    return drive_along(scene, timing.path)


# Speed of a camera path


@dataclass(frozen=True, slots=True)
class TimedPath:
    """A camera path with its speed."""

    path: "CameraPath"
    line: str | None
    """One line for people, if the speed is not the path's own."""
    speed_m_s: float | None
    """None if the path has its own times."""
    is_assumed: bool


def timed_path(
    path: "CameraPath", speed_m_s: float | None, metres_per_unit: float = 1.0, *, is_still: bool = False
) -> TimedPath:
    """Time a path at the given speed, by its own times, or at walking pace; in a still the latter camera is at rest.

    Raises ValueError, which names the option, for a speed out of bounds.
    """
    from gsrain_engine.scene.camera_path_edit import WALKING_M_S, with_constant_speed

    if speed_m_s is not None:
        check_within("--speed", speed_m_s, 1e-3, 1e3, "m/s")
        return TimedPath(with_constant_speed(path, speed_m_s / metres_per_unit, is_timed=True), None, speed_m_s, False)
    if path.is_timed:
        return TimedPath(path, None, None, False)
    walked = with_constant_speed(path, WALKING_M_S / metres_per_unit)
    if is_still:
        line = "photos without times: the camera is at rest (--speed M_S lets it move)"
        return TimedPath(walked, line, 0.0, True)
    line = f"photos without times: walking pace, {WALKING_M_S:g} m/s, is assumed (--speed M_S says otherwise)"
    return TimedPath(replace(walked, is_timed=True), line, WALKING_M_S, True)
