"""A drive from a session, in the process that a window would start."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from .driven import CRASH, driven, settled, stopped_session


@pytest.fixture
def session():
    session = stopped_session(driven()[0], 4.0)
    session.drives.settings.settings = msgspec.structs.replace(
        session.drives.settings.settings, agent="constant-velocity"
    )
    wanted = session.drives.settings
    wanted.change(msgspec.convert(CRASH | {"duration_s": 3.0}, type(wanted.scenario)))
    yield session
    session.close()


def follow(session):
    """Look after the last job as the window does, until it ends; returns it and what it showed."""
    job, shown = session.jobs.all[-1], []
    while job.state == "running":
        session.jobs.wait(60)
        session.update(0.0)
        if job.progress.preview is not None:
            shown.append(job.progress.preview)
    settled(session)
    return job, shown


def test_what_a_person_has_edited_is_driven_through_and_opened(session):
    session.show_member("layers/wall", False)
    steps = session.history.cursor
    session.drives.start(session)
    assert session.drives.why_not(session) == "A drive goes on."
    job, shown = follow(session)
    assert job.kind == "drive"
    assert (job.state, job.error, session.problem) == ("finished", None, None)
    (opened,) = session.drives.opened
    assert session.drives.playing is opened
    assert (opened.intensity_mm_h, opened.metrics.collided_with, opened.path) == (4.0, "lead", None)
    assert opened.metrics.with_background
    assert shown[-1].shape[1] == 320
    assert np.ptp(shown[-1]) > 50
    assert session.history.cursor == steps
    assert session.drives.step_now(session).step == 0


def test_an_agent_that_can_t_be_opened_is_told_in_one_sentence(session, tmp_path):
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"no network")
    session.drives.settings.settings = msgspec.structs.replace(
        session.drives.settings.settings, agent="camera-idm", detector=bad
    )
    session.drives.start(session)
    job, _ = follow(session)
    assert job.state == "failed"
    assert "bad.onnx" in job.error
    assert session.drives.opened == []


def test_a_scene_without_a_drive_can_t_be_driven_through(session):
    session.set_scene("no drive", replace(session.scene, ego=None))
    assert "no recorded drive" in session.drives.why_not(session)
    session.drives.start(session)
    assert session.jobs.all == []
    assert "no recorded drive" in session.problem
