"""Registry of feature extractors by their `--extractor` names."""

from collections.abc import Callable

from .fid_features import FEATURES, SIZE_PX, Extractor, ExtractorChoice, cell_statistics


def open_extractor(choice: ExtractorChoice) -> Extractor:
    """Open an extractor.

    Raises ValueError for an unknown name or unsuitable weights, FileNotFoundError with download instructions if weights
    are missing, and ModuleNotFoundError if it needs torch and torch is missing.
    """
    if choice.name not in EXTRACTORS:
        raise ValueError(f"extractor {choice.name!r}: expected one of {', '.join(EXTRACTORS)}")
    return EXTRACTORS[choice.name](choice)


def _pixels(choice: ExtractorChoice) -> Extractor:
    if choice.weights is not None:
        raise ValueError(f"{choice.weights}: the extractor pixels16 takes no weights")
    described = f"colour and edges of 4x4 cells, {SIZE_PX}x{SIZE_PX} px"
    return Extractor(metric="FD-pixels16", described=described, features=FEATURES, key=None, function=cell_statistics)


def _inception(choice: ExtractorChoice) -> Extractor:
    from .fid_torch_features import open_inception  # torch is an extra

    return open_inception(choice)


EXTRACTORS: dict[str, Callable[[ExtractorChoice], Extractor]] = {"inception": _inception, "pixels16": _pixels}
