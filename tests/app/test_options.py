"""Options: those that scripts and papers rely on, values that none takes, and errors in their names."""

import math
import re
from dataclasses import dataclass

import pytest
from cyclopts import CycloptsError

from app.main import app, run, spelled_out
from app.options import reject_non_finite, takes_set
from app.render import RainOptions
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.safe_io.errors import convert_checked

OPTIONS = {
    "render": "--rain --intensity --preset --camera --camera-path --size --fps --duration --time --seed --exposure "
    "--drop-density --clear-pair --mode --backend --depth --no-haze --no-streaks --output -o --json",
    "info": "--json",
    "convert": "--json",
    "street": "--json",
    "calibrate": "--output -o --plot --json",
    "disdrometer": "--rain --json",
    "reconstruct": "--output -o --images --json",
    "transfer": "--output -o --method --weights --no-normals --no-cross-view-attention --no-mutual-attention --json",
    "recolor": "--images --output -o --refine --json",
    "train-transfer": "--output -o --clear --rainy",
    "evaluate fid": "--weights --json",
    "evaluate consistency": "--json",
    "evaluate detection": "--detector --rain --seeds --json",
    "drive": "--agent --rain --hugsim-dir --json",
    "sweep": "--output -o --shard --dask --json",
    "bench": "--json",
    "bench render": "--json",
    "bench loading": "--json",
    "bench recoloring": "--json",
    "doctor": "--json",
    "schema": "--output -o",
}


@pytest.mark.parametrize("command", OPTIONS)
def test_a_command_has_the_options_that_are_relied_on(command, capsys):
    assert run([*command.split(), "--help-all"]) == 0
    listed = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", capsys.readouterr().out))
    assert set(OPTIONS[command].split()) - listed == set()


@pytest.mark.parametrize("words", ["--drop-density even", "--drop-density density", "--closure flux"])
def test_the_drop_density_has_one_name_and_the_words_of_its_help(words):
    for word in ("rate", "flux"):
        _, bound, _ = app.parse_args(["disdrometer", "--drop-density", word], exit_on_error=False)
        assert bound.arguments["rain"].changes() == {"closure": "density"}
    with pytest.raises(CycloptsError, match="flux|--closure"):
        app.parse_args(["disdrometer", *words.split()], exit_on_error=False, print_error=False)


@pytest.mark.parametrize(
    ("line", "changes"),
    [
        ("calibrate a.nc -o a.yaml --intensities 1,2.5", {"fit": {"intensities_mm_h": [1.0, 2.5]}}),
        ("reconstruct a -o b --held-out 4", {"options": {"held_out": 4, "held_out_views": ()}}),
        ("reconstruct a -o b --held-out x,y", {"options": {"held_out_views": ["x", "y"]}}),
        ("recolor a --images b -o c --refine", {"run": {"refine": 300}}),
        ("recolor a --images b -o c --no-refine --no-robust", {"run": {}, "solver": {"robust": False}}),
        ("render -o a.png --size 96x64", {"recording": {"output": "a.png", "size_px": (96, 64)}}),
        ("train-transfer tiny -o a --clear b --clear c", {"images": {"clear": [{"path": "b"}, {"path": "c"}]}}),
        ("evaluate lidar -o a --range-10 50", {"limits": {"range_m": 50.0}}),
        ("render -o a.png --clear-pair overcast", {"recording": {"output": "a.png", "twin": "overcast"}}),
        ("render -o a.png --haze gaussians", {"rain": {"haze": "gaussians"}}),
        ("render -o a.png --haze=none", {"rain": {"haze": "none"}}),
        ("render -o a.png --no-haze --no-streaks", {"rain": {"haze": "none", "streaks": False}}),
    ],
)
def test_options_set_fields(line, changes):
    _, bound, _ = app.parse_args(spelled_out(line.split()), exit_on_error=False, print_error=False)
    assert {name: bound.arguments[name].changes() for name in changes} == changes


@dataclass
class Grouped:
    first_s: float
    bounds: tuple[float, float] = (0.0, 1.0)


def test_no_option_takes_nan_however_deep_it_stands():
    for value in (1.0, (1.0, 2.0), [1.0], Grouped(1.0), "nan", None):
        reject_non_finite(None, value)
    for value, words in (
        (math.nan, "finite"), ((1.0, math.inf), "finite"), ([-math.inf], "finite"),
        (Grouped(math.nan), "--first-s"), (Grouped(0.0, (0.0, math.nan)), "--bounds"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            reject_non_finite(None, value)


@pytest.mark.parametrize(
    ("words", "attribute"),
    [
        ("--attribute all", ["all"]),
        ("--attribute streaks,glass", ["streaks", "glass"]),
        ("--attribute=wet", ["wet"]),
    ],
)
def test_attribute_takes_factors(words, attribute):
    _, bound, _ = app.parse_args(["sweep", "tiny", *words.split()], exit_on_error=False)
    assert bound.arguments["options"].changes()["attribute"] == attribute
    line = ["evaluate", "detection", "--detector", "a.onnx", *words.split(), "street"]
    _, bound, _ = app.parse_args(line, exit_on_error=False)
    assert bound.arguments["conditions"].changes()["attribute"] == attribute and bound.arguments["source"] == "street"


@pytest.mark.parametrize(("line", "wet"), [("", None), ("--wet", True), ("--no-wet", False)])
@pytest.mark.parametrize("command", ["render", "drive", "evaluate detection --detector a.onnx"])
def test_wet_has_three_states(command, line, wet):
    words = f"{command} {line} -o a.png".split()
    _, bound, _ = app.parse_args(words, exit_on_error=False, print_error=False)
    assert bound.arguments.get("wet") is wet


# --set


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("rougness_m=1", "--set rougness_m: no such setting; did you mean roughness_m?"),
        ("rain=3", "--set rain: no such setting; did you mean intensity_mm_h?"),
        ("roughness_m", "--set roughness_m: expected NAME=VALUE"),
        ("roughness_m=9", "--set roughness_m: 9 must be at most 2 m"),
        ("roughness_m=rough", "--set roughness_m: Expected a number"),
        ("velocity=fast", "--set velocity: "),
        ("seed=3 --seed 4", "--set seed: --seed sets it, too"),
        ("seed=3 --set seed=4", "--set seed: --set sets it, too"),
        ("glass=lens", "--glass: a disdrometer counts drops"),
    ],
)
def test_set_refuses_what_it_can_not_set(words, problem, capsys):
    assert run(["disdrometer", "--set", *words.split()]) == 2
    assert problem in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("drive --set intensity_mm_h=3", "--set intensity_mm_h: --rain sets it here"),
        ("drive --set controller=3", "--set controller: Expected an object"),
        ("train-transfer tiny -o a --set seed=3", "--set seed: it is options.seed or images.seed"),
        ("evaluate lidar -o a --set glass=lens", "--glass: a lidar has none of it"),
        ("recolor street --images a -o b --set colors={}", "--set colors: "),
    ],
)
def test_set_names_the_option_or_the_settings_that_are_meant(line, problem, capsys):
    assert run(line.split()) == 2
    assert problem in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("assigned", "changes"),
    [
        ("roughness_m=0.03", {"roughness_m": 0.03}),
        ("roughness_m=3e-2", {"roughness_m": 0.03}),
        ("wind_m_s=3,-4", {"wind_m_s": [3, -4]}),
        ("haze_region={minimum_m: [0, 0, 0], maximum_m: [1, 1, 1]}",
         {"haze_region": {"minimum_m": [0, 0, 0], "maximum_m": [1, 1, 1]}}),
        ("haze_count=none", {"haze_count": None}),
        ("wiper=off", {"wiper": "off"}),
        ("calibration=1.2", {"calibration": "1.2"}),
        ("closure=published", {"closure": "published"}),
    ],
)  # fmt: skip
def test_set_takes_the_values_of_settings_files(assigned, changes):
    passed = {}

    @takes_set
    def command(*, rain: RainOptions | None = None) -> None:
        passed["rain"] = rain

    command(set=[assigned])
    own = RainSettings(haze_count=5)
    assert passed["rain"].settings(own) == convert_checked({"haze_count": 5} | changes, RainSettings) != own


def test_a_field_is_set_like_its_option(reported):
    """After a preset, with the same numbers as by the option."""
    words = ["disdrometer", "--preset", "12.0", "--seconds", "2"]
    assert reported(*words, "--set", "diameter_scale=2") == reported(*words, "--diameter-scale", "2")
    assert reported(*words, "--set", "velocity=atlas") != reported(*words)
