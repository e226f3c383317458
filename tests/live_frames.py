"""Frames of an editor, drawn as the window draws them."""

import numpy as np

SIZE = (96, 64)


def draw_frame(editor, view, size=SIZE):
    """Draw a frame, let the editor take what it has found, and return the textures of its panes."""
    result = view.draw(editor.render_input(*size))
    editor.apply(result)
    return result.textures


def picture(editor, view):
    """Bytes of a frame in one pane."""
    (texture,) = draw_frame(editor, view)
    return np.frombuffer(texture.read(), np.uint8)


def darkened(scene):
    """The scene with other colors: new arrays for every layer."""
    for each in scene.members:
        sh = (each.gaussians.sh - np.float32(0.5)).astype(np.float32)
        scene = scene.with_member(each.key, gaussians=each.gaussians.with_sh(sh))
    return scene
