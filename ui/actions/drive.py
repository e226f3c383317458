"""Driving, and playing what was driven."""

from collections.abc import Callable

from gsrain_engine.session.edits.ego_drive import drive_along_own_path
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.chase import ChaseMode

from ..panels.drive_fields import ask_for_scenario
from ..panels.rollout_fields import FILM_HELP, ask_for_rollout, ask_where_to_film, ask_where_to_save_rollout
from ..panels.scenario_fields import ask_where_to_save_scenario
from .action import Action


def _plays(session: Session) -> bool:
    return session.drives.playing is not None


def _jump_to_collision(session: Session) -> None:
    playing = session.drives.playing
    if playing is not None and playing.collision_s is not None:
        session.drives.jump(session, playing.collision_s)


def _jump_to_smallest_ttc(session: Session) -> None:
    playing = session.drives.playing
    if playing is not None:
        session.drives.jump(session, playing.curves.most_critical_s)


def _hits(session: Session) -> bool:
    return session.drives.playing is not None and session.drives.playing.collision_s is not None


def _follow(mode: ChaseMode) -> Callable[[Session], None]:
    return lambda session: session.drives.follow(session, mode)


def _follows(mode: ChaseMode) -> Callable[[Session], bool]:
    return lambda session: session.drives.playing is not None and session.drives.chase.mode == mode


DRIVE_ACTIONS = (
    Action("Drive", lambda session: session.drives.start(session), "Drive", (),
           "Drive the scenario of the Drive panel through this scene, in the background.",
           lambda session: session.drives.why_not(session) is None),
    Action("Ego drives along the path", lambda session: session.edit("Ego drive", drive_along_own_path), "Drive", (),
           "For scenes without a recorded drive: the ego vehicle goes where the camera path goes, with a front camera.",
           lambda session: session.scene.path is not None),
    Action("Open a scenario...", ask_for_scenario, "Drive", (), "Our YAML, HUGSIM's YAML, or OpenSCENARIO."),
    Action("Save the scenario...", lambda session: ask_where_to_save_scenario(session.drives.wanted), "Drive", (),
           "As YAML, with the changes of the Drive panel."),
)  # fmt: skip
ROLLOUT_ACTIONS = (
    Action("Open a roll-out...", ask_for_rollout, "Drive", (), "A finished drive (JSON lines); it plays in the view."),
    Action("Save the roll-out...", ask_where_to_save_rollout, "Drive", (), "Write the one that plays as JSON lines.",
           _plays),
    Action("Film the drive...", ask_where_to_film, "Drive", (), FILM_HELP,
           lambda session: session.drives.why_no_film(session) is None),
    Action("Jump to the collision", _jump_to_collision, "Drive", (), "Stop at the moment in which something is hit.",
           _hits),
    Action("Jump to the smallest TTC", _jump_to_smallest_ttc, "Drive", (),
           "Stop at the moment of the smallest time to collision.", _plays),
    Action("Follow the ego vehicle", _follow("behind"), "Drive", (), "From 8 m behind and 3 m up.", _plays,
           _follows("behind")),
    Action("Look through the front camera", _follow("front camera"), "Drive", (), "Of the ego vehicle's rig.", _plays,
           _follows("front camera")),
    Action("Leave the ego vehicle", _follow("free"), "Drive", (), "The camera stays where it is.", _plays,
           _follows("free")),
    Action("Close the roll-outs", lambda session: session.drives.close_all(session), "Drive", (),
           "The scene with its own traffic comes back.", _plays),
)  # fmt: skip
