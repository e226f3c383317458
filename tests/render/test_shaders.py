import pytest

from gsrain_engine.render.opengl import shaders
from gsrain_engine.render.opengl.shaders import ShaderError, load_compute_shader, load_program


def test_error_names_our_file_and_line(context, monkeypatch):
    files = {
        "broken.comp": ["#version 430", '#include "common_bad.glsl"', "layout(local_size_x = 1) in;", "void main() {}"],
        "common_bad.glsl": ["// fine", "float f() { return undeclared; }"],
    }
    monkeypatch.setattr(shaders, "read_shader", files.__getitem__)
    with pytest.raises(ShaderError, match=r"common_bad.glsl:2"):
        load_compute_shader(context, "broken.comp")


def test_switches_reach_the_shader(context):
    plain = load_program(context, "screen.vert", "heat.frag")
    depth = load_program(context, "screen.vert", "heat.frag", switches={"DEPTH": 1})
    assert plain.glo != depth.glo
