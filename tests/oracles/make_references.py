"""Path-trace the reference pictures of water with Mitsuba 3 (pip install mitsuba), and store them next to this file.

    python tests/oracles/make_references.py [--samples 1024] [--only drop|road]

The drop is a closed dielectric body; the road is a rough dielectric with Beckmann's distribution, whose alpha is
sqrt(2) times the standard deviation of the slopes. Boxes and bulbs shine; nothing else does.
"""

import argparse
from pathlib import Path

import mitsuba as mi
import numpy as np
import water_scenes as scenes

FOLDER = Path(__file__).parent


def main() -> None:
    """Render and write all references."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--only", choices=("drop", "road"))
    chosen = parser.parse_args()
    mi.set_variant("scalar_rgb")
    for name, pictures in {"drop": drop_pictures, "road": road_pictures}.items():
        if chosen.only in (None, name):
            light = {key: np.minimum(each, 6e4).astype(np.float16) for key, each in pictures(chosen.samples).items()}
            np.savez_compressed(FOLDER / f"{name}.npz", **light)


def drop_pictures(samples):
    return {"drop": rendered(drop_scene(), samples)}


def road_pictures(samples):
    """Pictures with boxes and with bulbs, by smoothness."""
    pictures = {}
    for name, slope in scenes.SLOPES.items():
        pictures[name] = rendered(road_scene(slope, boxes=True), samples)
        pictures[f"{name} bulbs"] = rendered(road_scene(slope, boxes=False), samples)
    return pictures


def rendered(scene, samples):
    """Linear light of a picture, (h, w, 3)."""
    return np.array(mi.render(mi.load_dict(scene), spp=samples, seed=1))[..., :3]


def film(width, height, window=None):
    """Film of a size, or the square window in its middle."""
    whole = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    if window is None:
        return whole
    corner = {"crop_offset_x": (width - window) // 2, "crop_offset_y": (height - window) // 2}
    return whole | corner | {"crop_width": window, "crop_height": window}


def drop_scene():
    """Drop on the glass; Mitsuba's camera looks along z with x to the left and y up: half a turn about z."""
    angle = np.radians(scenes.CONTACT_DEG)
    sphere = scenes.DROP_RADIUS_M / np.sin(angle)
    rings, turns = 96, 384
    polar = np.linspace(0, angle, rings + 1)
    around = np.arange(turns) * 2 * np.pi / turns
    normals = np.stack(
        [
            np.outer(np.sin(polar), np.cos(around)).ravel(),
            np.outer(np.sin(polar), np.sin(around)).ravel(),
            np.outer(np.cos(polar), np.ones(turns)).ravel(),
        ],
        axis=1,
    )
    points = sphere * normals + (0, 0, scenes.PANE_M - sphere * np.cos(angle))
    faces = []
    for ring in range(rings):
        for turn in range(turns):
            a, b = ring * turns + turn, ring * turns + (turn + 1) % turns
            faces += [(a, a + turns, b), (b, a + turns, b + turns)]
    rim = points[-turns:]
    base = np.vstack([rim, [[0, 0, scenes.PANE_M]]])
    lid = [(turns, (turn + 1) % turns, turn) for turn in range(turns)]
    glass = {"type": "dielectric", "int_ior": scenes.WATER, "ext_ior": 1.0}
    rows, columns = 1024, 2048
    # Mitsuba's latitude-longitude map: up is y, the middle column is at +z, columns go to -x.
    longitude = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    latitude = (np.arange(rows) + 0.5) / rows * np.pi
    x = np.outer(np.sin(latitude), np.sin(longitude))
    z = -np.outer(np.sin(latitude), np.cos(longitude))
    y = np.outer(np.cos(latitude), np.ones(columns))
    light = scenes.surroundings(x, y, z)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 12, "rr_depth": 100},
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(light.astype(np.float32)), "scale": 1.0},
        "cap": body(points, faces, normals, glass),
        "lid": body(base, lid, np.tile([0.0, 0.0, -1.0], (len(base), 1)), glass),
        "sensor": {
            "type": "perspective", "fov": 2 * np.degrees(np.arctan(scenes.DROP_TANGENT)), "near_clip": 1e-4,
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
            "film": film(scenes.DROP_PX, scenes.DROP_PX, scenes.DROP_WINDOW_PX),
        },
    }  # fmt: skip


def body(points, faces, normals, bsdf):
    """Triangle mesh with normals at its corners."""
    mesh = mi.Mesh("mesh", len(points), len(faces), has_vertex_normals=True, props=bsdf_properties(bsdf))
    values = mi.traverse(mesh)
    values["vertex_positions"] = np.ravel(points).astype(np.float32)
    values["vertex_normals"] = np.ravel(normals).astype(np.float32)
    values["faces"] = np.ravel(faces).astype(np.uint32)
    values.update()
    return mesh


def bsdf_properties(bsdf):
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf)
    return properties


def road_scene(slope, *, boxes):
    """Road with boxes or with bulbs, from the camera's height."""
    width, height = scenes.ROAD_PX
    water = {
        "type": "roughdielectric", "distribution": "beckmann", "alpha": float(np.sqrt(2) * slope),
        "int_ior": scenes.WATER, "ext_ior": 1.0,
    }  # fmt: skip
    eye = np.array(scenes.EYE_M)
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3, "rr_depth": 100},
        "road": {
            "type": "rectangle", "bsdf": water,
            "to_world": mi.ScalarTransform4f().translate([100, 0, 0]).scale([200, 200, 1]),
        },
        "sensor": {
            "type": "perspective", "fov": 2 * np.degrees(np.arctan(scenes.ROAD_TANGENT)), "fov_axis": "x",
            "near_clip": 1e-2,
            "to_world": mi.ScalarTransform4f().look_at(
                origin=list(eye), target=list(eye + (1.0, 0.0, -scenes.DOWN)), up=[0, 0, 1]
            ),
            "film": film(width, height),
        },
    }  # fmt: skip
    if boxes:
        for number, box in enumerate(scenes.BOXES):
            low, high = np.array(box.low), np.array(box.high)
            place = mi.ScalarTransform4f().translate(list((low + high) / 2)).scale(list((high - low) / 2))
            scene[f"box{number}"] = {"type": "cube", "to_world": place, "emitter": shining(box.light)}
    else:
        for number, bulb in enumerate(scenes.BULBS):
            radiance = bulb.intensity / (np.pi * bulb.radius**2)
            scene[f"bulb{number}"] = {
                "type": "sphere", "center": list(bulb.center), "radius": bulb.radius,
                "emitter": shining([radiance] * 3),
            }  # fmt: skip
    return scene


def shining(light):
    return {"type": "area", "radiance": {"type": "rgb", "value": [float(each) for each in light]}}


if __name__ == "__main__":
    main()
