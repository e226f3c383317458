"""Checkpoints of trainings in the layouts of their public sources: stand-ins, no originals."""

from pathlib import Path
from typing import Any

import torch

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Scene
from trained_street import FRAMES, HEIGHT, LENGTH, WIDTH, at_center, centers, cubemap, raw, street

# drivestudio


def drivestudio_tensors(gaussians: Gaussians) -> dict[str, Any]:
    each = raw(gaussians)
    return {
        "_means": torch.nn.Parameter(each["means"]),
        "_scales": torch.nn.Parameter(each["scales"]),
        "_quats": torch.nn.Parameter(each["quats"]),
        "_features_dc": torch.nn.Parameter(each["sh0"][:, 0]),
        "_features_rest": torch.nn.Parameter(each["shN"]),
        "_opacities": torch.nn.Parameter(each["opacities"][:, None]),
    }


def drivestudio_state(scene: Scene) -> dict[str, Any]:
    """Of `BasicTrainer.state_dict`: one instance without Gaussians, then the car; a cubemap of the sky."""
    (car,) = scene.actors
    positions, turns, present = centers(car)
    absent = torch.zeros(FRAMES, 1, dtype=torch.bool)
    instances = {
        "points_ids": torch.ones(len(car.gaussians), 1, dtype=torch.long),
        "instances_size": torch.tensor([[1.0, 1, 1], [LENGTH, WIDTH, HEIGHT]]),
        "instances_fv": torch.cat([absent, present[:, None]], dim=1),
        "instances_quats": torch.nn.Parameter(torch.stack([turns, turns], dim=1)),
        "instances_trans": torch.nn.Parameter(torch.stack([positions, positions], dim=1)),
    }
    models = {
        "Background": drivestudio_tensors(scene.layers[0].gaussians),
        "RigidNodes": {**drivestudio_tensors(at_center(car)), **instances},
        "Sky": {"base": cubemap()},
        "Affine": {"embedding.weight": torch.zeros(3, 4), "decoder.0.weight": torch.zeros(64, 4)},
    }
    return {"models": models, "step": 30_000}


def write_drivestudio(path: Path) -> None:
    torch.save(drivestudio_state(street()), path)


# StreetGaussians


def write_street_gaussians(path: Path) -> None:
    """Of `StreetGaussianModel.save_state_dict`, not final: with states of optimizers; colors over time have 5 terms."""
    scene = street()
    (car,) = scene.actors

    def tensors(gaussians: Gaussians, terms: int) -> dict[str, Any]:
        each = raw(gaussians)
        waves = torch.full((len(gaussians), terms - 1, 3), 7.0)
        return {
            "xyz": torch.nn.Parameter(each["means"]),
            "feature_dc": torch.cat([each["sh0"], waves], dim=1),
            "feature_rest": each["shN"],
            "scaling": each["scales"],
            "rotation": each["quats"],
            "opacity": each["opacities"][:, None],
            "semantic": torch.zeros(len(gaussians), 0),
            "optimizer": {"state": {0: {"step": torch.tensor(3.0)}}, "param_groups": [{"lr": 0.01, "params": [0]}]},
        }

    state = {
        "background": tensors(scene.layers[0].gaussians, 1),
        "obj_007": tensors(at_center(car), 5),
        "actor_pose": {"params": {"opt_trans": torch.zeros(FRAMES, 1, 3)}},
        "sky_cubemap": {"params": {"sky_cube_map": torch.nn.Parameter(cubemap())}},
        "iter": 30_000,
    }
    torch.save(state, path)


# nerfstudio, MTGS, gsplat, 3DGS


def splatfacto_tensors(gaussians: Gaussians, prefix: str) -> dict[str, torch.Tensor]:
    each = raw(gaussians)
    named = {
        "means": each["means"],
        "scales": each["scales"],
        "quats": each["quats"],
        "features_dc": each["sh0"][:, 0],
        "features_rest": each["shN"],
        "opacities": each["opacities"][:, None],
    }
    return {f"{prefix}gauss_params.{name}": tensor for name, tensor in named.items()}


def write_splatfacto(path: Path) -> None:
    pipeline = splatfacto_tensors(street().layers[0].gaussians, "_model.")
    pipeline["_model.camera_optimizer.pose_adjustment"] = torch.zeros(4, 6)
    torch.save({"step": 29_999, "pipeline": pipeline, "optimizers": {}, "scalers": {}}, path)


def write_mtgs(path: Path) -> None:
    """Of MTGS: a background that three drives see in colors of their own, and a car, 100 km up where it is absent."""
    scene = street()
    (car,) = scene.actors
    positions, turns, present = centers(car)
    positions[~present] = torch.tensor([0, 0, 100_000.0])
    first = "_model.gaussian_models.background."
    pipeline = splatfacto_tensors(scene.layers[0].gaussians, first)
    adapters = torch.zeros(len(scene.layers[0].gaussians), 3, 3)
    adapters[:, 0], adapters[:, 1] = 0.3, -0.3
    pipeline[f"{first}gauss_params.features_adapters"] = adapters
    node = "_model.gaussian_models.rigid_object_a1b2."
    pipeline |= splatfacto_tensors(at_center(car), node)
    pipeline |= {f"{node}instance_quats": turns, f"{node}instance_trans": positions}
    torch.save({"step": 29_999, "pipeline": pipeline}, path)


def write_gsplat(path: Path) -> None:
    torch.save({"step": 29_999, "splats": raw(street().layers[0].gaussians)}, path)


def write_3dgs(path: Path) -> None:
    """Of `GaussianModel.capture`, with the state of an optimizer."""
    each = raw(street().layers[0].gaussians)
    count = len(each["means"])
    captured = (
        3, *(torch.nn.Parameter(each[name]) for name in ("means", "sh0", "shN", "scales", "quats")),
        torch.nn.Parameter(each["opacities"][:, None]), torch.zeros(count), *(torch.zeros(count, 1) for _ in range(2)),
        {"state": {}, "param_groups": []}, 5.0,
    )  # fmt: skip
    torch.save((captured, 30_000), path)


SMALL = {
    "drivestudio.pth": write_drivestudio,
    "street_gaussians.pth": write_street_gaussians,
    "splatfacto.ckpt": write_splatfacto,
    "mtgs.ckpt": write_mtgs,
    "gsplat.pt": write_gsplat,
    "chkpnt30000.pth": write_3dgs,
}
"""Writers of small checkpoints by the names of their files."""
