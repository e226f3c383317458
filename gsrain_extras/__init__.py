"""Additions by the extension points that any package has: docs/extending.md. A folder can be deleted."""
