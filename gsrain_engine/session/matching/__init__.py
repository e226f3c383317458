"""Which pixels of two views show the same place: what the viewport shows of cross-view matching."""
