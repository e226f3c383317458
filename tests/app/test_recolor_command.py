import json
from pathlib import Path

import numpy as np
import pytest

from app.main import run
from colmap_files import cut_rows
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from tests.recolor.changed_street import street_and_pictures


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene folder, a capture of it in another look, and the same pictures without cameras."""
    folder = tmp_path_factory.mktemp("recolor")
    clear, _, targets = street_and_pictures()
    write_scene(clear, folder / "clear")
    views = [
        CaptureFrame(f"v{i}", each.camera, np.rint(each.image * 255).astype(np.uint8), each.time_s)
        for i, each in enumerate(targets)
    ]
    list(write_views(folder / "capture", views))
    (folder / "images").mkdir()
    for view in views[:5]:
        (folder / "images" / f"{view.name}.png").write_bytes((folder / "capture" / f"{view.name}.png").read_bytes())
    return folder


def test_a_scene_takes_on_the_look_of_a_capture(files, tmp_path, capsys):
    wet, numbers, report = tmp_path / "wet", tmp_path / "numbers.json", tmp_path / "report.html"
    command = ["recolor", str(files / "clear"), "--images", str(files / "capture"), "-o", str(wet), "--held-out", "5"]
    assert run([*command, "--json", str(numbers), "--report", str(report)]) == 0
    told = json.loads(numbers.read_text())
    assert {"seconds", "gaussians", "psnr_before_db", "psnr_held_out_db", "views"} <= set(told)
    assert (told["views"], told["views_held_out"]) == (5, 1)
    assert told["psnr_held_out_db"] > told["psnr_before_db"] + 3
    clear, scene = read_scene(files / "clear"), read_scene(wet)
    street = scene.member("layers/street")
    np.testing.assert_array_equal(street.gaussians.sh, clear.member("layers/street").gaussians.sh)
    assert street.wet_sh is not None
    assert np.abs(street.wet_sh - street.gaussians.sh).mean() > 0.05
    assert "<svg" in report.read_text(encoding="utf-8")
    assert "Held-out views:" in capsys.readouterr().out


def test_pictures_without_cameras_are_matched_by_name_and_can_replace_the_clear_colors(files, tmp_path, capsys):
    new = tmp_path / "new"
    command = ["recolor", str(files / "clear"), "--images", str(files / "images"), "--capture", str(files / "capture")]
    assert run([*command, "-o", str(new), "--replace", "--held-out", "0", "--iterations", "4"]) == 0
    assert "'v5' for one" in capsys.readouterr().out
    assert "<svg" in (tmp_path / "new.report.html").read_text(encoding="utf-8")
    clear, scene = read_scene(files / "clear"), read_scene(new)
    assert scene.member("layers/street").wet_sh is None
    assert np.abs(scene.member("layers/street").gaussians.sh - clear.member("layers/street").gaussians.sh).max() > 0.1


def test_pictures_of_different_sizes_go_all_the_way(files, tmp_path):
    """Transfer, recoloring and evaluation of what undistortion by one camera a picture makes of a capture."""
    views = cut_rows(open_capture(files / "capture"))
    list(write_views(tmp_path / "photos", views))
    rainy, photos = str(tmp_path / "rainy"), str(tmp_path / "photos")
    assert run(["transfer", photos, "-o", rainy, "--sheet", str(tmp_path / "sheet.png")]) == 0
    assert [view.camera.height for view in open_capture(rainy)] == [view.camera.height for view in views]
    wet, numbers = tmp_path / "wet", tmp_path / "numbers.json"
    assert run(["recolor", str(files / "clear"), "--images", rainy, "-o", str(wet), "--iterations", "2",
                "--held-out", "5", "--json", str(numbers)]) == 0  # fmt: skip
    assert json.loads(numbers.read_text())["views"] == len(views) - 1
    assert run(["evaluate", "images", rainy, photos, "--report", str(tmp_path / "images.html")]) == 0
    assert run(["evaluate", "fid", photos, rainy, "--extractor", "pixels16", "--resamples", "20"]) == 0
    assert run(["info", photos, "--overlay", str(tmp_path / "overlay.png")]) == 0


def test_colors_can_be_polished_and_everything_refined(files, tmp_path):
    pytest.importorskip("torch")
    from gsrain_engine.datasets.open_capture import open_capture
    from gsrain_engine.recolor.problem import RecolorSettings
    from gsrain_engine.recolor.recolor import RecolorOptions, recolor_to_capture

    scene, capture = read_scene(files / "clear"), open_capture(files / "capture")
    solver = RecolorSettings(iterations=4)

    def result(options):
        work = recolor_to_capture(scene, capture, options)
        fractions = []
        while True:
            try:
                fractions.append(next(work).fraction)
            except StopIteration as end:
                assert fractions == sorted(fractions)
                return end.value

    plain = result(RecolorOptions(held_out=5, colors=solver))
    polished = result(RecolorOptions(held_out=5, colors=solver, polish=15))
    assert polished.numbers["psnr_db"] != plain.numbers["psnr_db"]
    assert polished.numbers["psnr_held_out_db"] > plain.numbers["psnr_held_out_db"] - 0.5
    refined = result(RecolorOptions(held_out=5, colors=solver, refine=3)).scene.member("layers/street")
    before = scene.member("layers/street")
    moved = np.abs(refined.gaussians.means - before.gaussians.means).max()
    assert 0 < moved < 0.05
    np.testing.assert_array_equal(refined.gaussians.sh, before.gaussians.sh)
    assert refined.wet_sh is not None
