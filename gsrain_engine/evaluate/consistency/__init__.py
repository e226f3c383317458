"""Whether views of one place agree with each other, before and after a transfer."""
