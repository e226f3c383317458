"""The options that scripts and papers rely on: each command says of each of them what it does."""

import re

import pytest
from cyclopts import CycloptsError

from app.main import BAD_INPUT, OLD_OPTIONS, _renamed, app, run

OPTIONS = {
    "render": "--rain --intensity --preset --camera --camera-path --size --fps --duration --time --seed --exposure "
    "--drop-density --clear-pair --mode --backend --depth --no-haze --no-streaks --output -o --json",
    "info": "--json",
    "convert": "--json",
    "street": "--json",
    "calibrate": "--output -o --plot --json",
    "disdrometer": "--rain --json",
    "reconstruct": "--output -o --images --json",
    "transfer": "--output -o --method --weights --no-normals --no-cross-view-attention --json",
    "recolor": "--images --output -o --refine --json",
    "train-transfer": "--output -o",
    "evaluate fid": "--weights --json",
    "evaluate consistency": "--json",
    "evaluate detection": "--detector --rain --seeds --json",
    "drive": "--agent --rain --hugsim-dir --json",
    "sweep": "--shard --dask --json",
    "bench": "--json",
    "bench render": "--json",
    "bench loading": "--json",
    "bench recoloring": "--json",
    "doctor": "--json",
}


@pytest.mark.parametrize("command", OPTIONS)
def test_a_command_has_the_options_that_are_relied_on(command, capsys):
    assert run([*command.split(), "--help"]) == 0
    said = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", capsys.readouterr().out))
    assert set(OPTIONS[command].split()) - said == set()


@pytest.mark.parametrize("command", OLD_OPTIONS)
def test_options_of_version_0_1_are_read_and_not_listed(command, capsys):
    assert run([*command.split(), "--help"]) == 0
    listed = set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out))
    for pair in OLD_OPTIONS[command].split():
        old, new = pair.split("=")
        assert f"--{new}" in listed and f"--{old}" not in listed
        for words in ([f"--{old}=x"], [f"--no-{old}"], [f"--{old}", "x"]):
            assert list(_renamed([*command.split(), *words]))[-len(words) :] == [words[0].replace(old, new), *words[1:]]
    assert list(_renamed(["info", "--", "--twin"])) == ["info", "--", "--twin"]
    assert list(_renamed(["info", "--twin"])) == ["info", "--twin"]


@pytest.mark.parametrize("words", ["--drop-density flux", "--drop-density density", "--closure density"])
def test_values_of_the_drop_density_have_old_names_too(words):
    _, bound, _ = app.parse_args(list(_renamed(["disdrometer", *words.split()])), exit_on_error=False)
    assert bound.arguments["rain"].changes() == {"closure": "density"}
    with pytest.raises(CycloptsError, match="flux"):
        app.parse_args(["disdrometer", "--drop-density", "even"], exit_on_error=False, print_error=False)


def test_the_rain_rate_has_two_names(capsys):
    for name in ("--rain", "--intensity"):
        assert run(["disdrometer", name, "-1"]) == BAD_INPUT
        assert capsys.readouterr().err.startswith("gsrain: --rain: Expected `float` >= 0.0")
