"""Work that goes on behind the window."""

from gsrain_engine.session.jobs.rainy_look_job import TITLE, make_rainy_look

from .action import Action

JOB_ACTIONS = (
    Action(
        TITLE,
        make_rainy_look,
        "Scene",
        help="Give the scene, in the background, an overcast sky and a wet road that come with the rain's intensity.",
        is_possible=lambda session: not session.running_jobs and session.staged is None,
    ),
)
