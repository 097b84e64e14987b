"""What an installation is made of: the lock files, the script, the packages."""

from __future__ import annotations

import ast
import importlib
import re
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def _pinned(name: str) -> dict[str, str]:
    """Return the version of every package of a lock file; fail on one without a hash."""
    text = (ROOT / name).read_text(encoding="utf-8")
    entries = re.findall(
        r"^([\w.-]+)==(\S+) \\\n((?:    --hash=sha256:[0-9a-f]{64}.*\n)+)", text, re.M
    )
    assert len(entries) == len(re.findall(r"^[\w.-]+==", text, re.M)) > 5
    return {package: version for package, version, _ in entries}


def _named(requirements: list[str]) -> set[str]:
    return {re.match(r"[\w.-]+", requirement)[0] for requirement in requirements}


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-dev.lock"])
def test_lock_files_are_hashed_and_name_no_place(name):
    pinned = _pinned(name)
    assert _named(PROJECT["project"]["dependencies"]) <= set(pinned)
    assert "setuptools" in pinned  # the package is built without isolation
    assert not re.search(r"https?:|file:/|--index|--find-links|@ ", (ROOT / name).read_text())


def test_the_development_lock_extends_the_other():
    run, develop = _pinned("requirements.lock"), _pinned("requirements-dev.lock")
    assert run.items() <= develop.items()
    assert _named(PROJECT["project"]["optional-dependencies"]["dev"]) <= set(develop)


def test_every_package_imported_is_declared():
    names = {
        "cv2": "opencv-python-headless",
        "fpdf": "fpdf2",
        "prometheus_client": "prometheus-client",
        "yaml": "pyyaml",
        "zenoh": "eclipse-zenoh",
    }
    behind_others = {"python-multipart", "websockets"}  # imported by fastapi and uvicorn for us
    ours = {"pipeline", "service", "dscqs"}
    imported = {
        (node.module or "" if isinstance(node, ast.ImportFrom) else alias.name).split(".")[0]
        for package in ours
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for alias in node.names
    }
    outside = imported - ours - set(sys.stdlib_module_names)
    declared = _named(PROJECT["project"]["dependencies"])
    optional = {"ncnn"}  # runs the peers' networks, where it is there
    assert optional <= _named(PROJECT["project"]["optional-dependencies"]["peers"])
    outside -= optional
    assert {names.get(name, name) for name in outside} == declared - behind_others


def test_the_script_points_to_a_function():
    module, _, function = PROJECT["project"]["scripts"]["depthsr"].partition(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_every_package_of_the_project_is_found_by_the_build():
    from setuptools import find_packages

    include = PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    found = set(find_packages(str(ROOT), include=include))
    folders = {
        path.parent.relative_to(ROOT).as_posix().replace("/", ".")
        for package in ("pipeline", "service", "dscqs")
        for path in (ROOT / package).rglob("*.py")
    }
    assert folders <= found
