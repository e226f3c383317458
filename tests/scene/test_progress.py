import pytest

from gsrain_engine.scene.progress import Progress, run_to_end


def work(stops_at=None):
    for i in range(3):
        if i == stops_at:
            raise ValueError("the disk is full")
        yield Progress(i / 3, f"step {i}")
    return "a scene"


def test_work_is_done_to_its_end_and_every_step_is_told():
    told = []
    assert run_to_end(work(), told.append) == "a scene"
    assert [step.message for step in told] == ["step 0", "step 1", "step 2"]
    assert run_to_end(work()) == "a scene"


def test_what_work_raises_comes_through():
    told = []
    with pytest.raises(ValueError, match="disk is full"):
        run_to_end(work(stops_at=2), told.append)
    assert len(told) == 2
