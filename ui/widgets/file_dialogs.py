"""File dialogs: who asks says what to do with the answer, which comes in a later frame."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from imgui_bundle import im_file_dialog

from gsrain_engine.scene.formats.gaussian_files import writable_suffixes
from gsrain_engine.session.session import Session

Answer = Callable[[list[Path]], None]


class _Waiting(NamedTuple):
    answer: Answer
    nameless: frozenset[str]
    """What a dialog for a file to write makes of no name: the bare end of a name, as `.ply` or `.*`."""


_waiting: dict[str, _Waiting] = {}
"""By the dialogs' titles; there is one window."""

SCENE_FOLDERS = "Scene folders{.*}"
"""All that a scene can be saved as."""


def exported_kinds() -> str:
    """Kinds of single files that a scene can be exported to, each by itself; those of installed packages too."""
    return ",".join(f"{suffix.lstrip('.').upper()} files{{{suffix}}}" for suffix in writable_suffixes())


def ask_what_to_open(title: str, kinds: str, answer: Answer, *, several: bool = False) -> None:
    """Show a dialog for files that exist; `kinds` as in "Scenes{.ply,.spz},All files{.*}"."""
    _waiting[title] = _Waiting(answer, frozenset())
    im_file_dialog.FileDialog.instance().open(title, title, kinds, several)


def ask_where_to_save(title: str, kinds: str, answer: Answer) -> None:
    ends = re.findall(r"[{,](\.[^,{}]*)", kinds)
    _waiting[title] = _Waiting(answer, frozenset(ends))
    im_file_dialog.FileDialog.instance().save(title, title, kinds)


def answer_dialogs(session: Session) -> None:
    """Act on dialogs that were closed. Once a frame."""
    dialogs = im_file_dialog.FileDialog.instance()
    for title in list(_waiting):
        if not dialogs.is_done(title):
            continue
        waiting = _waiting.pop(title)
        chosen = [Path(each.path()) for each in dialogs.get_results()] if dialogs.has_result() else []
        dialogs.close()
        if any(path.name in waiting.nameless for path in chosen):
            session.problem = f"{title}: no name was typed; choose a folder, then type a name behind File name."
        elif chosen:
            waiting.answer([_meant(path) for path in chosen])


def _meant(path: Path) -> Path:
    """What was typed: to a name without a suffix the dialog adds that of the chosen kind, even where it is `.*`."""
    return path.with_suffix("") if path.suffix == ".*" else path
