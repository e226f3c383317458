"""Work that goes on behind the window."""

from gsrain_engine.session.jobs.rainy_look_job import TITLE

from .action import Action

JOB_ACTIONS = (
    Action(
        TITLE,
        lambda session: session.make_rainy(),
        "Scene",
        help="Give the scene an overcast sky and a wet road, in the background; undo brings the clear one back.",
        is_possible=lambda session: not session.running_jobs and session.staged is None,
    ),
)
