"""A scene and its rain as one web page."""
