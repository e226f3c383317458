"""Python that files name: what counts as its content, who has allowed it, and that only this very content runs."""

import hashlib
import json
import py_compile
import stat
import sys

import pytest

from gsrain_engine import trusted_code
from gsrain_engine.appearance.dsine_checkout import dsine_module
from gsrain_engine.appearance.finetune.settings import code_of, load_finetuning
from gsrain_engine.evaluation.compare_results import load_comparison
from gsrain_engine.safe_io.limits import TooLargeError
from gsrain_engine.trusted_code import (
    UntrustedCodeError,
    answers_file,
    check_named,
    check_trusted,
    check_unchanged,
    expect_trusted,
    importable,
    is_trusted,
    read_code,
    run_main,
    trust,
    trust_permanently,
)


@pytest.fixture
def another_process(monkeypatch):
    """Forgets what this process has been allowed, and leaves what is written down."""

    def begin():
        for name in ("TRUSTED", "_named_by_files"):
            monkeypatch.setattr(trusted_code, name, set())

    return begin


@pytest.fixture(autouse=True)
def nothing_is_allowed_yet(tmp_path, monkeypatch, another_process):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    another_process()
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if not name.startswith(("gsrain_engine", "torch")):
            del sys.modules[name]


@pytest.fixture
def driver(tmp_path):
    (tmp_path / "near_it.py").write_text("import far_from_it\nSPEED = far_from_it.SPEED\n")
    (tmp_path / "far_from_it.py").write_text("SPEED = 4.0\n")
    (tmp_path / "driver.py").write_text("def speed():\n    from near_it import SPEED\n    return SPEED\n")
    return tmp_path / "driver.py"


def test_the_digest_covers_a_file_and_what_it_imports_near_it(driver, tmp_path):
    alone = tmp_path / "alone.py"
    alone.write_text("import os, json\n")
    assert read_code(alone).digest == hashlib.sha256(alone.read_bytes()).hexdigest()
    assert read_code(driver).others == ["far_from_it.py", "near_it.py"]
    changes = {"far_from_it": "A = 9\n", "near_it": "A = 9\n", "driver": "import json\n", "json": "import os\n"}
    for name, text in changes.items():  # the last one in the place of an installed module
        before = read_code(driver).digest
        (tmp_path / f"{name}.py").write_text(text)
        assert read_code(driver).digest != before


def test_only_the_code_that_was_read_runs(driver):
    code = read_code(driver)
    driver.write_text("def speed(): return 'changed'\n")
    (driver.parent / "far_from_it.py").write_text("SPEED = 'changed'\n")
    evil = driver.parent / "evil.py"
    evil.write_text("SPEED = 'bytecode'\n")
    bytecode = driver.parent / "__pycache__" / f"near_it.{sys.implementation.cache_tag}.pyc"
    py_compile.compile(str(evil), str(bytecode), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    assert run_main(code, "gsrain_agent_test_driver").speed() == 4.0
    assert str(driver.parent) not in sys.path
    other = driver.parent / "other" / "driver.py"
    other.parent.mkdir()
    (other.parent / "near_it.py").write_text("SPEED = 5.0\n")
    other.write_text("from near_it import SPEED\n")
    assert run_main(read_code(other), "other_driver").SPEED == 5.0  # a neighbor of the same name


def test_packages_of_a_folder_run_from_memory_and_leave_no_modules(tmp_path):
    (tmp_path / "models" / "deep").mkdir(parents=True)
    (tmp_path / "models" / "deep" / "net.py").write_text("from utils import SCALE\nDEPTH = 2 * SCALE\n")
    (tmp_path / "utils.py").write_text("SCALE = 3\n")
    code = read_code(tmp_path, ("models", "utils"))
    (tmp_path / "utils.py").write_text("SCALE = 'changed'\n")
    with importable(code):
        import models.deep.net  # pyright: ignore

        assert models.deep.net.DEPTH == 6
    assert not {"models", "utils", "models.deep"} & set(sys.modules)


def test_answers_are_remembered_by_content_in_a_private_file(driver, another_process, caplog):
    code = read_code(driver)
    with pytest.raises(UntrustedCodeError, match=rf"s\.yaml: .*driver\.py \(SHA-256 {code.digest[:12]}"):
        check_trusted("s.yaml", [code])
    trust_permanently([code])
    another_process()
    driver = driver.rename(driver.with_name("renamed.py"))
    check_trusted("s.yaml", [read_code(driver)])
    another_process()
    answers_file().chmod(0o620)
    assert not is_trusted(read_code(driver)) and "others could have written it" in caplog.text
    trust_permanently([read_code(driver)])
    another_process()
    assert is_trusted(read_code(driver)) and stat.S_IMODE(answers_file().stat().st_mode) == 0o600
    driver.write_text("import os\n")
    assert not is_trusted(read_code(driver))
    trust_permanently([read_code(driver)])
    assert len(json.loads(answers_file().read_bytes())["trusted"]) == 2
    for text in ("", "{", '{"trusted": 3}', "\0" * 100):  # a damaged file allows nothing
        answers_file().write_text(text)
        another_process()
        assert not is_trusted(read_code(driver))


def test_an_answer_that_can_not_be_written_is_valid_for_this_process(driver, tmp_path, caplog, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "file"))
    trust_permanently([read_code(driver)])
    assert is_trusted(read_code(driver)) and "is not remembered" in caplog.text


def test_code_that_appears_or_changes_after_the_answer_is_refused(tmp_path):
    program, late = tmp_path / "program.py", tmp_path / "late.py"
    program.write_text("A = 1\n")
    check_unchanged(read_code(program))  # a person named it
    expect_trusted({str(program): read_code(program).digest})
    check_unchanged(read_code(program))
    check_named("s.yaml", late)  # it is not there yet
    for file in (program, late):
        file.write_text("A = 2\n")
        with pytest.raises(UntrustedCodeError):
            check_unchanged(read_code(file))


def test_code_that_is_too_large_is_refused(tmp_path):
    with (tmp_path / "driver.py").open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(TooLargeError, match="driver.py: larger than"):
        read_code(tmp_path / "driver.py")


_TRAINING = "pictures: {clear: [{path: a}], rainy: [{path: b}], normals: dsine, normals_checkout: DSINE}\n"
_COMPARISON = """source: street
real: [real]
methods: [{name: one, method: cyclegan-turbo, normals: dsine, normals_checkout: DSINE}]
"""


@pytest.mark.parametrize(("load", "text"), [(load_finetuning, _TRAINING), (load_comparison, _COMPARISON)])
def test_settings_that_name_code_ask_before_it_runs(tmp_path, load, text):
    network, file = tmp_path / "DSINE" / "models" / "dsine.py", tmp_path / "settings.yaml"
    network.parent.mkdir(parents=True)
    (tmp_path / "real").mkdir()
    network.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    file.write_text(text)
    with pytest.raises(UntrustedCodeError, match=r"settings\.yaml: names Python code") as refused:
        load(file)
    trust(each.digest for each in refused.value.codes)
    settings = load(file)
    if load is load_finetuning:
        assert code_of(settings) == {str(tmp_path / "DSINE"): refused.value.codes[0].digest}
    network.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')  # changed\n")
    with pytest.raises(UntrustedCodeError):
        dsine_module(tmp_path / "DSINE")
    assert not (tmp_path / "ran").exists()
