"""Choices and defaults in settings and options; it imports nothing heavy, so that help is printed at once."""

from typing import Literal

Backend = Literal["auto", "opengl", "opengl-tiles", "opengl-quads", "cpu"]
"""Renderers: `opengl` is the faster one of its two ways on this device, `auto` the fastest of those and `cpu`."""

RenderMode = Literal["splats", "points", "ellipsoids", "depth", "normals", "opacity", "overdraw", "layers"]
"""Visualization modes. All except `splats` show the scene without rain:

* splats: the image;
* points: each Gaussian as an opaque dot of one pixel's standard deviation, in its own color;
* ellipsoids: the surface on which a Gaussian's alpha is 1/4, solid and shaded like a ball;
* depth: expected depth as a heat color of its logarithm, `NEAREST_M` to `FARTHEST_M`;
* normals: each Gaussian's shortest axis, facing the camera, as the color 0.5 + 0.5 n of world axes;
* opacity: each Gaussian's largest alpha, 0 to 1, as a heat color;
* overdraw: number of fragments per pixel, 0 to `MAX_FRAGMENTS`, as a heat color;
* layers: each layer and actor in a distinct color.
"""

Direction = Literal["top", "ortho"]
"""Of an orthographic camera: from straight above, with north (world +y) up; and aslant from behind, the left and above,
as in an isometric drawing."""

Mark = Literal["grid", "scale", "boxes", "paths"]
"""Lines over an orthographic picture: on the ground at round meters, a scale bar, boxes of road users, and paths
of these and of the ego vehicle."""

LabelFormat = Literal["coco", "kitti"]
Friction = Literal["dry", "wet"]
"""Friction of the road in a drive: dry, each vehicle's own limits; wet, less by speed and water."""

FACTORS = ("streaks", "medium", "light", "wet", "mirror", "splashes", "spray", "glass", "friction")
"""Parts of the rain that an attribution switches, in the order of tables: names of `evaluation.attribution.factors`."""

EXTRACTORS = ("inception", "pixels16")
"""Feature extractors of `gsrain evaluate fid`."""

FILM_SHARE = 0.05
"""Share of mirrored light from which a pixel counts as water film."""

READ_FORMATS = (
    ".compressed.ply", ".ply", ".splat", ".spz", ".ksplat", ".sog", ".glb", ".gltf", "lod-meta.json",
    "meta.json",
)  # fmt: skip
WRITTEN_FORMATS = (".compressed.ply", ".ply", ".splat", ".spz", ".sog", ".glb")
"""Suffixes of `scene.formats.registry.FORMATS`, for help texts."""

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
UNIT_M = (1e-6, 1e6)
"""Shortest and longest unit of length of a scene, in meters."""

NO_LAMPS, FOUND_LAMPS, HEADLIGHTS = "none", "auto", "headlights"
LAMP_WORDS = (NO_LAMPS, FOUND_LAMPS, HEADLIGHTS)
"""Choices of lamps that are no files."""
