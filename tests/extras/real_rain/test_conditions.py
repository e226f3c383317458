"""Shipped conditions of recorded rain fit their schema."""

import json

import yaml

from app.main import run
from gsrain_extras.real_rain.comparison import load_conditions
from repository import REPOSITORY

CONDITIONS = sorted((REPOSITORY / "gsrain_extras" / "real_rain" / "conditions").iterdir())


def test_shipped_conditions_fit_their_schema(capsys):
    assert run(["schema", "real_rain"]) == 0
    schema = json.loads(capsys.readouterr().out)
    fields = {name: set(each["properties"]) for name, each in schema["$defs"].items()}
    assert [each.stem for each in CONDITIONS] == ["rainsense", "rainsense_pairs"]
    for file in CONDITIONS:
        rows = yaml.safe_load(file.read_bytes())["sequences"]
        assert {name for row in rows for name in row} <= fields["SequenceConditions"]
        assert len(load_conditions(file.stem).sequences) == len(rows) > 0
