from pathlib import Path

from gsrain_engine.appearance.cyclegan_turbo.model import CycleGanTurbo
from gsrain_engine.appearance.cyclegan_turbo.weights import apply_adapter_weights, open_weights


def load_weights(model: CycleGanTurbo, path: Path, weather: str = "rainy") -> None:
    """Put the weights of a file into a model: merged, or into its peft adapters where it has them."""
    apply_adapter_weights(model, open_weights(path).delta(model, weather))
