"""Likeness of what the window shows while things move to the exact picture of the moment. Prints JSON, then lines.

The real window is moved by mouse and keys under Xvfb: an orbit, a flight, a ride along the path, and playback before a
still camera. What the screen shows at moments of each is compared with the exact picture of that moment (PSNR in the
middle of the viewport, without what is drawn over it), so that blur and lag both count. Pictures are counted when the
screen changes there. `--against CHECKOUT` does the same with another state of the sources, and prints both.
"""

import argparse
import ctypes
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

MOVES = ("orbit", "fly", "follow", "play")
_SCENES = {"street": "8.5", "street:dusk": "demo"}
"""Scenes with their rain."""
_WINDOW_PX = (1472, 967)
_SHARE = 0.6  # of the viewport's sides that is compared
_SETTLING_S = 3.0  # of a move, before it is measured: the quality of pictures has settled then
_MOMENTS = 10
_LONGEST_S = 600.0
_PAUSE_S = 1.0  # between moves
_SWING_PX, _SWING_S = 45.0, 3.0  # of the mouse, to both sides
_HALF_TURN_S = 1.5  # of flying forward, then back
_STARTS_S = 2.0  # time of the drive at which a move begins
_HEADER = 25  # integers of 32 bits at the begin of a screen dump


class Screen:
    """Screen of an Xvfb, mapped from its file."""

    def __init__(self, file: Path) -> None:
        self._bytes = np.memmap(file, np.uint8, "r")
        head = self._bytes[: 4 * _HEADER].view(">u4")
        size, colors, self._row, self._height = int(head[0]), int(head[19]), int(head[12]), int(head[5])
        self._begin = size + 12 * colors

    def look(self, x: int, y: int, width: int, height: int) -> np.ndarray:
        """Colors in a rectangle, (height, width, 3)."""
        rows = self._bytes[self._begin :][: self._row * self._height].reshape(self._height, self._row)
        return rows[y : y + height, 4 * x : 4 * (x + width)].reshape(height, width, 4)[..., 2::-1].copy()


class Hand:
    """Mouse and keyboard, by the X server's test extension, on a thread of their own."""

    def __init__(self) -> None:
        self._x11, self._test = ctypes.CDLL("libX11.so.6"), ctypes.CDLL("libXtst.so.6")
        self._x11.XOpenDisplay.restype = ctypes.c_void_p
        self._x11.XKeysymToKeycode.argtypes = ctypes.c_void_p, ctypes.c_ulong
        self._display = ctypes.c_void_p(self._x11.XOpenDisplay(None))
        self._ends = threading.Event()
        self._moving: threading.Thread | None = None

    def place(self, x: float, y: float) -> None:
        self._test.XTestFakeMotionEvent(self._display, -1, round(x), round(y), ctypes.c_ulong(0))
        self._x11.XFlush(self._display)

    def press(self, *, down: bool) -> None:
        self._test.XTestFakeButtonEvent(self._display, 1, int(down), ctypes.c_ulong(0))
        self._x11.XFlush(self._display)

    def key(self, letter: str, *, down: bool) -> None:
        code = self._x11.XKeysymToKeycode(self._display, ord(letter))
        self._test.XTestFakeKeyEvent(self._display, code, int(down), ctypes.c_ulong(0))
        self._x11.XFlush(self._display)

    def begin(self, move: str, x: float, y: float) -> None:
        """Begin a move at a point of the screen."""
        self.place(x, y)
        act = {"orbit": self._drag, "fly": self._fly}.get(move)
        if act is not None:
            self._moving = threading.Thread(target=act, args=(x, y), daemon=True)
            self._moving.start()

    def end(self) -> None:
        if self._moving is not None:
            self._ends.set()
            self._moving.join()
            self._ends.clear()
            self._moving = None

    def _drag(self, x: float, y: float) -> None:
        began = time.perf_counter()
        self.press(down=True)
        while not self._ends.wait(0.008):
            phase = 2 * np.pi * (time.perf_counter() - began) / _SWING_S
            self.place(x + _SWING_PX * np.sin(phase), y)
        self.press(down=False)

    def _fly(self, *_: float) -> None:
        keys, is_over = "ws", False
        while not is_over:
            self.key(keys[0], down=True)
            is_over = self._ends.wait(_HALF_TURN_S)
            self.key(keys[0], down=False)
            keys = keys[::-1]


@dataclass
class Moment:
    """Colors that the screen has shown, and the view of that moment."""

    move: str
    view: Any
    shown: np.ndarray
    exact: np.ndarray | None = None

    @property
    def psnr_db(self) -> float:
        assert self.exact is not None
        difference = self.shown.astype(np.float64) - self.exact
        return float(10 * np.log10(255**2 / max(np.mean(difference**2), 1e-6)))


@dataclass
class Measurement:
    """Moves the window, then lets it rest at each moment. `frame` is called once per frame of the interface."""

    screen: Screen
    seconds: float
    moves: tuple[str, ...]
    moments: list[Moment] = field(default_factory=list[Moment])
    pictures: dict[str, int] = field(default_factory=dict[str, int])
    frames: dict[str, int] = field(default_factory=dict[str, int])
    rested_s: list[float] = field(default_factory=list[float])
    """Time of each exact picture after the window had come to rest."""
    viewport: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Rectangle on the screen."""
    _began_s: float = 0.0
    _number: int = -1
    _last: bytes = b""
    _at_rest: int = -1
    _rests: int = 0
    _ended_s: float | None = None

    def __post_init__(self) -> None:
        self.hand = Hand()

    @property
    def _middle(self) -> tuple[int, int, int, int]:
        x, y, width, height = self.viewport
        inner_w, inner_h = round(_SHARE * width), round(_SHARE * height)
        return x + (width - inner_w) // 2, y + (height - inner_h) // 2, inner_w, inner_h

    def frame(self, workspace: Any) -> None:
        """Go on with the present move, or with the rest after all of them."""
        editor, now = workspace.editor, time.perf_counter()
        if editor.viewport.is_compiling or editor.busy is not None or editor.jobs.running or not self.viewport[2]:
            return
        if self._number < 0:
            if not workspace.pictures.is_settled or not editor.viewport.statistics:
                return
            self._begin_next(editor, now)
        elif self._number < len(self.moves):
            self._go_on(editor, now)
        else:
            self._rest(workspace, now)

    def _begin_next(self, editor: Any, now: float) -> None:
        """End a move; begin the next one when the window has taken its last event."""
        clock = editor.playback.clock
        if self._ended_s is None:
            self.hand.end()
            clock.playing, self._ended_s = False, now
        if now - self._ended_s < _PAUSE_S:
            return
        self._number, self._began_s, self._ended_s = self._number + 1, now, None
        if self._number == len(self.moves):
            return
        move = self.moves[self._number]
        self.pictures[move] = self.frames[move] = 0
        editor.viewport.go_home()
        clock.seek(_STARTS_S)
        clock.playing = move in ("follow", "play")
        editor.viewport.ride(move == "follow")
        x, y, width, height = self.viewport
        self.hand.begin(move, x + width / 2, y + height / 2)

    def _go_on(self, editor: Any, now: float) -> None:
        move, at_s = self.moves[self._number], now - self._began_s - _SETTLING_S
        if at_s < 0:
            return
        if at_s >= self.seconds:
            self._begin_next(editor, now)
            return
        shown = self.screen.look(*self._middle)
        self.frames[move] += 1
        self.pictures[move] += shown.tobytes() != self._last
        self._last = shown.tobytes()
        of_move = sum(each.move == move for each in self.moments)
        if at_s >= (of_move + 0.5) * self.seconds / _MOMENTS and of_move < _MOMENTS:
            self.moments.append(Moment(move, editor.viewport.shot(*self.viewport[2:]), shown))

    def _rest(self, workspace: Any, now: float) -> None:
        """Show each moment at rest, until its exact picture is on the screen."""
        from imgui_bundle import hello_imgui

        from gsrain_engine.scene.camera import Camera

        viewport = workspace.editor.viewport
        is_exact = viewport.detail.is_exact and workspace.pictures.is_current
        self._rests = self._rests + 1 if is_exact else 0
        if is_exact:
            hello_imgui.get_runner_params().fps_idling.enable_idling = False  # it would sleep
        if self._at_rest >= 0:
            if self._rests == 1:
                self.rested_s.append(now - self._began_s)
            if self._rests < 4:
                return
            self.moments[self._at_rest].exact = self.screen.look(*self._middle)
        self._at_rest, self._rests, self._began_s = self._at_rest + 1, 0, now
        if self._at_rest == len(self.moments):
            hello_imgui.get_runner_params().app_shall_exit = True
            return
        x, y, width, height = self.viewport
        self.hand.place(x + width / 2, y + height / 2 + self._at_rest % 2)  # the last event before the window rests
        view = self.moments[self._at_rest].view
        workspace.editor.playback.clock.seek(view.time_s)

        def shot(width: int, height: int, focal_scale: float = 1.0, **_: Any) -> Any:
            c, ratio = view.camera, width / view.camera.width
            camera = Camera(width, height, ratio * c.fx, ratio * c.fy, width / 2, height / 2, c.world_to_camera)
            return replace(view, camera=camera, focal_px=camera.fx * focal_scale)

        viewport.shot = shot


def measure(
    scene: str, preset: str, seconds: float, moves: tuple[str, ...], screen: Path, pictures: Path | None
) -> Any:
    """Measure one scene in this process, whose display is an Xvfb with a file for its screen."""
    from imgui_bundle import hello_imgui, imgui

    from ui.window import MainWindow  # imgui_bundle has to be imported first

    import glfw  # isort: skip
    from imgui_bundle import glfw_utils, immapp

    import ui.workspace
    from gsrain_engine.editor.editor import Editor
    from gsrain_engine.rain.settings import load_preset

    found = Measurement(Screen(screen), seconds, moves)
    draw = ui.workspace.viewport_panel

    def viewport_panel(*arguments: Any) -> tuple[int, int]:
        size = draw(*arguments)
        corner, padding = imgui.get_window_pos(), imgui.get_style().window_padding
        at = glfw.get_window_pos(glfw_utils.glfw_window_hello_imgui())
        bottom = corner.y + imgui.get_window_size().y - padding.y
        found.viewport = round(at[0] + corner.x + padding.x), round(at[1] + bottom - size[1]), *size
        return size

    ui.workspace.viewport_panel = viewport_panel  # pyright: ignore[reportPrivateImportUsage]

    def begin() -> Editor:
        editor = Editor(rain=load_preset(preset))
        editor.files.open(scene)
        return editor

    window = MainWindow(begin, on_frame=found.frame)
    parameters = window.parameters()
    parameters.ini_disable = True
    parameters.app_window_params.window_geometry.size = _WINDOW_PX

    def stop() -> None:
        time.sleep(_LONGEST_S)
        hello_imgui.get_runner_params().app_shall_exit = True

    threading.Thread(target=stop, daemon=True).start()
    began = time.process_time()
    immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
    found.hand.end()
    window.close()
    if window.failure is not None:
        raise window.failure
    rows = {}
    for move in moves:
        values = [each.psnr_db for each in found.moments if each.move == move and each.exact is not None]
        rows[move] = {
            "psnr_db": round(float(np.mean(values)), 2),
            "worst_db": round(min(values), 2),
            "pictures_per_s": round(found.pictures[move] / seconds, 1),
            "interface_per_s": round(found.frames[move] / seconds, 1),
        }
    if pictures is not None:
        _write_pictures(found.moments, pictures, scene.replace(":", "-"))
    rest = {"median": round(float(np.median(found.rested_s)), 2), "longest": round(max(found.rested_s), 2)}
    return {"moves": rows, "exact_after_s": rest, "viewport": found.viewport, "cpu_s": time.process_time() - began}


def _write_pictures(moments: list[Moment], folder: Path, name: str) -> None:
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    for number, each in enumerate(moments):
        if each.exact is not None:
            both = np.concatenate([each.shown, each.exact], axis=1)
            Image.fromarray(both).save(folder / f"{name}_{each.move}_{number}.png")


def _run(scene: str, arguments: argparse.Namespace, checkout: Path, label: str) -> dict[str, Any]:
    """Measure one scene in a process of its own, under an Xvfb of its own, from the sources of a checkout."""
    root = Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory() as folder:
        sys.path.insert(0, str(root / "packaging"))
        from metadata import write_metadata

        write_metadata(Path(folder, "metadata"), checkout)
        config = Path(folder, "config", "gsrain")
        config.mkdir(parents=True)
        (config / "preferences.json").write_text('{"hint": false}')
        options = ["--moves", ",".join(arguments.moves), "--seconds", str(arguments.seconds)]
        if arguments.pictures is not None:
            options += ["--pictures", str(arguments.pictures.resolve() / label)]
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join((str(Path(folder, "metadata")), str(checkout))),
            "XDG_CONFIG_HOME": str(Path(folder, "config")),
            "XDG_STATE_HOME": str(Path(folder, "state")),
        }
        server = f"-screen 0 1600x1000x24 -nocursor -fbdir {folder}"
        file = str(Path(folder, "Xvfb_screen0"))
        command = ["xvfb-run", "-a", "-s", server, sys.executable, __file__, scene, "--screen", file, *options]
        result = subprocess.run(command, env=environment, cwd=checkout, stdout=subprocess.PIPE, text=True, check=True)
        return json.loads(result.stdout.splitlines()[-1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=list(_SCENES))
    parser.add_argument("--moves", type=lambda text: tuple(text.split(",")), default=MOVES)
    parser.add_argument("--seconds", type=float, default=6.0, help="of each move")
    parser.add_argument("--against", type=Path, help="checkout of another state of the sources")
    parser.add_argument("--pictures", type=Path, help="folder for moments beside their exact pictures")
    parser.add_argument("--screen", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.screen is not None:
        scene = arguments.scenes[0]
        preset = _SCENES.get(scene, "8.5")
        print(
            json.dumps(measure(scene, preset, arguments.seconds, arguments.moves, arguments.screen, arguments.pictures))
        )
        return
    checkouts = {"now": Path(__file__).resolve().parents[1]}
    if arguments.against is not None:
        checkouts = {"before": arguments.against.resolve()} | checkouts
    found = {
        scene: {label: _run(scene, arguments, checkout, label) for label, checkout in checkouts.items()}
        for scene in arguments.scenes
    }
    print(json.dumps(found, indent=1))
    for scene, by_label in found.items():
        for move in arguments.moves:
            cells = []
            for label, result in by_label.items():
                row = result["moves"][move]
                cells.append(f"{label} {row['psnr_db']:5.2f} dB, {row['pictures_per_s']:4.1f} pictures/s")
            print(f"{scene:12} {move:7} {'; '.join(cells)}")


if __name__ == "__main__":
    main()
