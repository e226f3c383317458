"""Which view of a capture a recorded one is matched with."""

from typing import Literal, get_args

from gsrain_engine.datasets.capture import Capture

Against = Literal["next", "previous", "beside", "chosen"]
AGAINST: tuple[Against, ...] = get_args(Against)

WHY_NONE: dict[Against, str] = {
    "next": "This is the last view of its camera.",
    "previous": "This is the first view of its camera.",
    "beside": "There is no other camera.",
    "chosen": "Choose another view in the list.",
}
"""What is told where there is no such view."""


def neighbour(capture: Capture, of: int, against: Against, chosen: int) -> int | None:
    """Which view a recorded one is matched with; None where there is none.

    `beside` is that view of another camera that looks most nearly the same way, among those nearest in time.
    """
    view = capture[of]
    if against == "chosen":
        return chosen if chosen != of else None
    same = [i for i, each in enumerate(capture) if each.sensor == view.sensor]
    if against != "beside":
        at = same.index(of) + (1 if against == "next" else -1)
        return same[at] if 0 <= at < len(same) else None
    others: dict[str, int] = {}
    for i, each in enumerate(capture):
        best = others.get(each.sensor)
        apart = abs(each.time_s - view.time_s)
        if each.sensor != view.sensor and (best is None or apart < abs(capture[best].time_s - view.time_s)):
            others[each.sensor] = i
    ahead = view.camera.world_to_camera[2, :3]
    return max(others.values(), key=lambda i: float(capture[i].camera.world_to_camera[2, :3] @ ahead), default=None)
