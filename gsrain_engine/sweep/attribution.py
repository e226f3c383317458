"""Attribution of collisions and distances of a sweep's drives to the factors of its rain."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from PIL import Image

from ..evaluation.attribution.results import (
    OVER,
    Attribution,
    Measure,
    attributions,
    method_of,
    seed_table,
    share_figure,
)
from ..evaluation.attribution.shapley import Coalition
from ..report.page import ReportFigure
from ..report.table import table_of
from ..safe_io.files import whole_file
from .expansion import AttributedDrive
from .results import FINISHED, Row

MEASURES = (
    Measure("collision", "collisions (share of drives)"),
    Measure("min_ttc_s", "min TTC (s)"),
    Measure("min_gap_m", "minimum gap (m)"),
    Measure("collision_speed_m_s", "speed at impact (m/s)"),
    Measure("hardest_braking_m_s2", "hardest braking (m/s2)"),
)
"""Attributed measures of a drive; the speed at impact is 0 without a collision."""
_DRAWN = 3


def drive_attributions(drives: Sequence[AttributedDrive], rows: Mapping[str, Row]) -> list[Attribution]:
    """Attribute the measures of each scenario, agent and variant at each intensity, from rows by job id.

    Seeds with a missing or failed drive are left out, and so are measures that a drive does not have.
    """
    groups: dict[tuple[tuple[str, ...], float], list[AttributedDrive]] = defaultdict(list)
    several = len({each.drive.scene for each in drives}) > 1
    for each in drives:
        job = each.drive
        agent = ", ".join(filter(None, [job.agent.title, job.variant.title]))
        subject = (*([job.scene] if several else []), job.scenario.name, agent)
        groups[subject, job.scenario.rain.intensity_mm_h].append(each)
    columns = (*(["scene"] if several else []), "scenario", "agent")
    found: list[Attribution] = []
    for (subject, intensity), own in groups.items():
        whole = [each for each in own if all(_is_finished(rows.get(job.id)) for job in each.jobs.values())]
        if not whole:
            continue
        every = [rows[job.id] for each in whole for job in each.jobs.values()]
        measures = [each for each in MEASURES if all(_value(row, each) is not None for row in every)]
        values: dict[int, dict[Coalition, Any]] = {
            each.drive.seed: {
                present: np.array([_value(rows[job.id], measure) for measure in measures], np.float64)
                for present, job in each.jobs.items()
            }
            for each in whole
        }
        named = dict(zip(columns, subject, strict=True))
        found += attributions(named, intensity, whole[0].factors, measures, values)
    return found


def _is_finished(row: Row | None) -> bool:
    return row is not None and row["status"] == FINISHED


def _value(row: Row, measure: Measure) -> float | None:
    value = row[measure.name]
    if value is None:
        return 0.0 if measure.name == "collision_speed_m_s" else None
    assert isinstance(value, int | float)
    return float(value)


def write_attribution(
    folder: Path, drives: Sequence[AttributedDrive], rows: Mapping[str, Row], found: Sequence[Attribution]
) -> list[ReportFigure]:
    """Write attribution.csv (shares by seed), attribution_drives.csv (a row per drive and coalition) and the figure."""
    if found:
        seed_table(found).write_csv(folder / "attribution.csv")
    lines: list[dict[str, Any]] = []
    for each in drives:
        drive = each.drive
        shared = {
            "scene": drive.scene, "scenario": drive.scenario.name, "agent": drive.agent.title,
            **structs.asdict(drive.variant), "intensity_mm_h": drive.scenario.rain.intensity_mm_h, "seed": drive.seed,
        }  # fmt: skip
        for present, job in each.jobs.items():
            if (row := rows.get(job.id)) is not None:
                factors = "+".join(name for name in each.factors.names if name in present)
                measured = {measure.name: row[measure.name] for measure in MEASURES}
                lines.append(shared | {"factors": factors, "id": job.id, "status": row["status"]} | measured)
    if lines:
        table_of("", lines[0], lines).write_csv(folder / "attribution_drives.csv")
    drawn = [each for each in found if each.measure in MEASURES[:_DRAWN]]
    if not drawn:
        return []
    figure = ReportFigure("Shares of the factors of the rain", share_figure(drawn), method_of(drawn[0]) + OVER)
    with whole_file(folder / "attribution.png") as partial:
        Image.fromarray(figure.pixels).save(partial, "png")
    return [figure]
