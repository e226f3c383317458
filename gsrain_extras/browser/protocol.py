"""Protocol of `gsrain serve` for browsers: a page with a live view and the settings of the rain."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gsrain.browser import DEFAULT_PORT, BrowserViewer
from gsrain_engine.simulation.serving.protocols import RainyScene, RunningServer, ServerOptions, ServerProtocol

logger = logging.getLogger("gsrain")


@dataclass(frozen=True)
class _Page:
    viewer: BrowserViewer
    scene: str

    @property
    def greeting(self) -> str:
        return f"open {self.viewer.url} in a browser on this machine"

    @property
    def numbers(self) -> dict[str, Any]:
        return {"scenes": [self.scene], "pictures": self.viewer.pictures}

    @property
    def is_ended(self) -> bool:
        return self.viewer.wait(0)

    def stop(self) -> str:
        pictures = self.viewer.pictures
        self.viewer.close()
        return f"{pictures:,} picture{'s' * (pictures != 1)} sent"


def _start(scenes: Sequence[RainyScene], options: ServerOptions) -> RunningServer:
    ((name, scene, rainfall),) = scenes
    if rainfall.weather.keys:
        logger.warning("%s: its rain keyframes are left out, as browsers set the rain", name)
    port = DEFAULT_PORT if options.port is None else options.port
    viewer = BrowserViewer(
        scene, rainfall.rain, backend=options.backend, port=port, browsers=options.sessions, token=options.token
    )
    return _Page(viewer, name)


def _check(scenes: int, options: ServerOptions) -> None:
    if scenes > 1:
        raise ValueError(f"--protocol browser shows one scene, not {scenes}")
    if options.host not in ("127.0.0.1", "localhost"):
        forward = f"ssh -L {options.port or DEFAULT_PORT}:localhost:{options.port or DEFAULT_PORT} THIS_MACHINE"
        raise ValueError(
            f"--host {options.host}: pages for browsers are not encrypted, so that only this machine gets them; "
            f"from another: {forward}"
        )


PROTOCOL = ServerProtocol(
    "browsers on this machine: a page with a live view and the settings of the rain", ("viser",), _check, _start
)
