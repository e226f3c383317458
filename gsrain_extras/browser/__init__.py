"""The window in browsers, as a protocol of `gsrain serve`."""
