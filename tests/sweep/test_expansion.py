"""Jobs of a sweep: every combination once, ids by content alone, equal starts by seed, and shards."""

import msgspec
import pytest

from extension_package import installed
from gsrain_engine.sweep.expansion import Shard, jobs_of
from gsrain_engine.sweep.settings import DriveSweep, RenderSweep, load_sweep, sweep_names

from .small_sweep import small_jobs, sweep_of, write_road, write_scenario


def ids(jobs):
    return {job.id for job in jobs}


@pytest.fixture
def short(tmp_path):
    """A scenario on a road of its own."""
    return write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road"))


def test_every_combination_is_one_job_and_scenes_stay_together(tmp_path):
    roads = [str(write_road(tmp_path / name)) for name in ("b", "a")]
    scenarios = [write_scenario(tmp_path / f"{name}.yaml", roads[0]) for name in ("near", "far")]
    jobs = jobs_of(sweep_of(scenarios, scenes=roads, intensities_mm_h=[0, 8.5, 8.5], seeds=[3, 5, 3]))
    assert len(ids(jobs)) == len(jobs) == 2 * 2 * 2 * 2
    assert [job.scene for job in jobs] == sorted(job.scene for job in jobs)
    assert {job.scenario.scene for job in jobs} == set(roads)


def test_an_id_follows_from_the_settings_that_the_result_depends_on_and_from_no_others(tmp_path):
    first = ids(small_jobs(tmp_path))
    assert ids(small_jobs(tmp_path, output="elsewhere", intensities_mm_h=[8.5, 0])) == first
    for changes in ({"backend": "auto"}, {"jitter": {"ahead_m": 2.0}, "seeds": [1]}):
        assert ids(small_jobs(tmp_path, **changes)).isdisjoint(first)


@pytest.mark.parametrize(
    ("agent", "file"),
    [({"name": "constant-velocity", "detector": "some.onnx"}, "some.onnx"), ("mine.py:Mine", "mine.py"),
     ("constant-velocity", "road/scene.json")],
)  # fmt: skip
def test_an_id_follows_the_bytes_of_scene_detector_and_driver(short, tmp_path, monkeypatch, agent, file):
    monkeypatch.chdir(tmp_path)
    sweep, path = sweep_of([short], agents=[agent]), tmp_path / file
    if not path.exists():
        with pytest.raises(ValueError, match=file):
            jobs_of(sweep)
    found = []
    for more in (b"", b"\n"):
        path.write_bytes((path.read_bytes() if path.exists() else b"") + more)
        found.append(jobs_of(sweep))
    assert ids(found[0]).isdisjoint(ids(found[1]))
    assert set(found[0][0].files) == (set() if "road" in file else {file})


def test_an_id_follows_the_bytes_of_a_vehicles_folder(short, tmp_path):
    car = tmp_path / "car"
    car.mkdir()
    for name in ("gs.pth", "wlh.json"):
        (car / name).write_text("[1.8, 4.0, 1.5]")
    user = {"id": "lead", "model": str(car), "ahead_m": 15.0, "behaviour": {"kind": "stationary"}}
    sweep = sweep_of([write_scenario(tmp_path / "own.yaml", tmp_path / "road", road_users=[user])])
    first = jobs_of(sweep)
    assert set(first[0].files) == {str(car)}
    (car / "wlh.json").write_text("[1.8, 4.1, 1.5]")
    assert ids(first).isdisjoint(ids(jobs_of(sweep)))


def test_an_id_follows_the_version_of_a_package_that_is_used(short, tmp_path):
    (tmp_path / "car.blob").touch()
    user = {"id": "lead", "model": str(tmp_path / "car.blob"), "ahead_m": 15.0, "behaviour": {"kind": "stationary"}}
    other = write_scenario(tmp_path / "other.yaml", tmp_path / "road", road_users=[user])
    entries = {"gsrain.agents": {"mine": "mine:A"}, "gsrain.decoders": {"mine": "mine:D"}}
    detecting = {"name": "constant-velocity", "detector": str(other), "label": "detecting"}
    with (
        installed(tmp_path / "a", "drivers", {"mine.py": ""}, entries),
        installed(tmp_path / "b", "blobs", {"blobs.py": ""}, {"gsrain.scene_formats": {"blob": "blobs:F"}}),
    ):
        jobs = jobs_of(sweep_of([short, other], agents=["mine", "constant-velocity", detecting], seeds=1))
    used = {"mine": {"drivers"}, "constant-velocity": set(), "detecting": {"drivers"}}
    for job in jobs:
        assert set(job.packages) == used[job.agent.title] | ({"blobs"} if job.scenario.name == "other" else set())
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
    alone = small_jobs(tmp_path, seeds=[1], jitter={"left_m": 0.2})[0].scenario.road_users[0]
    assert (alone.ahead_m, alone.left_m) == (15.0, left)  # one deviation leaves what the others give


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"agents": ["nobody"]}, "agent nobody"),
        ({"agents": [{"name": "constant-velocity", "detector": "absent.onnx"}]}, "absent.onnx"),
        ({"agents": ["constant-velocity", {"name": "constant-velocity"}]}, "'constant-velocity'"),
        ({"scenes": ["absent"]}, "absent"),
        ({"scenarios": ["short.yaml", "short.yaml"]}, "'short'"),
    ],
)
def test_impossible_sweeps_are_refused_before_anything_runs(short, changes, word, monkeypatch):
    monkeypatch.chdir(short.parent)
    with pytest.raises(ValueError, match=word):
        jobs_of(sweep_of(**{"scenarios": [short], **changes}))
    (short.parent / "sweep.yaml").write_text("kind: drive\nscenarios: [stationary-lead]\nseed: 3\n")
    with pytest.raises(ValueError, match=r"sweep\.yaml: .*`seed`"):
        load_sweep("sweep.yaml")


@pytest.mark.parametrize("name", sweep_names())
def test_shipped_sweeps_are_complete(name, tmp_path, monkeypatch):
    (tmp_path / "detector.onnx").touch()
    monkeypatch.setenv("GSRAIN_DETECTOR", str(tmp_path / "detector.onnx"))
    sweep = load_sweep(name)
    assert isinstance(sweep, RenderSweep if name == "dataset" else DriveSweep)
    assert len(jobs_of(sweep)) == {
        "paper": 320, "paper_hugsim": 160, "tiny": 4, "dataset": 4, "attribution": 170, "windshield": 240,
    }[name]  # fmt: skip


def render_jobs(output="clip.mp4", **fields):
    return jobs_of(msgspec.convert({"kind": "render", "recording": {"output": output}, **fields}, RenderSweep))


def test_a_clear_clip_is_made_once_whatever_the_seeds_and_in_its_own_folder():
    jobs = render_jobs(intensities_mm_h=[0, 5], seeds=3)
    assert sorted((job.rain.intensity_mm_h, job.rain.seed) for job in jobs) == [(0, 0), (5, 0), (5, 1), (5, 2)]
    for name in ("", ".", "./", "../clip.mp4", "n" * 256 + ".mp4", "clip\0.mp4", "clip.gif"):
        with pytest.raises(ValueError, match=r"^recording\.output"):
            render_jobs(name)


def test_shards_are_all_jobs_each_once_and_about_as_many(tmp_path):
    jobs = small_jobs(tmp_path, seeds=5)
    shards = [Shard.parse(f"{each}/3").of(jobs) for each in (1, 2, 3)]
    assert sorted(job.id for shard in shards for job in shard) == sorted(ids(jobs))
    assert [len(shard) for shard in shards] == [4, 3, 3]
    assert Shard.parse("2/3").of(jobs[::-1]) == shards[1][::-1] and str(Shard(2, 3)) == "2/3"
    for text in ("0/3", "4/3", "3", "1/0", "-1/3", "1/3/5", "$X/2"):
        with pytest.raises(ValueError, match="shard "):
            Shard.parse(text)
