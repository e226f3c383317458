"""Sweeps that attribute: jobs of the coalitions of each drive's rain, shares from their rows, and tables."""

import csv
import json

import numpy as np
import pytest
from msgspec import structs

from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.sweep.attribution import drive_attributions
from gsrain_engine.sweep.executors import SerialExecutor
from gsrain_engine.sweep.expansion import Shard, attributed_drives, drives_of, jobs_of
from gsrain_engine.sweep.report import write_tables
from gsrain_engine.sweep.results import FINISHED, SweepFolder
from gsrain_engine.sweep.run import run_sweep
from sweep.small_sweep import sweep_of, write_road, write_scenario

pytestmark = pytest.mark.street

ALL = ["all"]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    folder = tmp_path_factory.mktemp("attributed")
    return write_scenario(folder / "short.yaml", write_road(folder / "road"), rain={"glass": "lens"})


def test_coalitions_are_jobs_once_and_none_of_them_is_the_clear_drive(scenario):
    sweep = sweep_of([scenario], attribute=ALL)
    drives, jobs = drives_of(sweep), jobs_of(sweep)
    apart = attributed_drives(sweep)
    assert [(each.drive.scenario.rain.intensity_mm_h, each.drive.seed) for each in apart] == [(8.5, 0), (8.5, 1)]
    for each in apart:
        assert each.factors.names == ("streaks", "medium", "wet", "mirror", "splashes", "spray", "glass")
        assert len({job.id for job in each.jobs.values()}) == len(each.jobs) == 8 + 8 * 8  # dry, and on wet ground
        assert each.jobs[frozenset(each.factors.names)].id == each.drive.id in {job.id for job in drives}
        rain = each.jobs[frozenset({"medium"})].scenario.rain
        assert (rain.streak_gain, rain.wetness, rain.glass, rain.seed) == (0.0, 0.0, "none", each.drive.seed)
        assert all(job.scenario.road_users == each.drive.scenario.road_users for job in each.jobs.values())
    assert len(jobs) == 2 * 72 + 2  # the two drives at 0 mm/h have a dry pane before the camera
    assert [job.id for job in jobs] == [job.id for job in jobs_of(sweep)]
    shares = [Shard(i, 3).of(jobs) for i in (1, 2, 3)]
    assert sorted(job.id for share in shares for job in share) == sorted(job.id for job in jobs)
    plain = jobs_of(sweep_of([scenario]))
    assert {job.id for job in plain} == {job.id for job in drives} < {job.id for job in jobs}
    without_glass = sweep_of([scenario], attribute=["streaks", "medium", "wet"], intensities_mm_h=[8.5])
    assert len(jobs_of(without_glass)) == 2 * 8


def test_friction_belongs_to_the_drives_of_coalitions(scenario):
    (drive,) = attributed_drives(sweep_of([scenario], attribute=["streaks", "friction"], seeds=1))
    found = {present: job.scenario.friction for present, job in drive.jobs.items() if present}
    assert found == {frozenset(each): "wet" if "friction" in each else "dry" for each in (
        {"streaks"}, {"friction"}, {"streaks", "friction"})}  # fmt: skip


def test_the_street_has_a_scene_for_the_light_alone(scenario):
    (drive,) = attributed_drives(sweep_of([scenario], attribute=ALL, scenes=["street"], seeds=1))
    assert drive.factors.names == ("streaks", "medium", "light", "wet", "mirror", "splashes", "spray", "glass")
    scenes = {
        present: job.scene for present, job in drive.jobs.items() if job.scene == job.scenario.scene
    }  # fmt: skip
    assert len(scenes) == len(drive.jobs)
    overcast = {present for present, scene in scenes.items() if scene == "street:overcast"}
    assert overcast == {present for present in scenes if "light" in present and "wet" not in present}
    assert len({job.scene_hash for job in drive.jobs.values()}) == 2


@pytest.mark.parametrize(("changes", "words"), [
    ({"attribute": ["rain"]}, "attribute rain: expected all"),
    ({"attribute": ALL, "intensities_mm_h": [0]}, "above 0 mm/h"),
])  # fmt: skip
def test_sweeps_that_can_not_be_attributed(scenario, changes, words):
    with pytest.raises(ValueError, match=words):
        jobs_of(sweep_of([scenario], **changes))


def test_shares_follow_from_the_rows_of_whole_seeds(scenario):
    apart = attributed_drives(sweep_of([scenario], attribute=ALL, seeds=4))
    rows = {}
    for each in apart:
        for present, job in each.jobs.items():
            collides = {"wet", "glass"} <= present  # both are needed
            min_ttc_s = 3.0 - len(present & {"streaks", "glass"}) + 0.1 * each.drive.seed
            rows[job.id] = {
                "status": FINISHED, "collision": collides, "min_ttc_s": min_ttc_s,
                "min_gap_m": None, "collision_speed_m_s": 4.0 if collides else None, "hardest_braking_m_s2": 3.0,
            }  # fmt: skip
    found = {each.measure.name: each for each in drive_attributions(apart, rows)}
    assert list(found) == ["collision", "min_ttc_s", "collision_speed_m_s", "hardest_braking_m_s2"]
    assert found["collision"].seeds == (0, 1, 2, 3)
    means = {name: share.value for name, share in found["collision"].shares.items()}
    none = dict.fromkeys(("streaks", "medium", "mirror", "splashes", "spray"), 0)
    assert means == pytest.approx(none | {"wet": 0.5, "glass": 0.5})
    means = {name: share.value for name, share in found["min_ttc_s"].shares.items()}
    assert means == pytest.approx(dict.fromkeys(means, 0) | {"streaks": -1, "glass": -1})
    assert found["collision_speed_m_s"].whole.value == pytest.approx(4) and found["collision"].plain["in_rain"] == 1
    del rows[apart[1].jobs[frozenset({"wet"})].id]  # of seed 1
    rows[apart[2].drive.id]["status"] = "failed"
    assert {each.seeds for each in drive_attributions(apart, rows)} == {(0, 3)}
    assert drive_attributions(apart, {}) == []


def test_a_stopped_sweep_goes_on_and_its_tables_keep_parts_of_the_rain_apart(scenario, tmp_path):
    sweep, folder = sweep_of([scenario], attribute=["streaks", "medium"], seeds=1), SweepFolder(tmp_path)
    jobs = jobs_of(sweep)
    assert len(jobs) == 5  # four coalitions, and the clear drive with other settings of what is off
    folder.describe(sweep, jobs)
    for stops_after, known in (2, 0), (None, 5):
        for _ in run_sweep(folder.to_do(jobs)[:stops_after], SerialExecutor(), folder):
            pass
        numbers = write_tables(folder, sweep, jobs).numbers
        assert len(numbers["attribution"]) == known
    assert not folder.to_do(jobs) and len(folder.log.read_text().splitlines()) == 5
    for each in numbers["attribution"]:
        assert np.isclose(sum(share["mean"] for share in each["shares"]), each["whole"]["mean"], atol=1e-12)
    assert json.loads((tmp_path / "summary.json").read_text()) == json.loads(json.dumps(numbers))

    def table(name):
        with (tmp_path / name).open(newline="") as file:
            return list(csv.DictReader(file))

    assert {row["id"] for row in table("table.csv")} == {job.id for job in drives_of(sweep)}
    assert [row["factors"] for row in table("attribution_drives.csv")] == ["", "streaks", "medium", "streaks+medium"]
    assert {row["factor"] for row in table("attribution.csv")} == {"streaks", "medium"}
    assert "Shares of the factors" in (tmp_path / "report.html").read_text()
    cells = numbers["cells"]
    assert [(cell["intensity_mm_h"], cell["runs"]) for cell in cells] == [(0.0, 1), (8.5, 1)]


def test_drop_sizes_are_an_axis_of_drives(scenario):
    jobs = jobs_of(sweep_of([scenario], diameter_scale=[0.5, 2.0], seeds=1, intensities_mm_h=[8.5]))
    assert [job.scenario.rain.diameter_scale for job in jobs] == [job.parameters["diameter_scale"] for job in jobs]
    assert {job.variant.title for job in jobs} == {"diameters x0.5", "diameters x2"}
    assert structs.replace(jobs[0].scenario.rain, diameter_scale=1.0) == RainSettings(
        intensity_mm_h=8.5, glass="lens", seed=0
    )
