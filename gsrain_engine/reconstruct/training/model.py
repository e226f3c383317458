"""What a training changes: static Gaussians, a sky behind them, and things that move, drawn together."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Shaped

from gsrain_engine.raster.differentiable import Rendered, render_gaussians
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Actor
from gsrain_engine.scene.rotations import quaternions_from_matrices

from ..parameters.splat_parameters import SplatParameters

torch: Any = import_module("torch")

Tensor = Any


class Picture(NamedTuple):
    """A render to learn from."""

    color: Tensor
    """(h, w, 3), the sky behind everything."""
    front: Rendered
    """The static scene, then the actors, without the sky."""
    background_rows: slice
    """Which of the rendered Gaussians are the static scene's."""
    actor_rows: dict[str, slice]
    """Which are each actor's; only those that are there at the time."""
    sky: Rendered | None


@dataclass(frozen=True, slots=True, eq=False)
class SplatModel:
    """All that is trained but the exposures."""

    background: SplatParameters
    sky: SplatParameters | None
    actors: Mapping[str, SplatParameters]
    """By id, in their own frames. Their colours are the same from all sides: frames turn, harmonics need not."""
    tracks: Mapping[str, Actor]
    """The actors as they were at first; their tracks stay."""

    def render(self, camera: Camera, time_s: float, sh_degree: int = 3) -> Picture:
        """Draw everything as a camera sees it at a time, with harmonics up to a degree."""
        pieces = [_Piece.of(self.background, sh_degree)]
        rows, count = dict[str, slice](), len(self.background)
        for key, parameters in self.actors.items():
            pose = self.tracks[key].track.pose(time_s)
            if pose is not None and len(parameters):
                pieces.append(_Piece.of(parameters, sh_degree).moved(pose))
                rows[key] = slice(count, count + len(parameters))
                count += len(parameters)
        front = _drawn(pieces, camera)
        sky = None if self.sky is None else _drawn([_Piece.of(self.sky, sh_degree).standing], camera)
        color = front.color if sky is None else front.color + (1 - front.alpha)[..., None] * sky.color
        return Picture(color, front, slice(0, len(self.background)), rows, sky)

    @property
    def parts(self) -> Iterator[tuple[str, SplatParameters]]:
        """Every set of Gaussians with its name."""
        yield "background", self.background
        if self.sky is not None:
            yield "sky", self.sky
        for key, parameters in self.actors.items():
            yield f"actors/{key}", parameters

    @property
    def count(self) -> int:
        """How many Gaussians there are in all."""
        return sum(len(parameters) for _, parameters in self.parts)

    def zero_grad(self) -> None:
        for _, parameters in self.parts:
            parameters.zero_grad()

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        """Return everything that training goes on from, as arrays by name."""
        return {f"{part}:{name}": array for part, each in self.parts for name, array in each.state().items()}

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Go back to what `state` returned; raises KeyError where something is missing."""
        for part, parameters in self.parts:
            prefix = f"{part}:"
            own = {name.removeprefix(prefix): array for name, array in state.items() if name.startswith(prefix)}
            parameters.restore(own)


class _Piece(NamedTuple):
    """Activated Gaussians on their way into one render."""

    means: Tensor
    scales: Tensor
    quaternions: Tensor
    opacities: Tensor
    sh: Tensor

    @classmethod
    def of(cls, parameters: SplatParameters, sh_degree: int) -> "_Piece":
        tensors = parameters.tensors
        sh = parameters.sh_up_to(sh_degree)
        return cls(tensors["means"], parameters.scales, tensors["quaternions"], parameters.opacities, sh)

    @property
    def standing(self) -> "_Piece":
        """The same, of which only the colours are learned."""
        means, scales, quaternions, opacities, sh = self
        return _Piece(means.detach(), scales.detach(), quaternions.detach(), opacities.detach(), sh)

    def moved(self, pose: Float64[np.ndarray, "4 4"]) -> "_Piece":
        """Turn and shift them from an object's frame to the world; colours stay as they are."""
        matrix = torch.as_tensor(pose, dtype=self.means.dtype, device=self.means.device)
        turn = quaternions_from_matrices(pose[:3, :3]).tolist()
        return self._replace(
            means=self.means @ matrix[:3, :3].T + matrix[:3, 3], quaternions=_turned(turn, self.quaternions)
        )


def _turned(turn: list[float], quaternions: Tensor) -> Tensor:
    w, x, y, z = turn
    rows = [[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]
    return quaternions @ torch.tensor(rows, dtype=quaternions.dtype, device=quaternions.device).T


def _drawn(pieces: list[_Piece], camera: Camera) -> Rendered:
    if len(pieces) > 1:
        most = max(piece.sh.shape[1] for piece in pieces)
        pad = torch.nn.functional.pad
        padded = [piece._replace(sh=pad(piece.sh, (0, 0, 0, most - piece.sh.shape[1]))) for piece in pieces]
        means, scales, quaternions, opacities, sh = (torch.cat(each) for each in zip(*padded, strict=True))
    else:
        means, scales, quaternions, opacities, sh = pieces[0]
    return render_gaussians(means, scales, quaternions, opacities, sh, camera)
