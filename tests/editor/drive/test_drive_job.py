"""A drive from a editor, in the process that a window would start."""

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.edits.members import set_visible

from .driven import CRASH, driven, settled, stopped_session


@pytest.fixture
def editor():
    editor = stopped_session(driven()[0], 4.0)
    editor.rollouts.setup.settings = msgspec.structs.replace(editor.rollouts.setup.settings, agent="constant-velocity")
    wanted = editor.rollouts.setup
    wanted.change(msgspec.convert(CRASH | {"duration_s": 3.0}, type(wanted.scenario)))
    yield editor
    editor.close()


def follow(editor):
    """Look after the last job as the window does, until it ends; returns it and what it showed."""
    job, shown = editor.jobs.all[-1], []
    while job.state == "running":
        editor.jobs.wait(60)
        editor.tick(0.0)
        if job.progress.preview is not None:
            shown.append(job.progress.preview)
    settled(editor)
    return job, shown


def test_what_a_person_has_edited_is_driven_through_and_opened(editor):
    editor.document.edit("Show or hide", set_visible, "layers/wall", False)
    steps = editor.document.history.cursor
    editor.rollouts.start()
    assert editor.rollouts.why_not == "A drive goes on."
    job, shown = follow(editor)
    assert job.kind == "drive"
    assert (job.state, job.error, editor.status.problem) == ("finished", None, None)
    (opened,) = editor.rollouts.opened
    assert editor.rollouts.playing is opened
    assert (opened.intensity_mm_h, opened.metrics.collided_with, opened.path) == (4.0, "lead", None)
    assert opened.metrics.with_background
    assert shown[-1].shape[1] == 320
    assert np.ptp(shown[-1]) > 50
    assert editor.document.history.cursor == steps
    assert editor.rollouts.step_now.step == 0


def test_an_agent_that_can_t_be_opened_is_one_problem(editor, tmp_path):
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"no network")
    editor.rollouts.setup.settings = msgspec.structs.replace(
        editor.rollouts.setup.settings, agent="camera-idm", detector=bad
    )
    editor.rollouts.start()
    job, _ = follow(editor)
    assert job.state == "failed"
    assert "bad.onnx" in job.error
    assert editor.rollouts.opened == []
