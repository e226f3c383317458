"""Work that goes on behind the window."""

from gsrain_engine.session.appearance.rainy_scene_job import TITLE

from .action import Action

JOB_ACTIONS = (
    Action(
        TITLE,
        lambda session: session.rainy.make(session),
        "Scene",
        help="Transfer views and solve for wet colours, in the background, as the panel of this name says.",
        is_possible=lambda session: session.rainy.why_not(session) is None,
    ),
    Action(
        "Preview this view in rain",
        lambda session: session.rainy.preview(session),
        "Scene",
        help="Transfer what the view shows, and lay it beside the live picture.",
        is_possible=lambda session: session.rainy.why_no_preview(session) is None,
    ),
    Action(
        "Compare clear and rainy",
        lambda session: session.rainy.compare(session),
        "View",
        help="Lay the clear scene beside the rainy one, with a line between them that can be dragged.",
        is_possible=lambda session: session.scene.has_wet_colors,
    ),
)
