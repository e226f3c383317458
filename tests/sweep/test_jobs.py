import msgspec
import pytest

from extension_package import installed
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.settings import DriveSweep, RenderSweep, load_sweep, sweep_names

from .small_sweep import small_jobs, sweep_of, write_road, write_scenario


def test_every_combination_is_one_job_and_scenes_stay_together(tmp_path):
    roads = [str(write_road(tmp_path / name)) for name in ("b", "a")]
    scenarios = [write_scenario(tmp_path / f"{name}.yaml", roads[0]) for name in ("near", "far")]
    jobs = jobs_of(sweep_of(scenarios, scenes=roads, intensities_mm_h=[0, 8.5, 8.5], seeds=[3, 5, 3]))
    assert len({job.id for job in jobs}) == len(jobs) == 2 * 2 * 2 * 2
    assert [job.scene for job in jobs] == sorted(job.scene for job in jobs)
    assert {job.scenario.scene for job in jobs} == set(roads)


def test_an_id_follows_from_what_the_result_depends_on_and_from_nothing_else(tmp_path):
    first = small_jobs(tmp_path)
    assert [job.id for job in small_jobs(tmp_path, output="elsewhere")] == [job.id for job in first]
    turned = small_jobs(tmp_path, intensities_mm_h=[8.5, 0])
    assert {job.id for job in turned} == {job.id for job in first}
    others = [small_jobs(tmp_path, backend="auto"), small_jobs(tmp_path, jitter={"ahead_m": 2.0}, seeds=[1])]
    assert all({job.id for job in other}.isdisjoint(job.id for job in first) for other in others)


def test_an_id_follows_the_bytes_of_scene_and_detector(tmp_path):
    scenario, detector = write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road")), tmp_path / "some.onnx"
    sweep = sweep_of([scenario], agents=[{"name": "constant-velocity", "detector": str(detector)}])
    detector.write_bytes(b"first")
    first = jobs_of(sweep)
    detector.write_bytes(b"other")
    trained = jobs_of(sweep)
    road = tmp_path / "road" / "scene.json"
    road.write_bytes(road.read_bytes() + b"\n")
    painted = jobs_of(sweep)
    ids = [{job.id for job in jobs} for jobs in (first, trained, painted)]
    assert not ids[0] & ids[1] and not ids[1] & ids[2]
    assert first[0].files.keys() == {str(detector)}


def test_an_id_follows_the_bytes_of_a_drivers_own_file(tmp_path):
    scenario, driver = write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road")), tmp_path / "mine.py"
    sweep = sweep_of([scenario], agents=[f"{driver}:Mine"])
    with pytest.raises(ValueError, match=r"mine.py:Mine: no such file"):
        jobs_of(sweep)
    driver.write_text("first")
    first = jobs_of(sweep)
    driver.write_text("other")
    assert {job.id for job in first}.isdisjoint(job.id for job in jobs_of(sweep))
    assert first[0].files.keys() == {str(driver)} and first[0].agent.title == "mine.py:Mine"


def test_an_id_follows_the_version_of_a_package_that_is_used(tmp_path):
    scenario = write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road"))
    (tmp_path / "car.blob").touch()
    user = {"id": "lead", "model": str(tmp_path / "car.blob"), "ahead_m": 15.0, "behaviour": {"kind": "stationary"}}
    other = write_scenario(tmp_path / "other.yaml", tmp_path / "road", road_users=[user])
    entries = {"gsrain.agents": {"mine": "mine:A"}, "gsrain.decoders": {"mine": "mine:D"}}
    formats = {"gsrain.scene_formats": {"blob": "blobs:F"}}
    seer = {"name": "constant-velocity", "detector": str(other)}
    with (
        installed(tmp_path / "a", "drivers", {"mine.py": ""}, entries),
        installed(tmp_path / "b", "blobs", {"blobs.py": ""}, formats),
    ):
        jobs = jobs_of(sweep_of([scenario, other], agents=["mine", "constant-velocity"], seeds=1))
        seeing = jobs_of(sweep_of([scenario], agents=[seer], seeds=1))
    drivers, blobs = {"drivers": "0.1.0"}, {"blobs": "0.1.0"}
    found = {(job.scenario.name, job.agent.name): job.packages for job in jobs}
    assert found == {
        ("short", "mine"): drivers, ("short", "constant-velocity"): {},
        ("other", "mine"): drivers | blobs, ("other", "constant-velocity"): blobs}  # fmt: skip
    assert seeing[0].packages == drivers
    assert msgspec.structs.replace(jobs[0], packages={"drivers": "0.2.0"}).id != jobs[0].id


def test_a_seed_begins_alike_at_every_intensity_and_seed_0_as_it_was_written(tmp_path):
    jobs = small_jobs(tmp_path, seeds=3, jitter={"ego_speed_m_s": 0.5, "ahead_m": 1.0, "left_m": 0.2, "speed_m_s": 1})
    starts = {}
    for job in jobs:
        lead = job.scenario.road_users[0]
        starts.setdefault(job.seed, set()).add((job.scenario.speed_m_s, lead.ahead_m, lead.left_m))
        assert job.scenario.rain.seed == job.seed
        assert lead.speed_m_s == 0  # what stands does not begin to move
    assert starts[0] == {(5.0, 15.0, 0.0)}
    assert len(starts[1]) == len(starts[2]) == 1 and starts[1] != starts[2]
    speed, ahead, left = starts[1].pop()
    assert abs(speed - 5) <= 1 and abs(ahead - 15) <= 2 and 0 < abs(left) <= 0.4


def test_one_deviation_leaves_what_the_others_give(tmp_path):
    both, one = (
        small_jobs(tmp_path, seeds=[7], jitter=jitter)[0].scenario.road_users[0]
        for jitter in ({"ahead_m": 1.0, "left_m": 0.1}, {"left_m": 0.1})
    )
    assert one.ahead_m == 15.0 != both.ahead_m and one.left_m == both.left_m != 0


def test_what_is_wrong_is_said_before_anything_runs(tmp_path):
    road = write_road(tmp_path / "road")
    scenario = write_scenario(tmp_path / "short.yaml", road)
    for changes, said in (
        ({"agents": ["nobody"]}, "agent nobody: there is none"),
        ({"agents": [{"name": "constant-velocity", "detector": "absent.onnx"}]}, "no detector absent.onnx"),
        ({"agents": ["constant-velocity", {"name": "constant-velocity"}]}, "two agents are called 'constant-velocity'"),
        ({"scenes": [str(tmp_path / "absent")]}, "no such scene"),
    ):
        with pytest.raises(ValueError, match=said):
            jobs_of(sweep_of([scenario], **changes))
    with pytest.raises(ValueError, match="two scenarios are called 'short'"):
        jobs_of(sweep_of([scenario, scenario]))
    file = tmp_path / "sweep.yaml"
    file.write_text("kind: drive\nscenarios: [stationary-lead]\nintensities_mm_h: [120]\n")
    with pytest.raises(ValueError, match=r"<= 100.0 - at `\$.intensities_mm_h\[0\]`"):
        load_sweep(file)
    file.write_text("kind: drive\nscenarios: [stationary-lead]\nseed: 3\n")
    with pytest.raises(ValueError, match="unknown field `seed`"):
        load_sweep(file)


@pytest.mark.parametrize("name", sweep_names())
def test_shipped_sweeps_are_complete(name):
    sweep = load_sweep(name)
    assert isinstance(sweep, RenderSweep if name == "dataset" else DriveSweep)
    assert len(jobs_of(sweep)) == {"paper": 160, "tiny": 4, "dataset": 4}[name]


def test_a_clear_clip_is_made_once_whatever_the_seeds():
    told = {"kind": "render", "recording": {"output": "clip.mp4"}, "intensities_mm_h": [0, 5], "seeds": 3}
    jobs = jobs_of(msgspec.convert(told, RenderSweep))
    assert sorted((job.rain.intensity_mm_h, job.rain.seed) for job in jobs) == [(0, 0), (5, 0), (5, 1), (5, 2)]


def test_a_clip_stays_in_its_own_folder():
    for name in ("", ".", "./", "n" * 256 + ".mp4", "clip\0.mp4", "clip.gif"):
        with pytest.raises(ValueError, match=r"^recording\.output"):
            jobs_of(msgspec.convert({"kind": "render", "recording": {"output": name}}, RenderSweep))
    told = {"kind": "render", "recording": {"output": "../clip.mp4"}}
    with pytest.raises(ValueError, match="a name in the clip's own folder"):
        jobs_of(msgspec.convert(told, RenderSweep))
