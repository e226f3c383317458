"""Measurement of `across.py` inside a process: one job, by name. Prints wall and processor seconds.

What stands before the clock is started (imports, opening the street, the first frame, in which kernels are loaded) is
not in them, unless that is the question.
"""

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SIZE = (960, 640)
FRAMES = 20


class Clock:
    """Seconds of the wall, and of the processor in all threads, from now on."""

    def __init__(self) -> None:
        self._wall, self._work = time.perf_counter(), time.process_time()

    def seconds(self, shared_by: int = 1) -> tuple[float, float]:
        """Elapsed time per item."""
        wall, work = time.perf_counter() - self._wall, time.process_time() - self._work
        return wall / shared_by, work / shared_by


def prepared(folder: Path) -> None:
    """Write the files that the others open, unless they are there: 1 M Gaussians of degree 3, and pictures."""
    from million_files import write_million, write_pictures

    write_million(folder)
    write_pictures(folder)


def window(folder: Path) -> tuple[float, float]:
    """From the start of Python to the street's first picture, and what the processor did for it."""
    from imgui_bundle import hello_imgui, immapp

    from gsrain_engine.editor.drawing.textures import compile_kernels
    from ui.window import MainWindow

    found: list[tuple[float, float]] = []

    def begin() -> Any:
        from ui.window import begin_editor

        return begin_editor(None, None)

    shown = MainWindow(begin)
    parameters = shown.parameters()
    parameters.ini_disable = True

    def watch() -> None:
        until = time.monotonic() + 300
        while time.monotonic() < until and not found:
            time.sleep(0.005)
            workspace = shown.workspace
            if workspace is not None and workspace.editor.viewport.statistics.get("splats drawn"):
                found.append((time.monotonic() - float(os.environ["ACROSS_STARTED"]), time.process_time()))
        hello_imgui.get_runner_params().app_shall_exit = True

    threading.Thread(target=watch, daemon=True).start()
    immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
    if shown.failure is not None:
        raise shown.failure
    compile_kernels()  # the window was closed too soon for it: the next one is to find them
    return found[0]


def opened(folder: Path, name: str) -> tuple[float, float]:
    """Open a scene of 1 M Gaussians to be drawn; imports and kernels stand before the clock."""
    from gsrain_engine.scene.open import load_sorted_scene

    load_sorted_scene(str(folder / "small" / name))
    clock = Clock()
    scene = load_sorted_scene(str(folder / name))
    taken = clock.seconds()
    assert scene.gaussian_count == 1_000_000
    return taken


def saved(folder: Path, name: str) -> tuple[float, float]:
    """Write 1 M Gaussians into a file."""
    from gsrain_engine.scene.formats.scene_files import write_scene
    from gsrain_engine.scene.open import load_scene

    scene = load_scene(str(folder / "million"))
    clock = Clock()
    write_scene(scene, folder / name)
    return clock.seconds()


def _street() -> Any:
    from gsrain_engine.scene.open import load_sorted_scene

    return load_sorted_scene("street")


def _sequence(scene: Any) -> Any:
    from gsrain_engine.rain.settings import load_preset
    from gsrain_engine.rain.simulation import RainSimulation
    from gsrain_engine.render.sequence import FrameSequence, find_rig_cameras

    (camera,) = find_rig_cameras(scene, ("waymo_front3/FRONT",))
    return FrameSequence(scene, RainSimulation.start(load_preset("8.5")), camera, *SIZE)


def _frames(chosen: Callable[[Any, int], tuple[Any, int]]) -> tuple[float, float]:
    """Draw frames of the street in rain; `chosen` says of which sequence each is, and its number there."""
    from gsrain_engine.backends import open_renderer

    street = _sequence(_street())
    with open_renderer("cpu") as renderer:
        sky = street.sky(renderer)
        for number in range(3):
            street.frame(renderer, number, sky)
        clock = Clock()
        for count in range(FRAMES):
            sequence, number = chosen(street, count)
            sequence.frame(renderer, number, sky)
        return clock.seconds(FRAMES)


def played(folder: Path) -> tuple[float, float]:
    """Frames of the street in rain, one after the other."""
    return _frames(lambda street, count: (street, 3 + count))


def scrubbed(folder: Path) -> tuple[float, float]:
    """Frames of the street in rain, from all over its drive."""
    return _frames(lambda street, count: (street, count * 97 % 180))


def moved_slider(folder: Path) -> tuple[float, float]:
    """A frame of the street, each in another intensity: another rain begins."""
    from dataclasses import replace

    from msgspec import structs

    from gsrain_engine.rain.simulation import RainSimulation

    def moved(street: Any, count: int) -> tuple[Any, int]:
        rain = structs.replace(street.rainfall.rain, intensity_mm_h=2.0 + 0.5 * count)
        return replace(street, rainfall=RainSimulation.start(rain)), 3

    return _frames(moved)


def recorded(folder: Path, name: str) -> tuple[float, float]:
    """Frames of the street in rain, into a file or a folder."""
    from gsrain_engine.backends import open_renderer
    from gsrain_engine.render.export import export_frames
    from gsrain_engine.render.export_settings import ExportSettings

    sequence = _sequence(_street())
    with open_renderer("cpu") as renderer:
        for _ in export_frames(
            renderer, ExportSettings(output=str(folder / f"first-{name}")), {"": sequence}, range(2)
        ):
            pass
        clock = Clock()
        for _ in export_frames(renderer, ExportSettings(output=str(folder / name)), {"": sequence}, range(FRAMES)):
            pass
        return clock.seconds(FRAMES)


def recolored(folder: Path) -> tuple[float, float]:
    """Solve for the street's colors in eight views of another look, 480 x 320."""
    import numpy as np

    from gsrain_engine.appearance.scene_views import ViewChoice, chosen_cameras, scene_views
    from gsrain_engine.recolor.problem import RecolorSettings
    from gsrain_engine.recolor.recolor import recolor_scene
    from gsrain_engine.recolor.views import TargetView
    from gsrain_engine.scene.progress import run_to_end

    scene = _street()
    views = scene_views(scene, chosen_cameras(scene, ViewChoice(count=8, width_px=480)))
    targets = [TargetView(v.name, v.camera, v.time_s, (v.image**2).astype(np.float32)) for v in views]
    run_to_end(recolor_scene(scene, targets[:2], targets[4:5], RecolorSettings(iterations=1)))
    clock = Clock()
    run_to_end(recolor_scene(scene, targets[:4] + targets[5:], targets[4:5], RecolorSettings()))
    return clock.seconds()


def reconstructed(folder: Path) -> tuple[float, float]:
    """Steps of a training on eight views of the street, 480 x 320, near its beginning."""
    from gsrain_engine.scene.progress import run_to_end
    from gsrain_engine.scene.rig import rig_camera
    from gsrain_engine.training.settings import load_settings
    from gsrain_engine.training.train import start_training
    from gsrain_extras.street.ground_truth import capture_street

    scene, times = _street(), [0.4 * number for number in range(8)]
    cameras = [rig_camera(scene, "waymo_front3", "FRONT", time_s).resized(480, 320) for time_s in times]
    started = start_training(capture_street(cameras, times), load_settings(None, steps=2000), [3])
    training = run_to_end(started).training
    for number in range(5):
        training.step(number)
    clock = Clock()
    for number in range(5, 5 + FRAMES):
        training.step(number)
    return clock.seconds(FRAMES)


def transferred(folder: Path, method: str) -> tuple[float, float]:
    """Views of the street, 480 x 320, made rainy."""
    from gsrain_engine.appearance.scene_views import ViewChoice, chosen_cameras, scene_views

    scene = _street()
    views = [*scene_views(scene, chosen_cameras(scene, ViewChoice(count=5, width_px=480)))]
    transfer = _transfer(scene, method)
    next(iter(transfer.transferred(views[:1])))
    clock = Clock()
    made = len([*transfer.transferred(views[1:])])
    return clock.seconds(made)


def _transfer(scene: Any, method: str) -> Any:
    if method == "wet":
        from gsrain_engine.appearance.wet_look.environment import SceneEnvironment
        from gsrain_engine.appearance.wet_look.settings import WetSettings
        from gsrain_engine.appearance.wet_look.translator import WetTransfer

        return WetTransfer(WetSettings(), SceneEnvironment(scene))
    from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny
    from gsrain_engine.appearance.cyclegan_turbo.translator import CycleGanTurboTransfer

    return CycleGanTurboTransfer(build_random_model(tiny()))


def began_drive(folder: Path) -> tuple[float, float]:
    """Make the shipped scenario ready in the street: route, ground, what stands beside the road."""
    from gsrain_engine.simulation.scenario_io import load_scenario
    from gsrain_engine.simulation.simulation import Simulation

    scene = _street()
    clock = Clock()
    Simulation(load_scenario("stationary-lead"), scene).reset()
    return clock.seconds()


def drove(folder: Path, agent: str) -> tuple[float, float]:
    """Steps of a drive in the rain; camera-idm sees with a detector that finds nothing."""
    from gsrain_engine.simulation.simulation import drive

    with _driven(agent) as (simulation, driver):
        steps = drive(simulation, driver)
        for _ in range(3):
            next(steps)
        clock = Clock()
        made = sum(1 for _ in zip(range(FRAMES), steps, strict=False))
        return clock.seconds(made)


def filmed(folder: Path) -> tuple[float, float]:
    """Pictures of a film of a drive."""
    from gsrain_engine.backends import open_renderer
    from gsrain_engine.simulation.playback import RolloutPlayback
    from gsrain_engine.simulation.simulation import run_drive
    from gsrain_engine.simulation.video import RolloutVideo

    with _driven("oracle-idm") as (simulation, driver):
        rollout = run_drive(simulation, driver)
        with open_renderer("cpu") as renderer:
            video = RolloutVideo(RolloutPlayback(rollout, simulation.scene), renderer)
            for number in range(3):
                video.picture(0.1 * number)
            clock = Clock()
            for number in range(FRAMES):
                video.picture(0.1 * number)
            return clock.seconds(FRAMES)


@contextmanager
def _driven(agent: str) -> Generator[tuple[Any, Any]]:
    """A simulation in the street, and who drives in it."""
    from contextlib import ExitStack

    from msgspec import structs

    from gsrain_engine.backends import open_renderer
    from gsrain_engine.simulation.agents.idm import CameraIDMAgent
    from gsrain_engine.simulation.agents.registry import open_agent
    from gsrain_engine.simulation.scenario_io import load_scenario
    from gsrain_engine.simulation.simulation import Simulation

    driver = CameraIDMAgent(_Blind()) if agent == "camera-idm" else open_agent(agent)
    scenario = load_scenario("stationary-lead")
    rain = structs.replace(scenario.rain, intensity_mm_h=8.5)
    with ExitStack() as stack:
        renderer = stack.enter_context(open_renderer("cpu")) if driver.needs.cameras else None
        yield Simulation(structs.replace(scenario, rain=rain), _street(), driver.needs, renderer), driver


class _Blind:
    """A detector that finds nothing, at once: what is left is the drive's own."""

    name = "blind"

    def detect(self, image: Any) -> list[Any]:
        return []


def main() -> None:
    """Do the job that the first argument names, with the folder and what else it takes."""
    job, folder, *more = sys.argv[1:]
    taken = globals()[job](Path(folder), *more)
    print(json.dumps(taken))


if __name__ == "__main__":
    main()
