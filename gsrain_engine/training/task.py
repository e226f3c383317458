"""Reconstruction task: input, output and options."""

from dataclasses import replace
from pathlib import Path

import msgspec

from ..datasets.capture import Capture, CaptureError, readable_images
from ..datasets.image_override import with_images
from ..datasets.layout_hints import nearest_layout
from ..datasets.masks import read_camera_masks, with_camera_masks
from ..datasets.open_capture import open_capture
from ..scene.files import shortened
from .evaluation import validation_indices
from .settings import TrainingSettings


class ReconstructionTask(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A reconstruction request; picklable for a worker process."""

    capture: Path
    output: Path
    """Scene folder."""
    settings: TrainingSettings
    images: Path | None = None
    """Folder with images that replace the capture's own."""
    masks: Path | None = None
    """Folder with one mask image per camera, of the same name: white pixels are used, black ones (own hood) are not."""
    resume: bool = False
    """Resume from the checkpoint next to the output."""
    lpips: Path | None = None
    """LPIPS weights; None uses those installed on this machine, if any."""
    report: Path | None = None
    snapshot: Path | None = None
    """Scene folder for a preview, rewritten at each held-out evaluation."""

    allow_outside: bool | None = None
    """Allow files outside the capture's folder that its files name; None leaves it to the context."""

    @property
    def checkpoint(self) -> Path:
        """Checkpoint file of this task; removed once the scene is written."""
        return self.output.with_name(f"{shortened(self.output.name)}.checkpoint.npz")

    def read(self) -> Capture:
        """Read the capture; raises `CaptureError`, also if it has nothing to train on."""
        capture = readable_images(open_capture(self.capture, allow_outside=self.allow_outside))
        if self.images is not None:
            capture = with_images(capture, self.images)
        if self.masks is not None:
            capture = replace(capture, views=with_camera_masks(capture.views, read_camera_masks(self.masks)))
        if not capture.has_poses:
            near = nearest_layout(self.capture)
            nearest = f"; nearest to this one is {near}" if near is not None else ""
            told = "nothing tells where the cameras stood; let COLMAP find it, and give its folder"
            raise CaptureError(f"{self.capture}: {told}{nearest}")
        if len(capture) < 2:
            raise CaptureError(
                f"{self.capture}: has {len(capture)} usable view{'s' * (not capture.views)}, at least 2 are needed"
            )
        self.held_out(capture)
        return capture

    def held_out(self, capture: Capture) -> list[int]:
        settings = self.settings
        return validation_indices([view.name for view in capture], settings.held_out, settings.held_out_views)

    def fingerprint(self, capture: Capture) -> str:
        """Text that identifies a capture's views, so that a checkpoint resumes only with its own."""
        names = [view.name for view in capture]
        pictures = "" if self.images is None else f", pictures of {self.images.name}"
        return f"{len(names)} views of {capture.name}, {names[0]} to {names[-1]}{pictures}"
