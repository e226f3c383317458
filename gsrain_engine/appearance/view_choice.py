"""Choice of the views of a scene that a look is made for, as settings; `scene_views` places and draws them."""

from typing import Annotated, Literal

from msgspec import Meta

from ..settings import Settings

Source = Literal["auto", "recorded", "rig", "path", "around"]
_Count = Annotated[
    int,
    Meta(ge=1, le=100_000, title="Number of views", description="Number of views, evenly over all there are.",
         extra={"none": "as many as fit", "usual": 24, "commands": "transfer"}),
]  # fmt: skip
_Width = Annotated[
    int,
    Meta(ge=16, le=16384, title="Width of pictures",
         description="Width of the images, which keep their proportions; those of a capture are never enlarged.",
         extra={"unit": "px", "none": "as 480 x 320", "usual": 480, "commands": "transfer, evaluate detection"}),
]  # fmt: skip


class ViewChoice(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """User settings for the choice of views."""

    source: Annotated[
        Source,
        Meta(title="Views", description="recorded: the cameras of a capture; rig: the scene's own, along the ego's "
             "way; path: its camera path; around: outwards from its middle and inwards from a ring; auto: the first "
             "there is.", extra={"option": "views", "commands": "transfer"}),
    ] = "auto"  # fmt: skip
    count: _Count | None = None
    """None is all views of a recording, and 24 otherwise."""
    width_px: _Width | None = None
    """None gives images as many pixels as 480 x 320, at most their own."""
    sensors: Annotated[
        tuple[str, ...],
        Meta(title="Cameras", description="Only these of the rig (RIG/NAME, NAME or all) or the recording.",
             extra={"option": "cameras", "commands": "transfer, evaluate detection"}),
    ] = ()  # fmt: skip
