"""Drawing an editor: live view, textures, uploads."""
