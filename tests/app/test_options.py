"""The options that scripts and papers rely on: each command says of each of them what it does."""

import re

import pytest

from app.main import run

OPTIONS = {
    "render": "--rain --preset --camera --camera-path --size --fps --duration --time --seed --exposure --closure "
    "--backend --depth --no-haze --no-streaks --output -o --json",
    "info": "--json",
    "convert": "--json",
    "street": "--json",
    "calibrate": "--output -o --plot --json",
    "disdrometer": "--rain --json",
    "reconstruct": "--output -o --images --json",
    "transfer": "--output -o --method --weights --no-normals --no-mutual-attention --json",
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
