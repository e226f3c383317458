"""Ways to look into a scene: its picture, or what the picture is made of."""

from typing import Literal

Look = Literal["splats", "points", "ellipsoids", "depth", "normals", "opacity", "overdraw", "layers"]
"""
splats: the picture. All others show the scene alone, without rain:
points: each Gaussian an opaque dot of one pixel's standard deviation, in its own colour;
ellipsoids: the surface on which a Gaussian's alpha is 1/4, solid and shaded like a ball;
depth: expected depth as a heat colour of its logarithm, `NEAREST_M` to `FARTHEST_M`;
normals: each Gaussian's shortest axis, turned to the camera, as the colour 0.5 + 0.5 n of world axes;
opacity: each Gaussian's largest alpha, 0 to 1, as a heat colour;
overdraw: how many fragments a pixel is made of, 0 to `MOST_FRAGMENTS`, as a heat colour;
layers: each layer and actor in a colour of its own.
"""

NEAREST_M, FARTHEST_M = 0.5, 200.0
"""Ends of the depth's colours: of small captures and of streets each octave has a colour of its own."""

MOST_FRAGMENTS = 256
"""Upper end of the colours of overdraw."""
