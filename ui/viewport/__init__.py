"""The viewport: toolbar and overlays."""
