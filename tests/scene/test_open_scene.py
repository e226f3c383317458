"""Scene names: the built-in street, or a path."""

import pytest

from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.open import is_built_in_street, load_scene
from small_scene import small_scene


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_street_is_built_in_unless_a_scene_is_called_so(here):
    assert is_built_in_street(None) and is_built_in_street("street") and not is_built_in_street("road")
    write_scene(small_scene("own"), here / "street")
    assert not is_built_in_street("street")
    assert load_scene("street").name == "own"


def test_what_the_command_street_writes_does_not_stand_in_the_way(here):
    write_scene(small_scene("own"), here / "street" / "scene")
    assert is_built_in_street("street")
    assert not is_built_in_street("street/scene")


@pytest.mark.parametrize("file", ["street", "street/meta.json", "street/scene.json"])
def test_a_file_that_may_be_a_scene_is_looked_at(here, file):
    (here / file).parent.mkdir(exist_ok=True)
    (here / file).write_text('{"means": {}}')
    assert not is_built_in_street("street")


def test_a_meta_json_that_is_none_of_sog_does_not_stand_in_the_way(here):
    (here / "street").mkdir()
    (here / "street" / "meta.json").write_text("{}")
    assert is_built_in_street("street")
