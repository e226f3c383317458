"""A scene and its rain as one web page: the scene as a SOG file, a path, and the desktop's rain and shaders.

The page draws what `gsrain render` draws, but for what `left_out_of_page` lists. Its drops are those of `rain.js` and
`splashes.js`, which compute the integers of `drop_field.py` and `impacts.py` again, its mirror of wet ground is that of
`mirror.js`, and its shaders share their common parts with the desktop's. Viewers of others draw no streaks: an alpha of
0.01 is below what they keep in eight bits, and rain adds in linear light.
"""

import base64
import hashlib
import io
import json
import re
import zipfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from jaxtyping import UInt8
from markupsafe import Markup
from msgspec import structs

from ..backends import open_renderer
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.cpu.splats import NEAR_M
from ..render.opengl.shaders import ShaderSource
from ..render.provenance import provenance_of
from ..render.renderer import Renderer
from ..render.sequence import FrameSequence, render_image
from ..render.view import RenderView, rain_camera
from ..report.numbers import write_provenance
from ..report.result import RunResult
from ..report.table import Table, columns
from ..safe_io.files import whole_file
from ..scene.camera import Camera
from ..scene.geometry import quaternions_from_matrices
from ..scene.named_view import NamedView, view_named
from ..scene.progress import Progress
from ..scene.scene import Scene
from ..scene.transforms import world_to_file
from .page_ground import PageGround, page_ground
from .page_mirror import PageMirror, page_mirror
from .page_scene import COLUMNS, POSE_STEP_S, PageScene, page_scene
from .rain_states import STEPS_MM_H, RainStates, check_rain, rain_states

LONGEST_S = 600.0
"""Longest path on a page."""

_AROUND_PATH_M = 100.0
_VIEW_SIZE = (960, 640)  # of a named view, of which only pose and field of view are on the page
_STEP_S = 1 / 30  # between the cameras of the path
_COLUMNS = {"SPLAT_COLUMNS": COLUMNS, "STREAK_COLUMNS": 512}  # of the data textures
_SHADERS = (
    "page_quad.vert",
    "page_project.frag",
    "page_splat.vert",
    "page_splat.frag",
    "page_sky.frag",
    "page_mirror_light.frag",
    "page_mirror_columns.frag",
    "page_mirror_rows.frag",
    "page_picture.frag",
)
_POLICY = "content-security-policy"  # in its place until all scripts are known
_KEYS = (
    ("Drag, wheel", "look around, move ahead; with two fingers, too"),
    ("W A S D, Q E", "move; with Shift faster"),
    ("Space, Home", "play or pause; back to the path"),
    ("+ and -", "more or less rain"),
    ("C", "compare dry and rainy"),
    ("F, L", "full screen; copy a link to this view"),
)

_VIEW_KEYS = "1 to 9", "go to a named view"

_ABOUT = (
    "A scene of Gaussians in calibrated rain, drawn by your graphics card: with the drop sizes, speeds and numbers of "
    "each rainfall intensity, and the drops of the program. Drag the divider to compare, the slider for more rain."
)


@dataclass(frozen=True, slots=True, eq=False)
class PageContents:
    """All that a page holds."""

    title: str
    path_name: str
    scene: PageScene
    rain: RainStates
    views: Sequence[RenderView]
    """Cameras of the path, `_STEP_S` apart."""
    first_view: RenderView
    """View that the page opens with."""
    named_views: Sequence[Mapping[str, Any]]
    """Named views of the scene, as the page reads them: name, camera, time on the path, intensity, ground below."""
    opening: int | None
    """Number of the named view at which the page opens; None opens on the path."""
    floors_m: Sequence[float | None]
    """Heights of the ground below them, where they are known."""
    ground: PageGround | None = None
    mirror: PageMirror | None = None
    start_s: float = 0.0
    """Time of the scene and of the rain at the start of the path."""
    missing: Sequence[str] = ()
    """Phrases for what the page lacks of the rain."""


def write_page(
    renderer: Renderer,
    scene: Scene,
    rain: RainSettings,
    sequence: FrameSequence,
    path_name: str,
    output: Path,
    duration_s: float | None = None,
    opening: NamedView | None = None,
) -> Generator[Progress, None, PageContents]:
    """Write a scene, as it is at the sequence's start, with its rain and the sequence's path to an HTML file.

    `duration_s` shortens the path; `opening` is the named view of the scene at which the page opens. Raises
    `ValueError` for a rain that a page can't draw, or a path longer than `LONGEST_S`.
    """
    check_rain(rain)
    length_s = min(sequence.length_s or 0.0, duration_s or np.inf)
    if length_s > LONGEST_S:
        raise ValueError(f"the path takes {length_s:.0f} s, a page has room for {LONGEST_S:g} s")
    yield Progress(0.0, "Sampling the sky")
    time_s = sequence.start_s
    rainiest = RainSimulation.start(structs.replace(rain, intensity_mm_h=STEPS_MM_H[-1]))
    sky = replace(sequence, rainfall=rainiest).sky(renderer)  # its clouds, too, where the rain itself is off
    content = yield from page_scene(scene, time_s, length_s, mirror=rain.mirror)
    yield Progress(0.9, "Writing the page")
    views = [sequence.shot_at(time_s + step * _STEP_S) for step in range(round(length_s / _STEP_S) + 1)]
    exposure_s = sequence.rainfall.exposure_s(views[0].camera)
    named = [_named_view(scene, sequence, view, length_s) for view in scene.views]
    number = None if opening is None else scene.views.index(opening)
    cameras = _near_path([view.camera for view in views], [view.camera for view, _ in named])
    states = rain_states(rain, scene, {False: sky.at(0.0), True: sky.at(1.0)}, cameras, exposure_s)
    floors = [rain_camera(scene, sequence.rainfall, view).floor_m for view in views]
    contents = PageContents(
        scene.name, path_name, content, states, views, views[0] if number is None else named[number][0],
        [row for _, row in named], number, floors, page_ground(scene, cameras),
        page_mirror(scene, states.states), time_s, left_out_of_page(scene),
    )  # fmt: skip
    with whole_file(output) as written:
        written.write_text(page_html(contents), encoding="utf-8")
    return contents


def publish_page(
    renderer: Renderer,
    scene: Scene,
    rain: RainSettings,
    sequence: FrameSequence,
    path_name: str,
    output: Path,
    duration_s: float | None = None,
    opening: NamedView | None = None,
) -> Generator[Progress, None, RunResult[Path]]:
    """Write a page as `write_page` does, and return its numbers; the figure is its first view."""
    contents = yield from write_page(renderer, scene, rain, sequence, path_name, output, duration_s, opening)
    page_bytes, rates = output.stat().st_size, [state["intensity"] for state in contents.rain.states]
    numbers: dict[str, Any] = {
        "bytes": page_bytes, "sog_bytes": len(contents.scene.sog), "cameras": len(contents.views),
        "intensities_mm_h": rates, "named_views": [view["name"] for view in contents.named_views],
    }  # fmt: skip
    length = f"{sequence.length_s or 0.0:.3g} s of path" if len(contents.views) > 1 else "one place"
    lines = (
        f"{output}: {page_bytes / 1e6:.1f} MB, {length}, {len(rates)} intensities",
        f"not on the page: {', '.join(contents.missing)}",
    )
    first = contents.first_view
    shown = sequence.frame_input(first, sequence.sky(renderer))
    numbers |= write_provenance(output, {"first view": provenance_of(shown)})

    def draw() -> UInt8[np.ndarray, "h w 3"]:
        with open_renderer("cpu") as own:
            return render_image(own, scene, rain, first.camera, first.time_s).to_uint8()

    rows = [("bytes", page_bytes), ("bytes of the scene", len(contents.scene.sog)), ("cameras", len(contents.views))]
    table = Table(f"Page of {scene.name}", columns({"number of": "", "value": ","}), rows)
    return RunResult(made=output, table=table, numbers=numbers, lines=lines, draw=draw)


def opening_view(scene: Scene, name: str | None, *, has_path: bool) -> NamedView | None:
    """Named view at which a page opens: the one of a name, else the first one unless a path is chosen.

    None opens on the path. Raises `ValueError` if the scene has no view of the name.
    """
    if name is not None:
        return view_named(scene.views, name, scene.name)
    return None if has_path or not scene.views else scene.views[0]


def left_out_of_page(scene: Scene) -> list[str]:
    """Phrases for what a page lacks of the rain in a scene."""
    lamps = ["the light of lamps on rain and wet ground"] if scene.lamps else []
    return [*lamps, "rings in water", "spray", "water on glass"]


def page_html(contents: PageContents) -> str:
    """The page, which loads nothing else."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("gsrain_engine.publish", "."), autoescape=True, trim_blocks=False,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    texts = {name: ShaderSource(name, _COLUMNS).text for name in _SHADERS}
    texts["page_project.frag streaks"] = ShaderSource("page_project.frag", {**_COLUMNS, "STREAKS": 1}).text
    scripts = ((Path(__file__).parent / name).read_text(encoding="utf-8") for name in ("rain.js", "splashes.js"))
    texts["rain-script"] = "\n".join(scripts)
    page = environment.get_template("page.html").render(
        title=contents.title, path_name=contents.path_name, about=_ABOUT,
        keys=(*_KEYS, _VIEW_KEYS) if contents.named_views else _KEYS, views=contents.named_views,
        missing=", ".join(contents.missing), version=metadata.version("gsrain"), settings=_script(_settings(contents)),
        texts=[(name, Markup(text)) for name, text in texts.items()], data=Markup(base85(_archive(contents))),
        policy=_POLICY,
    )  # fmt: skip
    return page.replace(_POLICY, content_security_policy(page), 1)


def content_security_policy(page: str) -> str:
    """Policy by which a browser runs the page's own scripts, as they are, and loads nothing (CSP level 3).

    Rain is computed by a worker from a blob.
    """
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    hashes = [base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts]
    own = " ".join(f"'sha256-{each}'" for each in hashes)
    return (
        f"default-src 'none'; script-src {own} blob:; worker-src blob:; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


def _archive(contents: PageContents) -> bytes:
    """All files of a page in a zip file; images are compressed already."""
    scene, roofs, ground, mirror = contents.scene, contents.rain.roofs, contents.ground, contents.mirror
    files = {"scene.sog": scene.sog, "mean_parts.webp": scene.mean_parts}
    files |= {f"wet/{name}": file for name, file in (scene.wet_colors or {}).items()}
    files |= {} if scene.actors is None else {"actors.webp": scene.actors, "poses": scene.poses.tobytes()}
    files |= {"impacts": contents.rain.impacts.tobytes()}
    files |= {} if roofs is None else {"roofs": roofs.heights_m.tobytes()}
    files |= {} if ground is None else {"ground.webp": ground.image}
    if mirror is not None and scene.water is not None:
        files |= {"water.webp": scene.water, "facets": mirror.facets.tobytes(), "floors": scene.floors_m.tobytes()}
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for name, file in files.items():
            is_packed = name.endswith((".sog", ".webp"))
            archive.writestr(zipfile.ZipInfo(name), file, zipfile.ZIP_STORED if is_packed else zipfile.ZIP_DEFLATED)
    return whole.getvalue()


def base85(data: bytes) -> str:
    """Bytes as text of five characters for each four, in the alphabet of RFC 1924 with a comma for `<`.

    Base64 takes 7 % more; denser ones need characters that a server's or an editor's encoding may change.
    """
    return base64.b85encode(data).decode().replace("<", ",")


def _settings(contents: PageContents) -> dict[str, Any]:
    file_to_world = np.linalg.inv(world_to_file())
    return {
        "splatColumns": _COLUMNS["SPLAT_COLUMNS"],
        "streakColumns": _COLUMNS["STREAK_COLUMNS"],
        "near": NEAR_M,
        "toWorld": {"rotation": file_to_world[:3, :3].tolist(), "origin": file_to_world[:3, 3].tolist()},
        "antialiased": contents.scene.antialiased,
        "parts": contents.scene.parts,
        "hasWet": contents.scene.wet_colors is not None,
        "map": None if contents.ground is None else contents.ground.settings,
        "mirror": None if contents.mirror is None else contents.mirror.settings,
        "actors": len(contents.scene.poses),
        "poseStep": POSE_STEP_S,
        "start": contents.start_s,
        "rain": contents.rain.settings,
        "states": contents.rain.states,
        "chosen": contents.rain.chosen,
        "pathStep": _STEP_S,
        "path": [_row(view) for view in contents.views],
        "floors": contents.floors_m,
        "views": contents.named_views,
        "view": contents.opening,
    }


def _near_path(path: Sequence[Camera], others: Sequence[Camera]) -> list[Camera]:
    """Cameras of a path, and those of the others that are near enough to it to have ground and roofs on the page."""
    places = np.array([camera.position for camera in path])
    low, high = places.min(axis=0) - _AROUND_PATH_M, places.max(axis=0) + _AROUND_PATH_M
    return [*path, *(each for each in others if ((low < each.position) & (each.position < high)).all())]


def _named_view(
    scene: Scene, sequence: FrameSequence, view: NamedView, length_s: float
) -> tuple[RenderView, dict[str, Any]]:
    """A named view on a page whose path takes `length_s`, and its values there."""
    time_s = sequence.start_s if view.time_s is None else view.time_s
    time_s = min(max(time_s, sequence.start_s), sequence.start_s + length_s)
    drawn = RenderView(view.camera(*_VIEW_SIZE).moved(scene.scene_to_world), time_s)
    row: dict[str, Any] = {
        "name": view.name, "camera": _row(drawn)[:8], "floor": rain_camera(scene, sequence.rainfall, drawn).floor_m,
    }  # fmt: skip
    if view.time_s is not None:
        row["t"] = time_s - sequence.start_s
    if view.intensity_mm_h is not None:
        row["mm"] = view.intensity_mm_h
    return drawn, row


def _row(view: RenderView) -> list[float]:
    """Position, camera to world (w x y z), vertical field of view in degrees, and velocity of a camera."""
    camera = view.camera
    turn = quaternions_from_matrices(camera.camera_to_world[None, :3, :3])[0]
    fov_deg = np.degrees(2 * np.arctan(camera.height / 2 / camera.fy))
    velocity = np.zeros(3) if view.velocity_m_s is None else view.velocity_m_s
    return [round(float(each), 7) for each in (*camera.position, *turn, fov_deg, *velocity)]


def _script(values: dict[str, Any]) -> Markup:
    """JSON that may stand in a script element."""
    return Markup(json.dumps(values, separators=(",", ":")).replace("<", "\\u003c"))
