"""The preferences of a session: at hand at once, and in their file soon after."""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import msgspec

from ..log import told
from .preferences import Preferences, checked, load_preferences, save_preferences, set_aside


class KeptPreferences:
    """A value that follows every change; the file follows it in `thread`, one write at a time."""

    def __init__(self, thread: ThreadPoolExecutor) -> None:
        self.value, self.trouble = load_preferences()
        """What is preferred, and one sentence when the file could not be used, which is told once."""
        if self.trouble is not None and (aside := set_aside()) is not None:
            self.trouble += f" (kept as {aside.name}; the usual settings are used)"
        self._thread = thread
        self._changed: dict[str, Any] = {}
        self._saving: Future[Preferences] | None = None

    def change(self, **fields: Any) -> None:
        """Prefer something else.

        Raises:
            msgspec.ValidationError: When a value is out of its bounds; the message names it.
        """
        self.value = checked(msgspec.structs.replace(self.value, **fields))
        self._changed.update(fields)

    def poll(self) -> None:
        """Write what has changed, unless a write is under way. Once a frame."""
        if self._saving is not None and self._saving.done():
            saving, self._saving = self._saving, None
            if (error := saving.exception()) is not None:
                told("The preferences can't be saved", Exception(str(error)))
        if self._changed and self._saving is None:
            changed, self._changed = self._changed, {}
            self._saving = self._thread.submit(save_preferences, **changed)

    def close(self) -> None:
        """Write what has not been written yet."""
        if self._changed:
            self._thread.submit(save_preferences, **self._changed)
