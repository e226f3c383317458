"""Panels of other installed packages: where one fails, it says so in its place and the window lives on."""

import logging
from dataclasses import replace
from typing import get_args

from imgui_bundle import imgui

from gsrain_engine.extensions import PANELS, Extension, loaded, say_once
from gsrain_engine.session.session import Session

from .panel import DockSide, Panel

logger = logging.getLogger("gsrain")


def installed_panels(taken: set[str]) -> tuple[Panel, ...]:
    """Return the panels of other packages; those that can't be used are left out, and named in the log.

    `taken` are the titles that there are already.
    """
    fit: list[Panel] = []
    for extension, panel in loaded(PANELS, Panel):
        if panel.title in taken | {each.title for each in fit}:
            say_once(str(extension.unfit(f"there is a panel {panel.title!r} already")))
        elif panel.side not in get_args(DockSide):
            say_once(str(extension.unfit(f"side {panel.side!r} is none of {', '.join(get_args(DockSide))}")))
        else:
            fit.append(replace(panel, draw=_Guarded(extension, panel)))
    return tuple(fit)


class _Guarded:
    """Draws a panel until it fails."""

    def __init__(self, extension: Extension, panel: Panel) -> None:
        self._extension = extension
        self._draw = panel.draw
        self._failure = ""

    def __call__(self, session: Session) -> None:
        if not self._failure:
            before = imgui.internal.ErrorRecoveryState()
            imgui.internal.error_recovery_store_state(before)
            try:
                self._draw(session)
            except Exception as error:  # it is code of others
                _close_what_is_open(before)
                self._failure = str(self._extension.unfit(error))
                session.problem = self._failure
                logger.error("%s", self._failure, exc_info=True)
            return
        imgui.text_wrapped(self._failure)
        if imgui.button("Try again"):
            self._failure = ""
        imgui.set_item_tooltip("Draw the panel once more.")


def _close_what_is_open(before: imgui.internal.ErrorRecoveryState) -> None:
    """End the groups, tables and popups that a panel has begun, and take back the styles that it has pushed."""
    io = imgui.get_io()
    asserted, shown = io.config_error_recovery_enable_assert, io.config_error_recovery_enable_tooltip
    io.config_error_recovery_enable_assert = io.config_error_recovery_enable_tooltip = False
    imgui.internal.error_recovery_try_to_recover_state(before)
    io.config_error_recovery_enable_assert, io.config_error_recovery_enable_tooltip = asserted, shown
