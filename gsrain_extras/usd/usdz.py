"""OpenUSD scenes in one file (`.usdz`): Gaussians as `ParticleField3DGaussianSplat`, tracks and the cameras of rigs.

The stage is in the world frame, meters and z up. Layers and actors keep their Gaussians as they are, each below a prim
with its placement; that of an actor, and that of the ego vehicle with the cameras of the rigs, is animated. For
AlpaSim, `metadata.yaml`, `rig_trajectories.json` and `sequence_tracks.json` of NVIDIA's NuRec lie in the file, too.
"""

import errno
import json
import os
import re
import secrets
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
import psutil
from jaxtyping import Float32, Float64

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.safe_io.limits import address_space_bytes, read_file, reading_deadline
from gsrain_engine.scene.formats import Format, check_room, checked_gaussians
from gsrain_engine.scene.formats.stored_zip import open_zip, read_member, write_stored_zip
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from gsrain_engine.scene.geometry import quaternions_from_matrices
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, RigCamera, Scene, is_sky
from gsrain_engine.scene.transforms import FILE_UP, bake_item, flatten_scene, lost_far_out, transform_gaussians

from .nurec import METADATA, nurec_files, scene_id_in
from .nurec_volume import CHECKPOINT, scene_in_usdz, state_in_usdz, state_of_volume
from .splatsim import is_splatsim, lost_in_splatsim, scene_in_zip, write_splatsim, write_splatsim_scene
from .usd_stage import ARRAYS, RESULT, pxr_module, read_stage

_LAYER_SUFFIXES = (".usd", ".usda", ".usdc")
_ROOT = "default.usdc"
_LARGEST_METADATA = 2**20  # bytes
_ALIGNMENT = 64  # bytes at whose multiples the files in a .usdz begin
_CODES_PER_SECOND = 24.0
_SPARE_BYTES = 2**32  # of address space that USD takes without use
_SIMILAR = 1e-4  # relative difference between the scales of a prim's axes
_DISK_ERROR = re.compile(r"writing file: ([^'\n]+)")
_TO_USD_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV's camera (y down, z forward) to USD's (y up, z back)
_FILM = 0.36  # width of a film of 36 mm in tenths of the stage's unit, the meter, as USD's cameras have it
_UPS = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


def read_usdz(path: Path) -> Gaussians:
    """Read all Gaussians of a `.usdz` as at its first moment, in meters and PLY axes; see `read_usdz_scene`."""
    return flatten_scene(read_usdz_scene(path))


def read_usdz_scene(path: Path) -> Scene:
    """Read layers, actors with tracks, the ego vehicle's track and the cameras on it.

    A field of Gaussians below a prim that moves belongs to an actor, any other one is a layer. Cameras belong to a rig
    if they move; USD's cameras have no size in pixels: those of other programs get a width of 1920. The scene has the
    name by which AlpaSim asks for it (`scene_id` in `metadata.yaml`), or that of the file.

    Scenes of SplatSim and NuRec are read as those, see `splatsim.py` and `nurec_volume.py`. Raises `SceneFormatError`
    if the file is damaged, has no Gaussians, or refers to files outside of it.
    """
    data = read_file(path)
    with open_zip(path, data) as archive:
        if is_splatsim(path, archive):
            return scene_in_zip(path, archive, len(data))
        has_metadata = METADATA in archive.namelist()
        name = scene_id_in(read_member(path, archive, METADATA, _LARGEST_METADATA)) if has_metadata else None
        with tempfile.TemporaryDirectory(prefix="gsrain-usdz-") as folder:
            root = _unpack(path, archive, len(data), Path(folder) / "stage")
            arrays = Path(folder) / "arrays"
            arrays.mkdir()
            stage = _stage(path, root, arrays)
            if stage["fields"] or not (stage["volumes"] or CHECKPOINT in archive.namelist()):
                scene = _scene_of(path, stage, arrays)
            else:
                scene = _nurec_scene(path, archive, len(data), stage)
    return scene if name is None else replace(scene, name=name)


def _nurec_scene(path: Path, archive: zipfile.ZipFile, most: int, stage: dict[str, Any]) -> Scene:
    """Scene of the volumes of NuRec, or of its checkpoint if it has none, where the first of them is placed."""
    volumes = stage["volumes"]
    states = [state_of_volume(path, read_member(path, archive, each["file"], most)) for each in volumes]
    scene = scene_in_usdz(path, archive, states or [state_in_usdz(path, archive, most)], _name_of(path))
    matrix = _similarity(path, "volume", volumes[0]["matrix"]) if volumes else np.eye(4)
    return replace(
        scene,
        layers=tuple(replace(each, to_scene=matrix) for each in scene.layers),
        actors=tuple(replace(each, track=each.track.moved(matrix)) for each in scene.actors),
        ego=scene.ego if scene.ego is None else scene.ego.moved(matrix),
        up=_UPS.get(stage["up"], FILE_UP),
    )


def _name_of(path: Path) -> str:
    return path.name[: -len(".usdz")] or "scene"


def _unpack(path: Path, archive: zipfile.ZipFile, most: int, folder: Path) -> Path:
    """Write the USD layers in the file to a folder, after their checksums are verified; returns the first."""
    root: Path | None = None
    names = [name for name in archive.namelist() if name.lower().endswith(_LAYER_SUFFIXES)]
    for name in names:
        parts = PurePosixPath(name).parts
        if PurePosixPath(name).is_absolute() or ".." in parts or "\\" in name or ":" in name or "\0" in name:
            raise SceneFormatError(path, f"{name[:40]!r} is no name of a file inside of it")
        place = folder.joinpath(*parts)
        content = read_member(path, archive, name, most)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
        root = root or place
    if root is None:
        raise SceneFormatError(path, "there is no USD layer (.usd, .usda, .usdc) in the zip file")
    return root


def _stage(path: Path, root: Path, folder: Path) -> dict[str, Any]:
    """Contents of a stage, which another process reads into `folder`."""
    if getattr(sys, "frozen", False):  # a bundle has no Python to run it with
        try:
            return read_stage(root, folder)
        except ValueError as error:
            raise SceneFormatError(path, str(error)) from None
    from . import usd_stage

    limit = int(psutil.virtual_memory().available) + _SPARE_BYTES
    limit_s = reading_deadline(path.stat().st_size).seconds
    command = [sys.executable, "-P", usd_stage.__file__, str(root), str(folder), str(limit)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        ended = subprocess.run(command, env=environment, capture_output=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        raise SceneFormatError(path, f"its USD layers can't be read within {limit_s:.0f} s") from None
    if not (folder / RESULT).is_file():
        problem = f"its USD layers are damaged: the library that reads them ended with {ended.returncode}"
        if (space := address_space_bytes()) is not None and space < limit:
            problem += f", or needs more address space than the limit of {space >> 20} MiB (ulimit -v)"
        raise SceneFormatError(path, problem)
    found = json.loads((folder / RESULT).read_text())
    if "error" in found:
        raise SceneFormatError(path, found["error"])
    return found


def _scene_of(path: Path, stage: dict[str, Any], folder: Path) -> Scene:
    fields = stage["fields"]
    if not fields:
        raise SceneFormatError(path, "it has no Gaussians (ParticleField3DGaussianSplat, or a volume of NuRec)")
    largest = max(field["coefficients"] for field in fields)
    if largest not in COEFFICIENTS_OF_DEGREE:
        raise SceneFormatError(path, f"SH with {largest} coefficients can't be read")
    check_room(path, sum(field["count"] for field in fields), largest)
    unit = stage["metres_per_unit"]
    if not 0 < unit < np.inf:
        raise SceneFormatError(path, f"metersPerUnit must be above 0, not {unit:g}")
    movers = {mover["path"]: _Mover.of(path, mover) for mover in stage["movers"]}
    layers: list[Layer] = []
    parts: dict[str, list[Gaussians]] = {}
    for field in fields:
        gaussians = _gaussians_of(path, field, folder)
        matrix = _similarity(path, field["name"], field["matrix"])
        if field["mover"] is None or movers[field["mover"]].is_ego:
            kind = "sky" if field["role"] == "sky" else "background"
            layers.append(Layer(_unused(field["name"], {each.name for each in layers}), gaussians, kind, matrix))
        else:
            mover = movers[field["mover"]]
            with np.errstate(over="ignore"):
                placed = transform_gaussians(gaussians, mover.scaling @ np.linalg.inv(mover.rest) @ matrix)
            parts.setdefault(field["mover"], []).append(placed)
    actors: list[Actor] = []
    for name, gaussians in parts.items():
        mover, joined = movers[name], Gaussians.concatenate(gaussians)
        length, width, height = np.ptp(joined.means, axis=0).tolist() if len(joined) else (0.0, 0.0, 0.0)
        size = mover.size_lwh or (length, width, height)
        identity = _unused(mover.name, {each.id for each in actors})
        actors.append(Actor(identity, mover.class_name or "object", size, joined, mover.track))
    rigs: dict[str, tuple[RigCamera, ...]] = {}
    egos = [mover for mover in movers.values() if mover.is_ego]
    for camera in stage["cameras"]:
        mover = movers[camera["mover"]]
        if mover in egos[:1]:
            rigs[camera["rig"]] = (*rigs.get(camera["rig"], ()), _rig_camera(path, camera, mover.rest, unit))
    return Scene(
        _name_of(path),
        tuple(layers),
        tuple(actors),
        metres_per_unit=unit,
        up=_UPS.get(stage["up"], FILE_UP),
        rigs=rigs,
        ego=egos[0].track if egos else None,
    )


class _Mover(NamedTuple):
    name: str
    class_name: str
    size_lwh: tuple[float, float, float] | None
    is_ego: bool
    track: PoseTrack
    rest: Float64[np.ndarray, "4 4"]
    """Pose at the first moment, with scale."""
    scaling: Float64[np.ndarray, "4 4"]

    @classmethod
    def of(cls, path: Path, mover: dict[str, Any]) -> "_Mover":
        poses = np.array([_similarity(path, mover["name"], pose) for pose in mover["poses"]])
        scale = float(np.cbrt(np.linalg.det(poses[0, :3, :3])))
        turns = poses[:, :3, :3] / np.cbrt(np.linalg.det(poses[:, :3, :3]))[:, None, None]
        quaternions = np.asarray(quaternions_from_matrices(turns), np.float64)
        times = np.array(mover["times"], np.float64)
        if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise SceneFormatError(path, f"{mover['name']}: its times must be finite and increase")
        track = PoseTrack(times, poses[:, :3, 3], quaternions, np.array(mover["valid"], np.bool_))
        length, width, height = mover["size_lwh"] or (0.0, 0.0, 0.0)
        size = None if mover["size_lwh"] is None else (length, width, height)
        is_ego = mover["role"] == "ego"
        rest = _similarity(path, mover["name"], mover["rest"])
        return cls(mover["name"], mover["class"], size, is_ego, track, rest, np.diag([scale, scale, scale, 1.0]))


def _similarity(path: Path, name: str, values: list[list[float]]) -> Float64[np.ndarray, "4 4"]:
    matrix = np.array(values, np.float64)
    with np.errstate(all="ignore"):  # what is too large or no number is rejected
        squares = matrix[:3, :3].T @ matrix[:3, :3]
    scale = np.trace(squares) / 3
    is_regular = np.isfinite(matrix).all() and 0 < scale < np.inf and np.linalg.det(matrix[:3, :3]) > 0
    if not is_regular or np.abs(squares / scale - np.eye(3)).max() > _SIMILAR:
        raise SceneFormatError(path, f"{name}: its transform must move, rotate and scale equally along all axes")
    return matrix


def _gaussians_of(path: Path, field: dict[str, Any], folder: Path) -> Gaussians:
    arrays = [np.load(folder / f"{field['index']}.{name}.npy", allow_pickle=False) for name in ARRAYS]
    return replace(checked_gaussians(path, *arrays), antialiased=field["antialiased"])


def _rig_camera(path: Path, camera: dict[str, Any], ego: Float64[np.ndarray, "4 4"], unit: float) -> RigCamera:
    matrix = np.linalg.inv(ego) @ _similarity(path, camera["name"], camera["matrix"]) @ _TO_USD_CAMERA
    matrix[:3, :3] /= np.cbrt(np.linalg.det(matrix[:3, :3]))
    matrix[:3, 3] *= unit
    width, height, fx, fy, cx, cy = camera["intrinsics"]
    if not (1 <= width <= 16384 and 1 <= height <= 16384 and min(fx, fy) > 0 and np.isfinite([fx, fy, cx, cy]).all()):
        raise SceneFormatError(path, f"camera {camera['name']}: its size or focal length is out of range")
    exposure_s = camera["exposure_s"] if 0 < camera["exposure_s"] < np.inf else 0.004
    return RigCamera(camera["name"], int(width), int(height), fx, fy, cx, cy, matrix, exposure_s)


def _unused(name: str, used: set[str]) -> str:
    number, found = 2, name
    while found in used:
        found, number = f"{name} {number}", number + 1
    return found


# Writing


def write_usdz(gaussians: Gaussians, path: Path) -> None:
    """Write Gaussians, in PLY axes, as a scene of one layer."""
    write_usdz_scene(Scene("scene", layers=(Layer("gaussians", gaussians),), up=FILE_UP), path)


def write_usdz_scene(scene: Scene, path: Path) -> None:
    """Write all visible layers and actors, the ego vehicle's track and the cameras of its rigs. Deterministic.

    Opacity and grading are baked into the Gaussians, wet colors are left out.
    """
    end = f".{secrets.token_hex(4)}.part"  # as of all partial files: removed if this process is killed
    with tempfile.TemporaryDirectory(prefix=".usdz-", suffix=end, dir=path.parent) as folder:
        root = Path(folder) / _ROOT
        try:
            _write_stage(scene, root)
        except pxr_module("Tf").ErrorException as error:
            found = _DISK_ERROR.search(str(error))
            raise OSError(errno.EIO, found[1] if found else "the USD layer can't be written", str(path)) from None
        files: Mapping[str, bytes | Path] = {_ROOT: root, **nurec_files(scene)}
        write_stored_zip(path, files, _ALIGNMENT)


def _write_stage(scene: Scene, file: Path) -> None:
    Gf, Sdf, Usd, UsdGeom = map(pxr_module, ("Gf", "Sdf", "Usd", "UsdGeom"))

    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(_CODES_PER_SECOND)
    stage.SetFramesPerSecond(_CODES_PER_SECOND)
    world = UsdGeom.Xform.Define(stage, "/World")
    if any(scene.origin):
        place = scene.scene_to_world[:3, :3] @ np.array(scene.origin)
        world.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*place.tolist()))
    stage.SetDefaultPrim(world.GetPrim())
    names = _PrimNames()
    tracks = [actor.track for actor in scene.actors if actor.visible] + ([scene.ego] if scene.ego else [])
    moments = [time for track in tracks for time in track.times.tolist()]
    if moments:
        stage.SetStartTimeCode(min(moments) * _CODES_PER_SECOND)
        stage.SetEndTimeCode(max(moments) * _CODES_PER_SECOND)
    for member in (each for each in scene.members if each.visible and _first_s(each) is not None):
        parent = "/World/layers" if isinstance(member, Layer) else "/World/actors"
        UsdGeom.Scope.Define(stage, parent)
        node = UsdGeom.Xform.Define(stage, names.child(parent, member.name))
        node.GetPrim().SetDisplayName(member.name)
        role = "actor" if isinstance(member, Actor) else "sky" if is_sky(member) else "layer"
        node.GetPrim().CreateAttribute("gsrain:role", Sdf.ValueTypeNames.Token).Set(role)
        item = scene.part(member, _first_s(member) or 0.0)
        baked = member.gaussians if item is None else bake_item(item)
        if isinstance(member, Actor):
            node.GetPrim().CreateAttribute("gsrain:class", Sdf.ValueTypeNames.String).Set(member.class_name)
            size = Gf.Vec3d(*(scene.metres_per_unit * edge for edge in member.size_lwh))
            node.GetPrim().CreateAttribute("gsrain:sizeLwh", Sdf.ValueTypeNames.Double3).Set(size)
            _animate(node, member.track.moved(scene.scene_to_world))
            if scene.metres_per_unit != 1:
                node.AddScaleOp().Set(Gf.Vec3f(scene.metres_per_unit))
        else:
            matrix = scene.scene_to_world @ member.to_scene
            node.AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
        _write_field(stage, f"{node.GetPath()}/gaussians", member.name, baked)
    if scene.ego is not None and len(scene.ego.times):
        ego = UsdGeom.Xform.Define(stage, "/World/ego")
        ego.GetPrim().CreateAttribute("gsrain:role", Sdf.ValueTypeNames.Token).Set("ego")
        _animate(ego, scene.ego.moved(scene.scene_to_world))
        for rig, cameras in scene.rigs.items():
            place = UsdGeom.Xform.Define(stage, names.child("/World/ego", rig))
            place.GetPrim().SetDisplayName(rig)
            for camera in cameras:
                _write_camera(stage, names.child(str(place.GetPath()), camera.name), camera)
    stage.GetRootLayer().Save()


def _first_s(member: Layer | Actor) -> float | None:
    """Time at which a member is in the scene; None for an actor that never is."""
    if isinstance(member, Layer):
        return 0.0
    return next(iter(member.track.times[member.track.valid].tolist()), None)


class _PrimNames:
    """Paths of prims from any names."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def child(self, parent: str, name: str) -> str:
        Tf = pxr_module("Tf")

        path = f"{parent}/{Tf.MakeValidIdentifier(name)}"
        number, found = 2, path
        while found in self._used:
            found, number = f"{path}_{number}", number + 1
        self._used.add(found)
        return found


def _animate(node: Any, track: PoseTrack) -> None:
    """Add a track as samples of a translation and a rotation, and as visibility where it has gaps."""
    Gf, UsdGeom = map(pxr_module, ("Gf", "UsdGeom"))

    translate = node.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
    orient = node.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
    visibility = None if track.valid.all() else node.CreateVisibilityAttr()
    rows = zip(
        track.times.tolist(), track.positions.tolist(), track.quaternions_wxyz.tolist(), track.valid, strict=True
    )
    for time_s, position, (w, x, y, z), is_valid in rows:
        code = time_s * _CODES_PER_SECOND
        translate.Set(Gf.Vec3d(*position), code)
        orient.Set(Gf.Quatd(w, x, y, z), code)
        if visibility is not None:
            visibility.Set("inherited" if is_valid else "invisible", code)


def _write_field(stage: Any, path: str, name: str, gaussians: Gaussians) -> None:
    UsdVol, Vt = map(pxr_module, ("UsdVol", "Vt"))

    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, path)
    field.GetPrim().SetDisplayName(name)
    if gaussians.antialiased:
        field.GetPrim().SetCustomDataByKey("antialiased", True)

    def vectors(values: Float32[np.ndarray, "n 3"]) -> Any:
        return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))

    quaternions = np.ascontiguousarray(gaussians.quaternions[:, [1, 2, 3, 0]])  # the real part is the last in memory
    field.CreatePositionsAttr().Set(vectors(gaussians.means))
    field.CreateOrientationsAttr().Set(Vt.QuatfArray.FromNumpy(quaternions))
    field.CreateScalesAttr().Set(vectors(gaussians.scales))
    field.CreateOpacitiesAttr().Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(gaussians.opacities)))
    field.CreateRadianceSphericalHarmonicsDegreeAttr().Set(gaussians.sh_degree)
    field.CreateRadianceSphericalHarmonicsCoefficientsAttr().Set(vectors(gaussians.sh.reshape(-1, 3)))
    field.CreateSortingModeHintAttr().Set("zDepth")
    if len(gaussians):
        reach = 3 * gaussians.scales.max(axis=1, keepdims=True)
        ends = (gaussians.means - reach).min(axis=0), (gaussians.means + reach).max(axis=0)
        field.CreateExtentAttr().Set(vectors(np.stack(ends)))


def _write_camera(stage: Any, path: str, camera: RigCamera) -> None:
    Gf, Sdf, UsdGeom = map(pxr_module, ("Gf", "Sdf", "UsdGeom"))

    node = UsdGeom.Camera.Define(stage, path)
    node.GetPrim().SetDisplayName(camera.name)
    node.AddTransformOp().Set(Gf.Matrix4d((camera.camera_to_ego @ _TO_USD_CAMERA).T.tolist()))
    pixel = _FILM / camera.width
    node.CreateFocalLengthAttr().Set(camera.fx * pixel)
    node.CreateHorizontalApertureAttr().Set(_FILM)
    node.CreateVerticalApertureAttr().Set(camera.height * pixel * camera.fx / camera.fy)
    node.CreateHorizontalApertureOffsetAttr().Set((camera.width / 2 - camera.cx) * pixel)
    node.CreateVerticalApertureOffsetAttr().Set((camera.cy - camera.height / 2) * pixel)
    node.CreateClippingRangeAttr().Set(Gf.Vec2f(0.05, 10_000.0))
    values = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
    node.GetPrim().CreateAttribute("gsrain:intrinsics", Sdf.ValueTypeNames.DoubleArray).Set(values)
    node.GetPrim().CreateAttribute("gsrain:exposureS", Sdf.ValueTypeNames.Double).Set(camera.exposure_s)


def lost_in_usdz(lost: list[str]) -> list[str]:
    """Select from phrases of `lost_when_flattened` those that apply to a `.usdz`."""
    lost = lost_far_out(lost)
    kept = ("ego vehicle", "rig camera", "the division into", "which layer is the sky", "actor")
    return [phrase for phrase in lost if "hidden" in phrase or not any(word in phrase for word in kept)]


FORMAT = Format(
    ".usdz",
    read_usdz,
    write_usdz,
    "OpenUSD's `ParticleField3DGaussianSplat`, lossless; keeps layers, actors with tracks, the ego vehicle's track "
    "and rigs, also as NuRec's JSON files",
    read_scene=read_usdz_scene,
    write_scene=write_usdz_scene,
    lost=lost_in_usdz,
    packages=("pxr",),
)
SPLATSIM = Format(
    ".splatsim.usdz",
    read_usdz,
    write_splatsim,
    "scenes of SplatSim (Autoware), `splatsim.scene/v2` and `/v3`, which is written: chunks of SPZ, actors with "
    "tracks, rigs. Any `.usdz` is read as what it holds: these, too, and scenes of NuRec",
    read_scene=read_usdz_scene,
    write_scene=write_splatsim_scene,
    lost=lost_in_splatsim,
)
