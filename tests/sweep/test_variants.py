"""Further axes of a sweep: wet or dry, presets, exposures, start speeds, gaps; and HUGSIM clients as agents."""

import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.settings import load_preset
from gsrain_engine.report.interval import Interval
from gsrain_engine.sweep.executors import SerialExecutor
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.report import boundary_figure, grid_axes
from gsrain_engine.sweep.results import SummaryCell, SweepFolder, summarized
from gsrain_engine.sweep.run import run_sweep_and_report
from gsrain_engine.sweep.settings import AgentChoice, Sweep, Variant
from gsrain_engine.trusted_code import UntrustedCodeError, command_code, trust

from .small_sweep import small_jobs, sweep_of, write_road, write_scenario

pytestmark = pytest.mark.street

CLIENT = Path(__file__).parents[1] / "simulation" / "interop" / "client.py"


def ended(work):
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


def test_jobs_are_all_combinations_with_their_rain_and_start(tmp_path):
    jobs = small_jobs(
        tmp_path, wet=[False, True], preset=["paper"], exposure_s=[0.004, 0.05], gap_m=[8.0, 20.0], seeds=1,
        start_speed_m_s=[3.0], intensities_mm_h=[8.5], jitter={},
    )  # fmt: skip
    assert len({job.id for job in jobs}) == len(jobs) == 8
    for job in jobs:
        expected = msgspec.structs.replace(
            load_preset("paper"), intensity_mm_h=8.5, seed=0, exposure_s=job.variant.exposure_s,
            wetness=None if job.variant.wet else 0.0,
        )  # fmt: skip
        assert job.scenario.rain == expected
        assert (job.scenario.speed_m_s, job.scenario.road_users[0].ahead_m) == (3.0, job.variant.gap_m)
        assert msgspec.structs.asdict(job.variant).items() <= job.parameters.items()
    assert {(job.variant.wet, job.variant.exposure_s, job.variant.gap_m) for job in jobs} == {
        (wet, exposure, gap) for wet in (False, True) for exposure in (0.004, 0.05) for gap in (8.0, 20.0)
    }


def test_sensors_are_an_axis_of_drives_and_clips(tmp_path):
    own = tmp_path / "mine.yaml"
    own.write_text("f_number: 2.0")
    drives = small_jobs(tmp_path, sensor=["pinhole", str(own)], seeds=1, intensities_mm_h=[8.5], jitter={})
    assert [job.scenario.rain.sensor for job in drives] == [job.parameters["sensor"] for job in drives]
    assert {job.variant.title for job in drives} == {"sensor pinhole", "sensor mine"}
    assert {str(own) in job.files for job in drives} == {True, False}
    values = {"kind": "render", "recording": {"output": "clip"}, "intensities_mm_h": [0, 1.2], "seeds": 2}
    clips = jobs_of(msgspec.convert(values | {"sensor": ["pinhole", "automotive"]}, Sweep))
    assert len({job.id for job in clips}) == len(clips) == 8  # each seed without rain has noise of its own
    assert {job.parameters["sensor"] for job in clips} == {"pinhole", "automotive"}
    plain = jobs_of(msgspec.convert(values, Sweep))
    assert len(plain) == 3 and {job.parameters["sensor"] for job in plain} == {None}
    with pytest.raises(ValueError, match="sensor none such: no such file"):
        jobs_of(msgspec.convert(values | {"sensor": ["none such"]}, Sweep))


def test_the_mirror_is_an_axis_of_drives(tmp_path):
    jobs = small_jobs(tmp_path, mirror=[False, True], seeds=1, intensities_mm_h=[8.5], jitter={})
    assert [job.scenario.rain.mirror for job in jobs] == [job.parameters["mirror"] for job in jobs] == [False, True]
    assert [job.variant.title for job in jobs] == ["no mirror", "mirror"] and len({job.id for job in jobs}) == 2


def test_spray_and_friction_are_axes_of_drives(tmp_path):
    jobs = small_jobs(
        tmp_path, spray=[True, False], friction=["dry", "wet"], seeds=1, intensities_mm_h=[8.5], jitter={}
    )
    found = [(job.scenario.rain.spray, job.scenario.friction) for job in jobs]
    assert found == [(job.parameters["spray"], job.parameters["friction"]) for job in jobs]
    assert found == [(True, "dry"), (True, "wet"), (False, "dry"), (False, "wet")]
    assert jobs[3].variant.title == "no spray, wet friction" and len({job.id for job in jobs}) == 4


def test_a_scenario_without_road_users_has_no_gap(tmp_path):
    scenario = write_scenario(tmp_path / "alone.yaml", write_road(tmp_path / "road"), road_users=[])
    with pytest.raises(ValueError, match="gap_m"):
        jobs_of(sweep_of([scenario], gap_m=[5.0]))


def test_a_grid_of_gaps_has_its_boundary_in_report_and_figures(tmp_path):
    jobs_of_grid = sweep_of(
        [write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road"), duration_s=2.0)],
        gap_m=[15.0, 40.0], start_speed_m_s=[2.0, 9.0], seeds=1, intensities_mm_h=[0], jitter={},
    )  # fmt: skip
    numbers = ended(run_sweep_and_report(jobs_of_grid, tmp_path / "out", SerialExecutor())).numbers
    rates = {
        (cell["variant"]["start_speed_m_s"], cell["variant"]["gap_m"]): cell["collisions"] for cell in numbers["cells"]
    }
    assert rates == {(2.0, 15.0): 0, (2.0, 40.0): 0, (9.0, 15.0): 1, (9.0, 40.0): 0}
    assert [each.name for each in (tmp_path / "out" / "figures").iterdir() if "boundary" in each.name]
    assert "boundary" in (tmp_path / "out" / "report.html").read_text()


def cell(intensity, rate, **variant):
    spread = Interval(rate, rate, rate, "Wilson, 95 %", "drives", 4)
    return SummaryCell(
        scene="s", scenario="cut-in", agent="one", variant=Variant(**variant), intensity_mm_h=intensity, runs=4,
        failed=0, collisions=round(4 * rate), collision_rate=spread, means={}, changes={},
    )  # fmt: skip


def test_the_boundary_is_drawn_over_two_axes():
    grid = [(speed, gap) for speed in (5.0, 10.0) for gap in (5.0, 10.0, 20.0)]
    safe = [cell(0.0, 0.0, start_speed_m_s=speed, gap_m=gap) for speed, gap in grid]
    fails = [cell(0.0, float(speed > gap / 2), start_speed_m_s=speed, gap_m=gap) for speed, gap in grid]
    assert grid_axes(safe) == ["start_speed_m_s", "gap_m"] and grid_axes(safe[:1]) == []
    safe_image, failing_image = (boundary_figure(cells, grid_axes(cells)) for cells in (safe, fails))
    assert safe_image.shape == failing_image.shape
    reddish = [np.mean(image[..., 0].astype(int) - image[..., 1] > 60) for image in (safe_image, failing_image)]
    assert reddish[0] < 0.01 < 0.05 < reddish[1]  # the color bar is red at its end
    np.testing.assert_array_equal(failing_image, boundary_figure(fails, grid_axes(fails)))


def hugsim_sweep(tmp_path, *modes):
    scenario = write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road"), duration_s=1.0)
    agents = [{"hugsim": {"command": f"{sys.executable} {CLIENT} {{folder}} {mode}"}, "label": mode} for mode in modes]
    return sweep_of([scenario], agents=agents, seeds=2, intensities_mm_h=[8.5])


def test_hugsim_clients_drive_in_sweeps_and_a_dead_one_is_a_failed_row(tmp_path):
    sweep = hugsim_sweep(tmp_path, "brake", "die")
    with pytest.raises(UntrustedCodeError):
        ended(run_sweep_and_report(sweep, tmp_path / "out", SerialExecutor()))
    trust(command_code(each.hugsim.command).digest for each in sweep.agents)
    numbers = ended(run_sweep_and_report(sweep, tmp_path / "out", SerialExecutor())).numbers
    rows = SweepFolder(tmp_path / "out").read(jobs_of(sweep)).values()
    assert {(row["agent"], row["status"]) for row in rows} == {("brake", "finished"), ("die", "failed")}
    assert all(row["error"] is None or "client" in row["error"] for row in rows)
    runs = {each["agent"]: (each["runs"], each["failed"]) for each in numbers["cells"]}
    assert runs == {"brake": (2, 0), "die": (0, 2)}
    assert [(each.agent, each.runs) for each in summarized(rows)] == [("brake", 2), ("die", 0)]
    ((error, count),) = numbers["errors"].items()  # of both seeds, since it names no file of one job
    assert count == 2 and "its last words in the job's file in clients: " in error
    failed = next(row["id"] for row in rows if row["agent"] == "die")
    printed = (tmp_path / "out" / "clients" / f"{failed}.txt").read_text()
    assert printed.split("\n")[-2] in error


def test_a_client_that_can_t_be_started_ends_the_sweep(tmp_path):
    scenario = write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road"), duration_s=1.0)
    sweep = sweep_of([scenario], agents=[{"hugsim": {"command": "no-such-program-of-anyone"}}])
    trust([command_code("no-such-program-of-anyone").digest])
    with pytest.raises(OSError, match="can't be started"):
        ended(run_sweep_and_report(sweep, tmp_path / "out", SerialExecutor()))
    assert SweepFolder(tmp_path / "out").read(jobs_of(sweep)) == {}


@pytest.mark.parametrize("values", [{}, {"name": "hugsim"}, {"name": "oracle-idm", "hugsim": {"command": "x"}}])
def test_an_agent_is_a_name_or_a_client(values):
    with pytest.raises(msgspec.ValidationError, match="hugsim"):
        msgspec.convert(values, AgentChoice)
