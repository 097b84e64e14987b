"""Who may import whom: the arrows of the rooms, read from the source text."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("pipeline", "service", "dscqs")

NUMERIC_ROOMS = (
    "pipeline/registration", "pipeline/reconstruction", "pipeline/grid.py", "pipeline/stereo.py",
    "pipeline/metrics.py", "pipeline/baselines.py", "pipeline/degradation.py",
    "pipeline/colour.py", "pipeline/frames.py", "pipeline/errors.py", "pipeline/noise.py",
    "dscqs/statistics",
)  # fmt: skip
"""Arrays in, arrays out: they touch no file, clock, log or environment."""

OUTSIDE_WORLD = frozenset(
    {
        "asyncio", "datetime", "glob", "http", "io", "logging", "multiprocessing", "os", "pathlib",
        "random", "resource", "shutil", "signal", "socket", "sqlite3", "subprocess", "sys",
        "tempfile", "threading", "time", "urllib", "warnings",
    }
)  # fmt: skip
"""Modules that a numeric room must not import."""


def _files(place: str) -> list[Path]:
    path = ROOT / place
    found = [path] if path.is_file() else sorted(path.rglob("*.py"))
    assert found, f"{place}: nothing there to check"
    return found


@functools.cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@functools.cache
def _imports(path: Path) -> tuple[str, ...]:
    """Return the full name of every module imported anywhere in the file."""
    return tuple(_found_imports(path))


def _found_imports(path: Path) -> Iterator[str]:
    """Yield them; relative ones are resolved."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("package", [*PACKAGES, "benchmarks"])
def test_packages_say_what_is_in_them(package):
    """The docstring of a package is the map of its modules: all are there, and no others."""
    for path in (ROOT / package).rglob("__init__.py"):
        said = ast.get_docstring(_tree(path)) or ""
        assert len(said) > 30, path
        names = set(re.findall(r":mod:`([\w.]+)`", said))
        modules = {file.stem for file in path.parent.glob("*.py") if not file.stem.startswith("__")}
        assert modules <= names, f"{path} does not say what these are"
        for name in names - modules:
            place = ROOT / Path(*name.split("."))
            is_there = place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()
            assert is_there, f"{path}: {name}"


def _offenders(place: str, *forbidden: str) -> list[str]:
    return [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in _files(place)
        for name in _imports(path)
        if any(name == bad or name.startswith(f"{bad}.") for bad in forbidden)
    ]


@pytest.mark.parametrize(
    ("room", "forbidden"),
    [
        ("pipeline", ("service", "dscqs")),
        ("dscqs", ("service", "pipeline")),
        ("pipeline/registration", ("pipeline.reconstruction", "pipeline.media", "pipeline.run")),
        ("pipeline/reconstruction", ("pipeline.registration", "pipeline.media", "pipeline.run")),
        ("pipeline/media", ("pipeline.registration", "pipeline.reconstruction", "pipeline.run")),
        ("pipeline/grid.py", ("pipeline", "cv2", "numba")),
        ("pipeline/errors.py", ("pipeline", "numpy")),
    ],
)
def test_arrows_point_one_way(room, forbidden):
    assert _offenders(room, *forbidden) == []


AV_DOORS = (
    "cameras", "decode", "decoded", "encode", "join", "live_encode", "live_file", "lossless",
    "sound", "swscale",
)  # fmt: skip
"""Modules of ``pipeline/media`` that import PyAV."""


@pytest.mark.parametrize(
    ("library", "doors"),
    [
        ("av", {f"pipeline/media/{name}.py" for name in AV_DOORS}),
        ("dask", set()),
        ("distributed", {"pipeline/cluster.py"}),
        ("fpdf", {"dscqs/report/pdf.py"}),
        (
            "matplotlib",
            {"pipeline/evaluation/plots.py"}
            | {f"dscqs/report/{name}.py" for name in ("blocks", "html", "pdf", "plots", "style")},
        ),
        ("ncnn", {"pipeline/evaluation/networks.py"}),
        ("zenoh", {"service/bus/zenoh_bus.py"}),
    ],
)
def test_libraries_are_behind_their_doors(library, doors):
    assert _users(library, *PACKAGES) == doors


@pytest.mark.parametrize(
    ("library", "doors"),
    [
        ("sqlite3", {"dscqs/sqlite_store.py"}),
        ("tempfile", {"dscqs/shelf.py"}),
        ("fastapi", set()),
        ("httpx", set()),
        ("cv2", set()),
    ],
)
def test_doors_of_subjective_tests(library, doors):
    assert _users(library, "dscqs") == doors


def _users(library: str, *places: str) -> set[str]:
    """Return the files that import a library."""
    return {
        path.relative_to(ROOT).as_posix()
        for place in places
        for path in _files(place)
        if any(name.split(".")[0] == library for name in _imports(path))
    }


def test_the_state_machine_touches_nothing_outside():
    outside = OUTSIDE_WORLD - {"random"}
    for place in ("dscqs/session.py", "dscqs/order.py", "dscqs/plan.py", "dscqs/views.py"):
        assert _offenders(place, *outside) == []


@pytest.mark.parametrize("room", NUMERIC_ROOMS)
def test_numeric_rooms_touch_nothing_outside(room):
    assert _offenders(room, *OUTSIDE_WORLD) == []
    calls = [
        f"{path.relative_to(ROOT)}:{node.lineno} calls {node.func.id}"
        for path in _files(room)
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in {"open", "print", "input", "exec", "eval"}
    ]
    assert calls == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_global_random_state(package):
    """np.random is used through generators that are handed over or seeded where they are made."""
    allowed = {"default_rng", "Generator", "SeedSequence", "PCG64"}
    offenders = [
        f"{path.relative_to(ROOT)}:{node.lineno} uses np.random.{node.attr}"
        for path in _files(package)
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Attribute)
        and node.value.attr == "random"
        and isinstance(node.value.value, ast.Name)
        and node.value.value.id in {"np", "numpy"}
        and node.attr not in allowed
    ]
    assert offenders == []


def test_the_command_line_imports_nothing_heavy_at_its_top():
    heavy = {"numpy", "cv2", "av", "numba", "scipy"}
    light = [
        "service/cli.py",
        "service/console.py",
        "service/options.py",
        "pipeline/numba_cache.py",
    ]
    light += [f"pipeline/{name}.py" for name in ("config", "job", "errors", "grid")]
    for place in light:
        for path in _files(place):
            top = [
                node for node in _tree(path).body if isinstance(node, (ast.Import, ast.ImportFrom))
            ]
            names = {
                (node.module or "") if isinstance(node, ast.ImportFrom) else alias.name
                for node in top
                for alias in node.names
            }
            assert {name.split(".")[0] for name in names} & heavy == set(), place


def test_every_error_has_a_code_of_its_own_and_says_what_it_means():
    from pipeline import errors

    classes = [
        item
        for item in vars(errors).values()
        if isinstance(item, type) and issubclass(item, errors.PipelineError)
    ]
    assert len(classes) >= 5
    assert len({item.code for item in classes}) == len(classes)
    for item in classes:
        assert item.__doc__
        assert str(item()) == item.__doc__
