"""The page of a reconstruction: its settings, curves, held-out pictures and timings."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from gsrain_engine.evaluate.report.comparison import Comparison
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.evaluate.report.run_report import Curve, RunReport

from .held_out import mean_of
from .reconstruction import MeasuredPicture, Reconstruction

_SMOOTHED_STEPS = 25
"""Each step learns from another view: single losses jump."""


def write_training_report(file: Path, result: Reconstruction) -> None:
    shown = [each for each in result.pictures if each.is_held_out] or list(result.pictures)
    report = RunReport(
        f"Reconstruction of {result.capture.name}",
        {key: str(value) for key, value in msgspec.to_builtins(result.settings).items()},
        _curves(result),
        tuple(_comparison(each) for each in shown),
        result.seconds_by_stage,
        _headlines(result),
        result.capture.problems,
    )
    write_report(file, report)


def _comparison(each: MeasuredPicture) -> Comparison:
    truth = each.truth.astype(np.float32) / 255
    name = each.score.name if each.is_held_out else f"{each.score.name} (learned from)"
    compared = Comparison.measured(name, np.clip(each.rendered, 0, 1), truth, each.seen)
    return replace(compared, lpips=each.score.lpips)


def _curves(result: Reconstruction) -> tuple[Curve, ...]:
    curves = result.curves
    steps, times = np.arange(1, len(curves.losses) + 1), np.array(curves.seconds)
    window = min(_SMOOTHED_STEPS, max(len(steps), 1))
    smooth = np.convolve(curves.losses, np.full(window, 1 / window), "valid")
    found = [
        Curve("loss", steps[window - 1 :], smooth, times[window - 1 :], is_logarithmic=True),
        Curve("Gaussians", steps, np.array(curves.counts, np.float64), times),
    ]
    if curves.measured_steps:
        at = np.array(curves.measured_steps)
        when = np.concatenate([[0.0], times])[at]
        found.insert(1, Curve("held-out PSNR", at, np.array(curves.measured_db), when, "dB"))
    return tuple(found)


def _headlines(result: Reconstruction) -> dict[str, str]:
    lines = {
        "Gaussians": f"{result.gaussians:,}",
        "Time": f"{result.seconds / 60:.1f} min",
        "Views": f"{len(result.capture)}, {len(result.held_out)} held out",
        "Own body": result.own_body.line,
    }
    exposed, before = mean_of(result.held_out, "psnr_exposed_db"), mean_of(result.before, "psnr_db")
    if exposed is not None:
        lines["Right halves, exposure fitted on the left"] = f"{exposed:.2f} dB"
    if before is not None:
        lines["Before training"] = f"{before:.2f} dB"
    return lines
