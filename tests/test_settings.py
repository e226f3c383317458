"""The field table: one declaration makes widget, option, settings file, documentation and JSON schema of a setting."""

import importlib.util
import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Annotated, Any, get_args, get_origin

import msgspec
import pytest
import yaml
from cyclopts import App
from msgspec import Meta

from app.main import app, benchmarks, evaluations, installed, run
from app.schema import SETTINGS, Kind, settings_type
from gsrain_engine import plugins
from gsrain_engine.disdrometer.tables import TableColumns
from gsrain_engine.fields import Field, field_of, fields_of, option_names, structs_of
from gsrain_engine.presets import shipped_path
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.settings import Settings
from repository import REPOSITORY
from ui.commands.table import SHELL_COMMANDS
from ui.panels.rain import GROUPS

NEW_LINE = (
    '    splash_gain: Annotated[float, Meta(ge=0, le=9, title="Splash gain", description="Light of splashes.", '
    'extra={"group": "Appearance", "commands": "render"})] = 1.5\n'
)

WITH_CHANGED_FILE = """
import contextlib, importlib.util, io, pathlib, sys
import gsrain_engine.rain

def module_of(name, file):
    spec = importlib.util.spec_from_file_location(name, file)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

changed, repository = map(pathlib.Path, sys.argv[1:])
gsrain_engine.rain.settings = module_of("gsrain_engine.rain.settings", changed)
site_pages = module_of("site_pages", repository / "docs" / "site_pages.py")
from app.main import run
from app.render import RainOptions
from window_driver import Driver

def printed(*arguments):
    with contextlib.redirect_stdout(io.StringIO()) as text:
        run([*arguments])
    return text.getvalue()

assert "Light of splashes. Range 0..9." in printed("render", "--help"), "help"
assert RainOptions(splash_gain=2.0).settings().splash_gain == 2.0, "option"
assert '"splash_gain"' in printed("schema", "rain"), "schema"
(changed.parent / "mine.yaml").write_text("splash_gain: 4")
assert gsrain_engine.rain.settings.load_preset(changed.parent / "mine.yaml").splash_gain == 4, "YAML"
row = "| `splash_gain` | Splash gain: Light of splashes. | 0..9 | 1.5 | `--splash-gain` of render |"
assert row in site_pages.settings_page() and "--splash-gain" in site_pages.commands_page(), "docs"
driver = Driver(changed.parent)

def script():
    driver.click("//Rain/Appearance")
    assert driver.ctx.item_exists("//Rain/##splash_gain"), "panel"
    print("found in all")

driver.run(script)
"""


def test_a_new_setting_is_one_line(tmp_path):
    """With one more line in the file of `RainSettings`, panel, --help, YAML, schema and documentation have it."""
    text = (REPOSITORY / "gsrain_engine" / "rain" / "settings.py").read_text("utf-8")
    changed = tmp_path / "settings.py"
    changed.write_text(text.replace("    # fmt: on\n", NEW_LINE + "    # fmt: on\n", 1), "utf-8")
    done = subprocess.run(
        [sys.executable, "-c", WITH_CHANGED_FILE, str(changed), str(REPOSITORY)],
        check=False, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(REPOSITORY)]), "COLUMNS": "200"},
    )  # fmt: skip
    assert "found in all" in done.stdout, done.stderr[-3000:]


OF_ANOTHER_KIND = {
    ("evaluate lidar", "--sensor"),  # a lidar, not a camera's sensor
    *(
        (command, option) for command in ("publish", "export-rain", "dataset") for option in ("--output", "-o")
    ),  # no picture
}
"""Options of commands that are named like a field."""


def commands():
    for name in SHELL_COMMANDS:
        yield name, app[name]
    with installed(evaluations, plugins.EVALUATIONS):
        for group, apps in (("bench", benchmarks), ("evaluate", evaluations)):
            yield from ((f"{group} {name}", apps[name]) for name in apps if not name.startswith("-"))


@pytest.mark.parametrize(("name", "command"), list(commands()), ids=lambda each: each if isinstance(each, str) else "")
def test_options_of_settings_are_made_from_their_fields(name: str, command: App):
    kinds = vars(inspect.getmodule(command.default_command)).values()
    structs = [each for each in kinds if isinstance(each, type) and issubclass(each, msgspec.Struct)]
    fields = [field for each in structs for field in fields_of(each) if field.title != field.name]
    for argument in command.assemble_argument_collection():
        for option in argument.names:
            if (name, option) in OF_ANOTHER_KIND:
                continue
            made = [each.described for each in fields if option in (*each.options, f"--{each.name.replace('_', '-')}")]
            is_made = any(argument.parameter.help.startswith(text) for text in made)
            assert is_made or not made, f"{option} of gsrain {name} is a settings field"


def test_fields_name_existing_commands():
    known = {name for name, _ in commands()}
    for kind in SETTINGS:
        for struct in structs_of(settings_type(kind)):
            for each in fields_of(struct):
                assert set(each.commands) <= known, each
                assert not each.group or each.group in GROUPS
    assert option_names(RainSettings)["intensity_mm_h"] == "--rain"


# The table itself


@pytest.mark.parametrize(
    ("name", "range", "default", "options"),
    [
        ("intensity_mm_h", "0..149 mm/h", "0", ("--rain", "--intensity")),
        ("exposure_s", "0.00001..1 s", "", ("--exposure",)),
        ("seed", "", "0", ("--seed",)),
        ("wind_m_s", "-40..40 m/s", "", ("--wind",)),
        ("wind_speed_m_s", "0..60 m/s", "2", ("--wind-speed",)),
        ("wind_from_deg", "0..360 deg", "240", ("--wind-from",)),
        ("turbulence_m_s", "0..5 m/s", "0.6", ("--turbulence",)),
        ("closure", "", "density", ("--drop-density",)),
        ("haze_count", "0..200000", "", ("--haze-count",)),
    ],
)
def test_fields_have_bounds_default_and_option(name, range, default, options):
    field = field_of(RainSettings, name)
    assert (field.range, field.default_text, field.options) == (range, default, options)


def subclasses(kind: type) -> Iterator[type]:
    for each in kind.__subclasses__():
        yield each
        yield from subclasses(each)


def outside(field: Field) -> float | int | tuple[float, ...]:
    """The first number beyond a bound."""
    end = 0 if field.bounds[0] is not None else 1
    step = 0 if field.is_open[end] else 1 - 2 * (end == 0)
    value = field.bounds[end] + step
    count = len(get_args(field.kind))
    return (value,) * count if get_origin(field.kind) is tuple else value


def test_constructors_check_all_bounds():
    """Also those of numbers that may be None, and in tuples, with field, range and value; `replace` does it, too."""
    checked = 0
    for kind in subclasses(Settings):
        for field in fields_of(kind):
            if field.bounds != (None, None):
                with pytest.raises(ValueError, match=f"^{field.name} must be .*, got "):
                    kind(**required_of(kind) | {field.name: outside(field)})
                checked += 1
    assert checked > 200
    with pytest.raises(ValueError, match=r"^intensity_mm_h must be within 0\.\.149 mm/h, got 150$"):
        msgspec.structs.replace(RainSettings(), intensity_mm_h=150)


def required_of(kind: type[Settings]) -> dict[str, Any]:
    """Values without bounds are enough: bounds are checked first."""
    return {each.name: None for each in fields_of(kind) if each.default is msgspec.NODEFAULT}


@pytest.mark.parametrize(
    ("annotation", "words", "allowed", "refused"),
    [
        (Annotated[float, Meta(gt=0)], "above 0", 1e-300, 0.0),
        (Annotated[int, Meta(ge=1)] | None, "at least 1", None, 0),
        (Annotated[float, Meta(lt=2)], "below 2", 1.99, 2.0),
        (Annotated[float, Meta(le=2)], "at most 2", 2, 2.1),
        (Annotated[float, Meta(gt=0, le=2)], "above 0..2", 2, 0.0),
        (tuple[Annotated[float, Meta(ge=0, le=2)], ...], "within 0..2", (), (1.0, 3.0)),
    ],
)
def test_bounds_may_be_open_or_one_sided(annotation, words, allowed, refused):
    kind = msgspec.defstruct("Bounded", [("value", annotation)], bases=(Settings,), frozen=True, kw_only=True)
    assert kind(value=allowed).value == allowed
    with pytest.raises(ValueError, match=f"^value must be {re.escape(f'{words}, got {refused}')}$"):
        kind(value=refused)
    assert msgspec.convert({"value": allowed}, kind) == kind(value=allowed)


@pytest.mark.parametrize("kind", SETTINGS)
def test_shipped_files_fit_their_schema(kind, capsys):
    assert set(SETTINGS) == {each.name for each in shipped_path("sample_configs").iterdir()} <= set(get_args(Kind))
    assert run(["schema", kind]) == 0
    schema = json.loads(capsys.readouterr().out)
    objects = [schema["$defs"][each["$ref"].rpartition("/")[2]] for each in schema.get("anyOf", [schema])]
    for file in (shipped_path("sample_configs") / kind).iterdir():
        names = set(yaml.safe_load(file.read_bytes()) or {})
        assert any(set(each["required"]) <= names <= set(each["properties"]) for each in objects), file


def test_schemas_have_units_bounds_and_help(tmp_path):
    assert run(["schema", "rain", "-o", str(tmp_path / "rain.json")]) == 0
    struct = json.loads((tmp_path / "rain.json").read_text())["$defs"]["RainSettings"]
    fields = struct["properties"]
    assert fields["exposure_s"]["x-unit"] == "s" and fields["exposure_s"]["anyOf"][0]["minimum"] == 1e-5
    assert (fields["gust_m_s"]["maximum"], fields["gust_m_s"]["title"]) == (20, "Gusts")
    assert struct["additionalProperties"] is False


def test_every_field_is_documented():
    spec = importlib.util.spec_from_file_location("site_pages", REPOSITORY / "docs" / "site_pages.py")
    site_pages = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(site_pages)
    page = site_pages.settings_page()
    for kind in SETTINGS:
        for struct in structs_of(settings_type(kind)):
            assert all(f"| `{each.name}` |" in page for each in fields_of(struct))
    formats = (REPOSITORY / "docs" / "formats.md").read_text("utf-8")
    assert [each.name for each in fields_of(TableColumns) if f"`{each.name}`" not in formats] == []
