"""`gsrain evaluate NAME` of other installed packages: a function with annotated parameters is a command."""

from collections.abc import Callable, Sequence

from cyclopts import App

from gsrain_engine.extensions import EVALUATIONS, Extension, ExtensionError, extensions


def add_installed_evaluations(evaluations: App, ours: frozenset[str], asked: Sequence[str]) -> None:
    """Put the evaluations of other packages beside ours; only the one that `asked` begins with is loaded.

    Where that one can't be used, running it says why.
    """
    for name in set(evaluations) - ours:  # of an earlier run
        del evaluations[name]
    for each in extensions(EVALUATIONS):
        if each.name in ours:
            continue
        if list(asked[:1]) == [each.name]:
            evaluations.command(_function(each), name=each.name)
        else:
            evaluations.command(_listed, name=each.name, help=f"Of the package {each.package} {each.version}.")


def _function(extension: Extension) -> Callable[..., object]:
    try:
        return extension.load_callable()
    except ExtensionError as error:
        problem = error

        def unfit(*_: str) -> None:
            raise problem

        return unfit


def _listed() -> None:
    """Stand in for what is only named in the help."""
