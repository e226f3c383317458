"""Python that files name: what counts as its content, who has allowed it, and that only this very content runs."""

import hashlib
import json
import os
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
    trust,  # fmt: skip
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
    (tmp_path / "unused.py").write_text("raise RuntimeError\n")
    (tmp_path / "driver.py").write_text("def speed():\n    from near_it import SPEED\n    return SPEED\n")
    return tmp_path / "driver.py"


def test_the_digest_covers_a_file_and_what_it_imports_near_it(driver, tmp_path):
    alone = tmp_path / "alone.py"
    alone.write_text("import os, json\n")
    assert read_code(alone).digest == hashlib.sha256(alone.read_bytes()).hexdigest()
    code = read_code(driver)
    assert set(code.files) == {"", "near_it", "far_from_it"} and code.others == ["far_from_it.py", "near_it.py"]
    for name, text in (("far_from_it", "SPEED = 9.0\n"), ("near_it", "SPEED = 9.0\n"), ("driver", "import json\n")):
        before = read_code(driver).digest
        (tmp_path / f"{name}.py").write_text(text)
        assert read_code(driver).digest != before
    assert (tmp_path / "unused.py").is_file() and read_code(driver).others == []
    before = read_code(driver).digest
    (tmp_path / "json.py").write_text("import os\n")  # in the place of an installed module
    assert read_code(driver).digest != before


def test_only_what_was_read_runs(driver):
    code = read_code(driver)
    driver.write_text("def speed(): return 'changed'\n")
    (driver.parent / "far_from_it.py").write_text("SPEED = 'changed'\n")
    evil = driver.parent / "evil.py"
    evil.write_text("SPEED = 'bytecode'\n")
    bytecode = driver.parent / "__pycache__" / f"near_it.{sys.implementation.cache_tag}.pyc"
    py_compile.compile(str(evil), str(bytecode), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    assert run_main(code, "gsrain_agent_test_driver").speed() == 4.0
    assert str(driver.parent) not in sys.path


def test_two_drivers_with_neighbors_of_one_name(tmp_path):
    speeds = []
    for number in (1, 2):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "near.py").write_text(f"SPEED = {number}\n")
        (folder / "driver.py").write_text("from near import SPEED\n")
        speeds.append(run_main(read_code(folder / "driver.py"), f"driver{number}").SPEED)
    assert speeds == [1, 2]


def test_a_folder_s_packages_run_from_memory_and_leave_no_trace(tmp_path):
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
    assert stat.S_IMODE(answers_file().stat().st_mode) == 0o600
    another_process()
    check_trusted("s.yaml", [read_code(driver)])
    driver = driver.rename(driver.with_name("renamed.py"))
    assert is_trusted(read_code(driver))
    another_process()
    answers_file().chmod(0o620)
    assert not is_trusted(read_code(driver)) and "others could have written it" in caplog.text
    trust_permanently([read_code(driver)])
    another_process()
    assert is_trusted(read_code(driver)) and stat.S_IMODE(answers_file().stat().st_mode) == 0o600
    driver.write_text("import os\n")
    with pytest.raises(UntrustedCodeError):
        check_trusted("s.yaml", [read_code(driver)])
    trust_permanently([read_code(driver)])
    assert len(json.loads(answers_file().read_bytes())["trusted"]) == 2
    for text in ("", "{", '{"trusted": 3}', "\0" * 100):  # a damaged file allows nothing
        answers_file().write_text(text)
        another_process()
        assert not is_trusted(read_code(driver))


def test_an_answer_that_can_not_be_written_down_holds_for_now(driver, tmp_path, caplog, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "file"))
    trust_permanently([read_code(driver)])
    assert is_trusted(read_code(driver)) and "is not remembered" in caplog.text


def test_what_comes_after_the_answer_is_checked_when_it_runs(tmp_path):
    program = tmp_path / "program.py"
    check_unchanged(_code(program, "A = 1\n"))  # a person named it
    expect_trusted({str(program): _code(program, "A = 1\n").digest})
    check_unchanged(_code(program, "A = 1\n"))
    with pytest.raises(UntrustedCodeError):
        check_unchanged(_code(program, "A = 2\n"))
    late = tmp_path / "late.py"
    check_named("s.yaml", late)  # it is not there yet
    with pytest.raises(UntrustedCodeError):
        check_unchanged(_code(late, "A = 3\n"))


def _code(file, text):
    file.write_text(text)
    return read_code(file)


def test_what_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(trusted_code, "_MAX_BYTES", 100)
    (tmp_path / "driver.py").write_text("#" * 101)
    with pytest.raises(TooLargeError, match="driver.py: larger than 100 bytes"):
        read_code(tmp_path / "driver.py")
    monkeypatch.setattr(trusted_code, "_MAX_FILES", 1)
    (tmp_path / "driver.py").write_text("import one\nimport two\n")
    for name in ("one", "two"):
        (tmp_path / f"{name}.py").write_text("")
    with pytest.raises(ValueError, match="more Python than"):
        read_code(tmp_path / "driver.py")


_TRAINING = "pictures: {clear: [{path: a}], rainy: [{path: b}], normals: dsine, normals_checkout: DSINE}\n"
_COMPARISON = """source: street
real: [real]
methods: [{name: one, method: cyclegan-turbo, normals: dsine, normals_checkout: DSINE}]
"""


@pytest.fixture
def checkout(tmp_path):
    (tmp_path / "DSINE" / "models").mkdir(parents=True)
    (tmp_path / "DSINE" / "models" / "dsine.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    (tmp_path / "real").mkdir()
    return tmp_path / "DSINE"


@pytest.mark.parametrize(("load", "text"), [(load_finetuning, _TRAINING), (load_comparison, _COMPARISON)])
def test_settings_that_name_a_program(checkout, load, text):
    file = checkout.parent / "settings.yaml"
    file.write_text(text)
    with pytest.raises(UntrustedCodeError, match=r"settings\.yaml: names Python code") as refused:
        load(file)
    trust(each.digest for each in refused.value.codes)
    settings = load(file)
    if load is load_finetuning:
        assert code_of(settings) == {os.path.abspath(checkout): refused.value.codes[0].digest}  # noqa: PTH100
    (checkout / "models" / "dsine.py").write_text(f"open({str(checkout.parent / 'ran')!r}, 'w')  # changed\n")
    with pytest.raises(UntrustedCodeError):
        dsine_module(checkout)
    assert not (checkout.parent / "ran").exists()
