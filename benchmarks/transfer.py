"""Time and memory of CycleGAN-Turbo for an image, by stage. Prints JSON.

Random weights of the real architecture do: speed does not depend on what they are.
"""

import argparse
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from gsrain_engine.appearance.cyclegan_turbo.model import (
    ARCHITECTURES,
    CycleGanTurbo,
    build_random_model,
    decode_latents,
)
from gsrain_engine.appearance.cyclegan_turbo.pretrained import open_model
from gsrain_engine.appearance.cyclegan_turbo.translator import estimated_seconds, measured_speed

TYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}


def timed(what: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """Run something; wall seconds, and processor seconds of all threads, which company changes less."""
    started, worked = time.perf_counter(), time.process_time()
    result = what()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    took = time.perf_counter() - started, time.process_time() - worked
    return result, {"seconds": round(took[0], 3), "processor_seconds": round(took[1], 3)}


def stages(model: CycleGanTurbo, pictures: torch.Tensor, guides: torch.Tensor) -> tuple[torch.Tensor, dict[str, Any]]:
    """Translate once, stage by stage."""
    took: dict[str, Any] = {}
    with torch.inference_mode():
        (latents, skips), took["encode"] = timed(lambda: model.encode(pictures, guides))
        latents, took["unet"] = timed(lambda: model.denoise(latents))
        made, took["decode"] = timed(lambda: decode_latents(model.vae, latents, skips))
    return made, took


def main() -> None:
    """Build or read the model, translate a picture, and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--architecture", choices=sorted(ARCHITECTURES), default="sd-turbo")
    parser.add_argument("--weights", type=Path, help="a file of weights, in place of random ones; needs SD-Turbo")
    parser.add_argument("--size", default="512x512", help="WIDTHxHEIGHT in pixels, multiples of 8")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--dtype", choices=sorted(TYPES), default="float32")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--runs", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    width, height = map(int, arguments.size.split("x"))
    dtype = TYPES[arguments.dtype]
    speed = measured_speed(arguments.device, dtype)
    estimate = estimated_seconds(width, height, arguments.device, dtype)

    def opened() -> CycleGanTurbo:
        named = ARCHITECTURES[arguments.architecture]()
        model = build_random_model(named) if arguments.weights is None else open_model(arguments.weights)
        return model.to(arguments.device, dtype)

    model, opening = timed(opened)
    after_opening_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    random = torch.Generator().manual_seed(0)
    pictures, guides = (
        (2 * torch.rand(1, channels, height, width, generator=random) - 1).to(arguments.device, dtype)
        for channels in (3, 1)
    )
    runs = [stages(model, pictures, guides) for _ in range(arguments.runs)]
    made = runs[-1][0]
    numbers = {
        "architecture": arguments.architecture, "size": [width, height], "device": arguments.device,
        "dtype": arguments.dtype, "threads": arguments.threads, "opening": opening,
        "stages": [took for _, took in runs],
        "total_seconds": [round(sum(stage["seconds"] for stage in took.values()), 3) for _, took in runs],
        "estimated_seconds": round(estimate, 2), "probe_gflop_s": round(speed / 1e9, 1),
        "peak_rss_mb_after_opening": round(after_opening_mb),
        "peak_rss_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "output": {"finite": bool(made.isfinite().all()), "shape": list(made.shape), "deviation": float(made.std())},
        "parameters_m": round(sum(each.numel() for each in model.parameters()) / 1e6, 1), "torch": torch.__version__,
    }  # fmt: skip
    if arguments.device.startswith("cuda"):
        numbers["peak_gpu_mb"] = round(torch.cuda.max_memory_allocated() / 2**20)
    print(json.dumps(numbers, indent=1))


if __name__ == "__main__":
    main()
