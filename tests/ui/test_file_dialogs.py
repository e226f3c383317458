"""File dialogs of the window: its own browser by mouse and keys, and the desktop's."""

import os
from pathlib import Path

import pytest
from imgui_bundle import icons_fontawesome_6
from msgspec.structs import replace

from ui.widgets.file_dialogs import (
    FileKind,
    FileRequest,
    FolderListing,
    ask_what_to_open,
    ask_where_to_save,
    file_kinds,
    size_text,
    starting_folder,
)
from window_driver import imgui

KINDS = "Scenes{.ply,.spz},All files{.*}"


@pytest.fixture
def folder(tmp_path):
    """Files of two types, a hidden one, a folder, and a scene folder."""
    place = tmp_path / "files"
    for name in ("apple.ply", "bread.spz", "notes.txt", ".hidden.ply"):
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).write_bytes(b"x" * 1234)
    (place / "more").mkdir()
    (place / "more" / "cherry.ply").write_text("")
    (place / "street").mkdir()
    (place / "street" / "scene.json").write_text("{}")
    return place


def opened(driver, folder, kinds=KINDS, **more):
    """Open a dialog in a folder; returns the list that gets its answer."""
    answers = []
    ask_what_to_open("Choose", kinds, answers.extend, **more)
    driver.frames(3)
    driver.ctx.item_click("//Choose/##folder")
    driver.ctx.key_chars_replace_enter(str(folder))
    driver.frames(4)
    return answers


def test_file_types_and_names():
    scenes, every = file_kinds(KINDS)
    assert scenes == FileKind("Scenes", (".ply", ".spz")) and every == FileKind("All files", ())
    assert scenes.has("A.PLY") and not scenes.has("a.txt") and every.has("a.txt") and file_kinds("") == ()
    request = FileRequest("Save", (FileKind("MP4", (".mp4",)), FileKind("WebM", (".webm",))), print, is_save=True)
    named = {name: request.completed(Path(name), request.kinds[0]).name for name in ("a", "take.1", "b.webm", "c.MP4")}
    assert named == {"a": "a.mp4", "take.1": "take.1.mp4", "b.webm": "b.webm", "c.MP4": "c.MP4"}
    assert [size_text(n) for n in (0, 999, 1234, 999_999, 5_430_000, 2 << 40)] == [
        "0 B", "999 B", "1.23 kB", "1 MB", "5.43 MB", "2.2 TB",
    ]  # fmt: skip


def test_a_dialog_begins_in_its_last_folder_and_the_first_one_next_to_the_last_scene(folder):
    last, opened = {"": folder / "more", "Save": folder / "street"}, [folder, folder / "more"]
    assert starting_folder("Save", last, opened) == folder / "street"
    assert starting_folder("Open", last, opened) == folder / "more"
    assert starting_folder("Open", {"": folder / "gone"}, opened) == starting_folder("Open", {}, opened) == folder
    assert starting_folder("Open", {}, []) == starting_folder("Open", {}, [folder / "gone"]) == Path.cwd()


def test_a_folder_is_listed_and_what_is_wrong_with_one_is_a_sentence(folder, tmp_path):
    (folder / "nowhere").symlink_to(folder / "missing")
    listing = FolderListing(folder)
    listing.read()
    assert [(each.name, each.is_folder, each.is_scene, each.size) for each in listing.entries] == [
        ("more", True, False, 0), ("street", True, True, 0), (".hidden.ply", False, False, 1234),
        ("apple.ply", False, False, 1234), ("bread.spz", False, False, 1234), ("notes.txt", False, False, 1234),
    ]  # fmt: skip
    missing = FolderListing(tmp_path / "gone")
    missing.read()
    assert missing.is_done and str(tmp_path / "gone") in missing.problem and not missing.entries


def test_files_are_chosen_by_keys_and_mouse(driver, folder):
    # Type-ahead, Enter
    answers = opened(driver, folder)
    driver.ctx.key_chars("br")
    driver.frames(3)
    driver.press(imgui.Key.enter)
    assert answers == [folder / "bread.spz"]
    # Arrows: two folders come first, then the files of the type
    answers = opened(driver, folder)
    for _ in range(3):
        driver.press(imgui.Key.down_arrow)
    driver.press(imgui.Key.enter)
    assert answers == [folder / "apple.ply"]
    # A double click on a row, with its icon
    answers = opened(driver, folder)
    driver.double_click(f"//Choose/**/{icons_fontawesome_6.ICON_FA_FILE} apple.ply##2")
    assert answers == [folder / "apple.ply"]
    # A folder is entered, and the folder above by Alt+Up
    answers = opened(driver, folder)
    driver.ctx.key_chars("more")
    driver.press(imgui.Key.enter)
    driver.frames(4)
    driver.press(imgui.Key.down_arrow)
    driver.press(imgui.Key.enter)
    assert answers == [folder / "more" / "cherry.ply"]
    # A name that is not there is an error, Escape cancels
    answers = opened(driver, folder)
    driver.ctx.key_chars("zebra.ply")
    driver.press(imgui.Key.enter)
    assert driver.is_open("Choose") and not answers
    driver.press(imgui.Key.escape)
    driver.frames(3)
    assert not driver.is_open("Choose") and not answers
    # A scene folder is an answer where scenes are, else a folder
    answers = opened(driver, folder, takes_scenes=True)
    driver.ctx.key_chars("street")
    driver.press(imgui.Key.enter)
    assert answers == [folder / "street"]
    answers = opened(driver, folder / "more", kinds="")
    driver.tap("//Choose/Choose")
    assert answers == [folder / "more"]


def test_a_name_is_proposed_and_a_file_is_replaced_only_on_purpose(driver, folder):
    (folder / "clip.mp4").write_text("mine")

    answers = []
    ask_where_to_save("Save it", "MP4{.mp4}", answers.extend, proposed="clip.mp4")
    driver.frames(3)
    driver.ctx.item_click("//Save it/##folder")
    driver.ctx.key_chars_replace_enter(str(folder))
    driver.frames(4)
    driver.tap("//Save it/Save")
    assert driver.is_open("Save it") and not answers
    driver.ctx.item_click("//Save it/##name")
    driver.ctx.key_chars_replace("other")
    driver.tap("//Save it/Save")
    assert answers == [folder / "other.mp4"]
    answers.clear()
    ask_where_to_save("Save it", "MP4{.mp4}", answers.extend, proposed="clip.mp4")
    driver.frames(4)
    driver.tap("//Save it/Save")
    driver.tap("//Save it/Replace")
    assert answers == [folder / "clip.mp4"]


def test_the_desktops_dialog_is_used_where_it_has_one(driver, folder, tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "zenity"
    program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/arguments\necho {folder}/clip\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")

    driver.editor.preferences.value = replace(driver.editor.preferences.value, desktop_dialogs=True)
    answers = []
    ask_where_to_save("Save it", "MP4{.mp4}", answers.extend, proposed="street.mp4")
    driver.until(lambda: answers)
    assert answers == [folder / "clip.mp4"]
    arguments = (tmp_path / "arguments").read_text()
    assert "--save" in arguments and "street.mp4" in arguments and "*.mp4" in arguments
