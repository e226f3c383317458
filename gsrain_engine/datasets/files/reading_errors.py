"""What goes wrong with tables of data sets that are not as their data set has them, put into words."""

WRONG_VALUES = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)
"""What values of other kinds than expected raise, `CaptureError` among them."""


def what_is_wrong(error: Exception) -> str:
    """Say what a field was wrong about."""
    if isinstance(error, KeyError):
        return f"has no field {error.args[0]!r}"
    return str(error) or type(error).__name__
