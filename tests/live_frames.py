"""Frames of an editor, drawn as the window draws them."""


def draw_frame(editor, view, size):
    """Draw a frame, let the editor take what it has found, and return the textures of its panes."""
    result = view.draw(editor.render_input(*size))
    editor.apply(result)
    return result.textures
