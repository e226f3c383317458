"""The build of gsplat's kernels: announced before it begins, with progress, and with the reason if it fails."""

import threading

import pytest

pytest.importorskip("torch")

from gsrain_engine.render.gsplat_build import ANNOUNCEMENT, GsplatBuildError, build_gsplat, gsplat_is_built


def test_a_build_is_announced_before_it_begins_and_reports_its_progress() -> None:
    may_end, calls = threading.Event(), []

    def load() -> object:
        calls.append(1)
        assert may_end.wait(60)
        return object()

    build = build_gsplat(load, lambda: False, 0.001)
    first = next(build)
    assert (first.message, calls) == (ANNOUNCEMENT, []) and "75 s, once" in first.message
    second, third = next(build), next(build)
    assert "so far" in second.message and third.fraction >= second.fraction >= first.fraction
    may_end.set()
    *_, last = build
    assert last.fraction == 1 and last.message.startswith("gsplat compiled its kernels in ") and calls == [1]


def test_kernels_that_are_there_are_loaded_without_a_word() -> None:
    calls = []
    assert list(build_gsplat(lambda: calls.append(1) or object(), lambda: True)) == [] and calls == [1]


def failing() -> None:
    raise RuntimeError("ninja: not found")


@pytest.mark.parametrize(("load", "reason"), [(failing, "ninja: not found"), (lambda: None, "nvcc")])
@pytest.mark.parametrize("is_built", [False, True])
def test_a_failed_build_quotes_its_reason(load, reason: str, is_built: bool) -> None:
    with pytest.raises(GsplatBuildError, match=reason):
        list(build_gsplat(load, lambda: is_built, 0.001))


def test_kernels_of_an_earlier_build_are_found(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCH_EXTENSIONS_DIR", str(tmp_path))
    monkeypatch.setattr("gsrain_engine.render.gsplat_build.find_spec", lambda name: None)
    assert not gsplat_is_built()
    (folder,) = tmp_path.rglob("gsplat_cuda")
    (folder / "gsplat_cuda.so").touch()
    assert gsplat_is_built()
