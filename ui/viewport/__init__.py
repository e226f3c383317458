"""The viewport: toolbar, overlays."""
