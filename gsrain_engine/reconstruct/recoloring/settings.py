"""What a person can choose about a recolouring."""

from typing import Annotated

from msgspec import Meta, Struct


class RecolorSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How colours are solved for."""

    iterations: Annotated[int, Meta(ge=1, le=200, title="Iterations")] = 12
    """Steps of conjugate gradients in all."""
    rounds: Annotated[int, Meta(ge=1, le=10, title="Rounds")] = 2
    """Times that exposures and trust are worked out anew; the iterations are shared out among them."""
    sh_degree: Annotated[int, Meta(ge=0, le=3, title="Degree of harmonics")] = 3
    """Highest degree that is solved for; a scene's own degree is never exceeded."""
    tikhonov: Annotated[float, Meta(ge=1e-6, le=1e6)] | None = None
    """Pull towards the mapped clear colours: evidence with which a Gaussian goes half the way; none has it chosen by
    views that are left out for a moment."""
    directional: Annotated[float, Meta(ge=0, le=1e3, title="Pull on directions")] = 4.0
    """How much stronger the pull is on each harmonic above degree 0."""
    per_view: Annotated[float, Meta(ge=0, le=10, title="Pull by views")] = 0.1
    """Further pull on harmonics above degree 0, as a share of one view's evidence: that can't tell directions."""
    exposure: bool = True
    """Whether each picture has an exposure and white balance of its own."""
    robust: bool = True
    """Whether pictures and pixels that disagree with the others count less."""
    memory_mb: Annotated[float, Meta(ge=0, title="Memory", extra={"unit": "MB"})] = 4096.0
    """Room for stored weights; views beyond it walk their tiles anew each time. With 0 solving for the street, 24 views
    640 px wide, took seven times as long, all of it 1.2 times the processor's time, and 0.73 of the memory."""

    @property
    def iterations_by_round(self) -> list[int]:
        """Iterations of each round: as even as can be, the last ones longer."""
        rounds = min(self.rounds, self.iterations)
        return [self.iterations * (i + 1) // rounds - self.iterations * i // rounds for i in range(rounds)]
