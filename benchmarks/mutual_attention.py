"""Does mutual self-attention make neighboring views agree, and what does a layer of it cost? Prints JSON.

With --weights it is SD-Turbo and a transfer's weights. Without, it is a small network that is trained here, briefly, to
tone views of the street. So little training leaves next to nothing to self-attention, so it is also measured with what
attention adds multiplied (--strengths). What views disagree about then is what attention brings into each from
elsewhere in its own picture, and that is what mutual attention is for.
"""

import argparse
import copy
import json
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch.nn.attention import SDPBackend, sdpa_kernel

from gsrain_engine.appearance.base import ClearView, RainyView, TransferSettings
from gsrain_engine.appearance.capture_views import CaptureViews
from gsrain_engine.appearance.correspondence import rank_neighbors
from gsrain_engine.appearance.cyclegan_turbo.cross_view_attention import MAX_SCORES, PX_PER_TOKEN, chunked_attention
from gsrain_engine.appearance.cyclegan_turbo.model import CycleGanTurbo, TurboArchitecture, build_random_model, tiny
from gsrain_engine.appearance.cyclegan_turbo.pretrained import open_model
from gsrain_engine.appearance.cyclegan_turbo.translator import CycleGanTurboTransfer
from gsrain_engine.evaluation.consistency import agreements, pool_errors
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_extras.street.ground_truth import capture_street
from gsrain_extras.street.layout import StreetParameters

STREET = StreetParameters(length_m=120.0, parked_share=0.3, tree_spacing_m=30.0)
HEADINGS = {"left": 0.5, "front": 0.0, "right": -0.5}
"""Of three cameras at one place and moment, in radians."""
TRAINED_ON = 20
TINT = np.array([0.9, 1.0, 1.1], np.float32)
CROP_PX = 48


def street(width: int) -> tuple[list[ClearView], list[ClearView]]:
    """Views to measure on, and views to train on."""
    random = np.random.default_rng(0)
    measured = [camera(20.0, heading, width) for heading in HEADINGS.values()]
    trained = [camera(random.uniform(0, 60), random.uniform(-1.2, 1.2), 192) for _ in range(TRAINED_ON)]
    names = [*HEADINGS, *(f"{i:02}" for i in range(TRAINED_ON))]
    capture = capture_street(measured + trained, [0.0] * len(names), STREET, names=names)
    views = [replace(view, sensor=view.name) for view in CaptureViews(capture, width)]
    return views[: len(HEADINGS)], views[len(HEADINGS) :]


def camera(x_m: float, heading: float, width: int) -> Camera:
    eye = np.array([x_m, 0.0, 1.5])
    ahead = np.array([np.cos(heading), np.sin(heading), -0.03])
    return Camera.from_fov(width, 2 * width // 3, 55, look_at(eye, eye + ahead, np.array([0, 0, 1.0])))


def small() -> TurboArchitecture:
    """The tiny stand-in with two levels in place of four, which trains in minutes."""
    one = tiny()
    unet = dict(one.unet) | {
        "block_out_channels": [16, 16], "attention_head_dim": [2, 2], "layers_per_block": 1,
        "down_block_types": ["CrossAttnDownBlock2D", "DownBlock2D"],
        "up_block_types": ["UpBlock2D", "CrossAttnUpBlock2D"],
    }  # fmt: skip
    vae = dict(one.vae) | {
        "block_out_channels": [8, 16], "down_block_types": ["DownEncoderBlock2D"] * 2,
        "up_block_types": ["UpDecoderBlock2D"] * 2,
    }  # fmt: skip
    return TurboArchitecture("tiny", unet, vae, one.text)


def toned(image: np.ndarray) -> np.ndarray:
    """Make a picture darker, duller and cooler."""
    grey = image.mean(axis=2, keepdims=True)
    return np.clip(0.8 * (grey + 0.6 * (image - grey)) * TINT, 0, 1)


def trained(views: Sequence[ClearView], iterations: int) -> tuple[CycleGanTurbo, float]:
    """Train a small network on crops, but for its skips, past which nothing would go through the UNet.

    Returns it with the mean absolute error of the last iterations.
    """
    model, random = build_random_model(small(), normals=False), np.random.default_rng(1)
    chosen = [p for name, p in model.named_parameters() if "skip_conv" not in name and not name.startswith("vae_b2a")]
    for parameter in chosen:
        parameter.requires_grad_(True)
    optimizer, recent = torch.optim.Adam(chosen), 0.0
    for iteration in range(iterations):
        for group in optimizer.param_groups:
            group["lr"] = 3e-3 * min(1, 2 * (1 - iteration / iterations))
        image = views[random.integers(len(views))].image
        top, left = (random.integers(size - CROP_PX + 1) for size in image.shape[:2])
        crop = image[top : top + CROP_PX, left : left + CROP_PX]
        given, asked = (
            torch.tensor(np.ascontiguousarray(each.transpose(2, 0, 1)))[None] * 2 - 1 for each in (crop, toned(crop))
        )
        loss = (model.translate(given) - asked).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(chosen, 1.0)
        optimizer.step()
        recent += (loss.item() - recent) / min(iteration + 1, 30)
    model.requires_grad_(False)
    return model, recent / 2


def strengthened(model: CycleGanTurbo, factor: float) -> CycleGanTurbo:
    """Multiply what each self-attention adds to its features."""
    stronger = copy.deepcopy(model)
    for name, parameter in stronger.unet.named_parameters():
        if ".attn1.to_out.0." in name:
            parameter *= factor
    return stronger


def rows(model: CycleGanTurbo, views: Sequence[ClearView], settings: TransferSettings) -> Iterator[dict[str, Any]]:
    """Measure without and with mutual attention on the same pairs of neighbors."""
    tokens = PX_PER_TOKEN if settings.side_px else (2, 4, 8, 16, 32)
    pairs = [(i, j) for i, others in enumerate(rank_neighbors(views, 2)) for j in others]
    for name, is_mutual in (("none", False), ("mutual", True)):
        run = msgspec.structs.replace(settings, mutual_attention=is_mutual)
        transfer = CycleGanTurboTransfer(model, run, px_per_token=tokens)
        started = time.perf_counter()
        made: dict[str, RainyView] = {each.clear.name: each for each in transfer.transferred(views)}
        seconds = time.perf_counter() - started
        found = pool_errors(each.everywhere for each in agreements([made[view.name] for view in views], pairs))
        assert found is not None and found.before is not None
        yield {
            "attention": name, "pairs": len(pairs), "pixels": found.pixels, "rmse_clear": round(found.before.rmse, 5),
            "rmse": round(found.after.rmse, 5), "contrast": round(found.after.contrast, 4),
            "ratio": round(found.ratio, 4), "seconds": round(seconds, 2),
            "mean": {name: round(float(view.image.mean()), 4) for name, view in made.items()},
        }  # fmt: skip


def layer_cost(kernel: str, views: int, max_scores: int) -> dict[str, Any]:
    """Cost of attention in SD-Turbo's finest layer at 512 x 512 px: 5 heads of 64, 4096 queries, keys of some views."""
    query, key = (torch.randn(1, 5, tokens, 64) for tokens in (4096, views * 4096))
    chosen = SDPBackend.MATH if kernel == "math" else SDPBackend.FLASH_ATTENTION
    before, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with torch.inference_mode(), sdpa_kernel([chosen]):
        chunked_attention(query, key, key, 0.125, max_scores)
    took = time.process_time() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return {
        "kernel": kernel, "views": views, "max_scores": max_scores, "peak_mb": round(peak / 1024),
        "processor_seconds": round(took, 2),
    }  # fmt: skip


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--weights", type=Path, help="a transfer's weights; needs SD-Turbo")
    parser.add_argument("--width", type=int, default=192, help="of the street's pictures in px")
    parser.add_argument("--iterations", type=int, default=800, help="of training the small network")
    parser.add_argument("--strengths", type=float, nargs="+", default=(1.0, 40.0, 400.0), help="of its self-attention")
    parser.add_argument("--layer", choices=("flash", "math"), help="measure one layer with this kernel, nothing else")
    parser.add_argument("--views", type=int, default=3, help="whose keys the layer looks at")
    parser.add_argument("--max-scores", type=int, default=MAX_SCORES)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    if arguments.layer:
        print(json.dumps(layer_cost(arguments.layer, arguments.views, arguments.max_scores)))
        return
    views, to_train_on = street(arguments.width)
    if arguments.weights:
        found = {"rows": list(rows(open_model(arguments.weights), views, TransferSettings()))}
    else:
        model, error = trained(to_train_on, arguments.iterations)
        found = {"trained_to": round(error, 4)} | {
            f"strength_{strength:g}": list(rows(strengthened(model, strength), views, TransferSettings(side_px=None)))
            for strength in arguments.strengths
        }
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
