"""An editor of the small scene, whose time stands still."""

from contextlib import closing

import pytest

from gsrain_engine.editor.editor import Editor
from small_scene import small_scene


@pytest.fixture
def editor():
    with closing(Editor(small_scene())) as opened:
        opened.playback.clock.playing = False
        yield opened
