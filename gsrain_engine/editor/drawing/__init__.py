"""Drawing an editor: live view and textures."""
