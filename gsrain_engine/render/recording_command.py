"""The command line that records the same as a `Recording`."""

import shlex

from .recording import Recording

_OPTIONS = {
    "fps": "--fps",
    "first_s": "--from",
    "last_s": "--to",
    "supersampling": "--supersampling",
    "motion_blur": "--motion-blur",
    "quality": "--quality",
}


def recording_command(recording: Recording, project: str) -> str:
    """What to type for the same bytes; `project` is the scene folder."""
    words = ["gsrain", "render", project, "-o", recording.output]
    if recording.size_px is not None:
        words += ["--size", "{}x{}".format(*recording.size_px)]
    plain = Recording(output=recording.output)
    for field, option in _OPTIONS.items():
        value = getattr(recording, field)
        if value != getattr(plain, field):
            words += [option, f"{value!r}"]
    if recording.cameras:
        words += ["--cameras", ",".join(recording.cameras)]
    if recording.passes != plain.passes:
        words += ["--passes", ",".join(recording.passes)]
    if recording.format != plain.format:
        words += ["--codec", recording.codec]
    if recording.twin:
        words.append("--twin")
    return shlex.join(words)
