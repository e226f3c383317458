"""A part of a picture that goes through the network at once."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of a picture, in its pixels; the whole picture where it is not cut into tiles."""

    top: int
    left: int
    height: int
    width: int
    frame: tuple[int, int]
    """Height and width of the whole picture."""

    @classmethod
    def whole(cls, height: int, width: int) -> "Window":
        return cls(0, 0, height, width, (height, width))

    @property
    def is_whole(self) -> bool:
        return (self.height, self.width) == self.frame

    def in_tokens(self, height: int, width: int) -> "Window":
        """The same in a map whose part for this window has `height` x `width` tokens.

        Raises ValueError where the window does not begin at a token or the tokens don't cover the picture evenly.
        """
        if self.is_whole:
            return Window.whole(height, width)
        scaled = [
            value * tokens / pixels
            for value, tokens, pixels in (
                (self.top, height, self.height),
                (self.left, width, self.width),
                (self.frame[0], height, self.height),
                (self.frame[1], width, self.width),
            )
        ]
        if any(value != int(value) for value in scaled):
            raise ValueError(f"{self} does not fall on whole tokens of a map of {height} x {width}")
        top, left, frame_height, frame_width = (int(value) for value in scaled)
        return Window(top, left, height, width, (frame_height, frame_width))
