"""Asking for a capture: it is a folder or one file, and a dialog offers only one of both."""

from gsrain_engine.session.session import Session

from ..widgets.file_dialogs import ask_what_to_open

_FILES = "Captures{.json,.tfrecord,.pkl,.parquet},All files{.*}"


def ask_for_capture_folder(session: Session) -> None:
    ask_what_to_open("Open a capture (folder)", "", lambda chosen: session.captures.open(chosen[0]))


def ask_for_capture_file(session: Session) -> None:
    ask_what_to_open("Open a capture (file)", _FILES, lambda chosen: session.captures.open(chosen[0]))
