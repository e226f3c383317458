"""`gsrain doctor` in the program that PyInstaller builds, to which pip can add nothing."""

import sys
from importlib.metadata import PackageNotFoundError
from types import SimpleNamespace

from app.doctor import doctor


def test_what_pip_can_not_add_needs_a_program_that_pip_installed(monkeypatch, capsys):
    nothing_installed = SimpleNamespace(version=_none, PackageNotFoundError=PackageNotFoundError)
    monkeypatch.setattr("app.doctor.metadata", nothing_installed)
    monkeypatch.setattr("app.doctor.installed_extensions", tuple)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    doctor()
    lines = [line for line in capsys.readouterr().out.splitlines() if "not installed; for " in line]
    assert len(lines) > 5
    assert all("needs GSRAIN installed by pip, with 'gsrain[" in line for line in lines)


def _none(name):
    raise PackageNotFoundError(name)
