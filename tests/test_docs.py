"""What the documents say is so: options, commands, links, names, formats."""

from __future__ import annotations

import argparse
import ast
import dataclasses
import inspect
import json
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.config import Settings, option_name
from pipeline.errors import ConfigurationError, SceneError
from pipeline.job import FrameRange, InputOptions, OutputOptions
from service.cli import make_parser
from service.options import collect

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "pipeline/**/*.md", "service/**/*.md", "dscqs/**/*.md")
    for path in ROOT.glob(pattern)
)
NEEDED = (
    "README.md", "CHANGELOG.md", "docs/scene.md", "docs/method.md", "docs/formats.md",
    "docs/settings.md", "pipeline/README.md",
)  # fmt: skip

FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)
CODE = re.compile(r"`([^`\n]+)`")


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _blocks(text: str, *languages: str) -> list[str]:
    return [body for language, body in FENCE.findall(text) if language in languages]


def _prose(text: str) -> str:
    """Return the text without its fenced blocks."""
    return FENCE.sub("", text)


def _rows(text: str) -> list[list[str]]:
    """Return the cells of every row of the tables."""
    return [
        [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip()[1:-1])]
        for line in text.splitlines()
        if line.startswith("|") and not re.match(r"\|[-|: ]+\|$", line)
    ]


def _rows_by_name(name: str) -> dict[str, list[str]]:
    """Return the cells after the first of every row that begins with code, by that code."""
    found = ((CODE.findall(first), cells) for first, *cells in _rows(_text(name)))
    return {names[0]: cells for names, cells in found if names}


def _commands(text: str) -> Iterator[list[str]]:
    """Yield the words of every command of the shell blocks."""
    for block in _blocks(text, "sh", "bash", "console"):
        is_console = "$ " in block
        for line in block.replace("\\\n", " ").splitlines():
            if is_console and not line.startswith("$ "):
                continue
            words = shlex.split(line.removeprefix("$ "), comments=True)
            while words and re.fullmatch(r"\w+=.*", words[0]):
                words.pop(0)
            if words:
                yield words


ALL_COMMANDS = [
    pytest.param(words, id=f"{page.relative_to(ROOT).as_posix()}: {' '.join(words)}")
    for page in PAGES
    for words in _commands(page.read_text(encoding="utf-8"))
]
OUR_COMMANDS = [item for item in ALL_COMMANDS if Path(item.values[0][0]).name == "depthsr"]


@pytest.mark.parametrize("name", NEEDED)
def test_the_pages_are_there(name):
    assert _text(name).startswith("# ")


def test_every_document_is_in_the_list_of_documents():
    linked = set(re.findall(r"\]\(([\w-]+\.md)\)", _text("docs/README.md")))
    assert linked == {page.name for page in (ROOT / "docs").glob("*.md")} - {"README.md"}


# Commands


@pytest.mark.parametrize("words", OUR_COMMANDS)
def test_commands_in_the_documents_are_understood(words):
    parser = make_parser()
    arguments = parser.parse_args(words[1:])
    if words[1] == "run":
        Settings(**collect(arguments, Settings))
        InputOptions(**collect(arguments, InputOptions))
        output = OutputOptions(**collect(arguments, OutputOptions))
        if output.output is not None:
            assert output.output.suffix in {".mkv", ".mp4", ".webm"}


def test_the_readme_shows_the_commands_that_matter():
    shown = {tuple(words[:2]) for words in _commands(_text("README.md"))}
    assert shown >= {("make", "demo"), ("make", "test"), ("depthsr", "run"), ("depthsr", "probe")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_make_targets_exist(page):
    text = page.read_text(encoding="utf-8")
    named = {words[1] for words in _commands(text) if words[0] == "make"}
    named |= set(re.findall(r"`make ([\w-]+)", _prose(text)))
    targets = set(re.findall(r"^([\w-]+):", _text("Makefile"), re.M))
    assert named <= targets


# Settings


def _run_parser() -> argparse.ArgumentParser:
    for action in make_parser()._actions:
        if isinstance(action, argparse._SubParsersAction):
            return action.choices["run"]
    raise AssertionError("there is no command run")


def _option_rows() -> dict[str, list[str]]:
    """Return the cells after the first of every row of docs/settings.md, by option."""
    found: dict[str, list[str]] = {}
    for first, *cells in _rows(_text("docs/settings.md")):
        for option in CODE.findall(first):
            if option.startswith("-"):
                assert option not in found, f"{option} is described twice"
                found[option] = cells
    return found


def test_every_option_of_run_is_described_and_no_other():
    options = {option for action in _run_parser()._actions for option in action.option_strings}
    assert set(_option_rows()) == options


def _fields() -> list[dataclasses.Field]:
    return [
        item
        for kind in (InputOptions, OutputOptions, Settings)
        for item in dataclasses.fields(kind)
    ]


@pytest.mark.parametrize("item", _fields(), ids=lambda item: item.name)
def test_units_defaults_and_choices_of_the_settings(item):
    values, unit, default, meaning = _option_rows()[option_name(item.name)]
    assert unit == (item.metadata["unit"] or "–")
    assert meaning
    assert tuple(CODE.findall(values)) == item.metadata["choices"] or not item.metadata["choices"]
    said = re.search(r"\(default: (.*?)\)", item.metadata["help"])
    if said is not None:
        assert default == said[1]
    elif item.default is False:
        assert default == "off"
    elif item.default is not None and item.default != FrameRange():
        assert default.strip("`") == str(item.default)


@pytest.mark.parametrize("item", _fields(), ids=lambda item: item.name)
def test_ranges_of_the_settings(item):
    if "int" not in str(item.type) and "float" not in str(item.type):
        return
    kind = OutputOptions if item in dataclasses.fields(OutputOptions) else Settings
    others = {"output": Path("out.mkv")} if kind is OutputOptions else {}
    try:
        kind(**{item.name: 10**9}, **others)
    except ConfigurationError as error:
        rule = re.search(r"must be (.*), not", str(error))[1]
        assert rule in _option_rows()[option_name(item.name)][0]
    else:
        assert item.name == "quality"  # its range is the codec's


def test_thresholds_that_follow_the_noise():
    from pipeline.superresolve import default_residual_threshold, default_weight_threshold

    for rule in (default_weight_threshold, default_residual_threshold):
        formula = f"{rule(0):g} + {rule(1) - rule(0):g} × noise"
        assert formula in _text("docs/settings.md")
        assert formula in _text("docs/method.md")


def test_registration_presets_that_need_calibration():
    from pipeline.registration.method import METHODS, Initialisation

    needing = {
        name
        for name, method in METHODS.items()
        if method.initialisation is Initialisation.CALIBRATION
    }
    sentence = re.search(
        r"((?:`[\w-]+` and )?`[\w-]+`) need a calibrated", _text("docs/settings.md")
    )
    assert set(CODE.findall(sentence[1])) == needing


# Links and names


def _links(page: Path) -> Iterator[str]:
    text = _prose(page.read_text(encoding="utf-8"))
    yield from re.findall(r"\]\(([^)\s]+)\)", text)
    yield from re.findall(r"<(?:img|a)\b[^>]*?(?:src|href)=\"([^\"]+)\"", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_relative_links_lead_somewhere(page):
    dead = []
    for link in _links(page):
        target, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        path = (page.parent / target) if target else page
        is_ours = path.exists() and path.resolve().is_relative_to(ROOT.resolve())
        if not is_ours or (anchor and anchor not in _anchors(path)):
            dead.append(link)
    assert dead == []


def _anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", _prose(page.read_text(encoding="utf-8")), re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_what_the_code_points_to_is_there():
    sources = [
        path
        for package in ("pipeline", "service", "dscqs")
        for path in (ROOT / package).rglob("*.py")
    ]
    pointers = {
        pointer
        for path in sources
        for pointer in re.findall(r"docs/[\w-]+\.md(?:#[\w-]+)?", path.read_text(encoding="utf-8"))
    }
    assert pointers
    for pointer in pointers:
        name, _, anchor = pointer.partition("#")
        assert (ROOT / name).is_file(), pointer
        assert not anchor or anchor in _anchors(ROOT / name), pointer


def _defined(path: Path) -> set[str]:
    """Return the names that a module defines at its top, and those of its classes' members."""
    found: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return found


def _resolves(dotted: str) -> bool:
    """Tell whether a dotted name is a package, a module, or a name defined in a module."""
    parts = dotted.split(".")
    for length in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:length])
        rest = parts[length:]
        if path.with_suffix(".py").is_file():
            return not rest or rest[0] in _defined(path.with_suffix(".py"))
        if (path / "__init__.py").is_file():
            return not rest or rest[0] in _defined(path / "__init__.py")
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_modules_and_files_named_exist(page):
    names = CODE.findall(_prose(page.read_text(encoding="utf-8")))
    dotted = [name for name in names if re.fullmatch(r"(pipeline|service|dscqs)(\.\w+)+", name)]
    rooms = r"(pipeline|service|dscqs|tests|docs|docker|benchmarks|\.ci)/[\w./-]*"
    paths = [name for name in names if re.fullmatch(rooms, name)]
    assert [name for name in dotted if not _resolves(name)] == []
    assert [name for name in paths if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_environment_variables_named_are_read(page):
    variable = re.compile(r"\bDEPTHSR_[A-Z_]+\b")
    named = set(variable.findall(page.read_text(encoding="utf-8")))
    places = [*ROOT.glob("service/*.py"), *ROOT.glob("pipeline/evaluation/*.py")]
    places.append(ROOT / "tests" / "conftest.py")
    read = {name for path in places for name in variable.findall(path.read_text(encoding="utf-8"))}
    assert named <= read


# Equations


def _cited(text: str) -> set[int]:
    """Return the numbers of the equations that a text names: Eq. 1, Eq. (3), Eq. (7)-(10)."""
    found = set()
    for first, last in re.findall(r"Eq\. \(?(\d+)\)?(?:-\(?(\d+)\)?)?", text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def _equation_rows() -> list[tuple[set[int], list[str]]]:
    """Return (equations, dotted names) of the rows of the equation index."""
    return [
        (_cited(first), [name for name in CODE.findall(cells[-1]) if "." in name])
        for first, *cells in _rows(_text("pipeline/README.md"))
        if _cited(first)
    ]


def test_the_equation_index_is_complete():
    assert set().union(*(numbers for numbers, _ in _equation_rows())) == set(range(1, 11))


@pytest.mark.parametrize(("numbers", "names"), _equation_rows(), ids=str)
def test_files_of_the_equation_index_cite_the_equation(numbers, names):
    modules = {ROOT.joinpath(*name.split(".")[:-1]).with_suffix(".py") for name in names}
    assert any(numbers & _cited(path.read_text(encoding="utf-8")) for path in modules)


# Scenes


@pytest.mark.parametrize("index", range(2))
def test_manifests_in_the_documents_are_read(index, tmp_path):
    from pipeline.media.manifest import read_manifest

    manifests = [block for block in _blocks(_text("docs/scene.md"), "json") if '"format"' in block]
    (tmp_path / "scene.json").write_text(manifests[index], encoding="utf-8")
    assert len(read_manifest(tmp_path).views) == 2


def _known_keys(manifest: dict, tmp_path: Path) -> list[str]:
    """Return the keys that the reader knows where it has found an unknown one."""
    from pipeline.media.manifest import read_manifest

    (tmp_path / "scene.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(SceneError, match="unknown key 'bogus'") as caught:
        read_manifest(tmp_path)
    return re.search(r"known are (.*)$", str(caught.value))[1].split(", ")


@pytest.mark.parametrize("place", ["scene", "view", "raw", "depth"])
def test_every_key_of_a_manifest_is_described(place, tmp_path):
    block = next(block for block in _blocks(_text("docs/scene.md"), "json") if '"unknown"' in block)
    manifest = json.loads(block)
    raw = next(block for block in _blocks(_text("docs/scene.md"), "json") if '"yuv"' in block)
    view = manifest["views"][0]
    if place == "raw":
        view["color"] = json.loads(raw)
    spot = {"scene": manifest, "view": view, "raw": view["color"], "depth": manifest["depth"]}
    spot[place]["bogus"] = 1
    rows = _rows(_text("docs/scene.md"))
    described = {name for first, *_ in rows for name in CODE.findall(first)}
    assert set(_known_keys(manifest, tmp_path)) <= described


# Formats


def test_containers_codecs_and_qualities():
    from pipeline.media.video_format import CODECS, DEFAULT_CRF, HIGHEST_CRF, VideoCodec

    rows = _rows_by_name("docs/formats.md")
    for container, codecs in CODECS.items():
        assert CODE.findall(rows[f".{container}"][0]) == [codec.value for codec in codecs]
    without = {VideoCodec.FFV1: "lossless", VideoCodec.PRORES: "one quality"}
    for codec in VideoCodec:
        assert rows[codec.value][1] == str((DEFAULT_CRF | without)[codec])
    values = _option_rows()["--crf"][0]
    assert all(f"1 to {highest}" in values for highest in HIGHEST_CRF.values())


def test_names_that_players_know():
    from pipeline.media.video_format import suggested_name
    from pipeline.stereo import StereoLayout

    text = _text("docs/formats.md")
    for layout in StereoLayout:
        assert f"`{layout.value}`" in text
        if layout.packed:
            assert f"`{suggested_name('clip', layout)}`" in text


def test_every_field_of_the_report_is_described():
    from pipeline.frames import Rejection
    from pipeline.results import FrameReport, TargetReport, ViewReport

    named = set(CODE.findall(_text("docs/formats.md")))
    for kind in (FrameReport, TargetReport, ViewReport):
        assert {item.name for item in dataclasses.fields(kind)} <= named
    reasons = {reason.name.lower() for reason in Rejection if reason.value}
    assert reasons <= named
    assert reasons <= set(_rows_by_name("docs/method.md"))


def test_every_debug_picture_is_described():
    from pipeline import debug_pictures

    written = re.findall(r"\"([a-z-]+)\": ", inspect.getsource(debug_pictures._pictures))
    rows = {first.strip("`") for first, *_ in _rows(_text("docs/formats.md"))}
    assert len(written) >= 5
    assert set(written) <= rows


# Plans of tests


def _plan_fields() -> list[tuple[str, dataclasses.Field]]:
    from dscqs.plan import Plan, Timing

    plain = [(item.name, item) for item in dataclasses.fields(Plan) if item.name != "timing"]
    return plain + [(f"timing.{item.name}", item) for item in dataclasses.fields(Timing)]


def _plan_rows() -> dict[str, list[str]]:
    text = _text("docs/dscqs.md").partition("## The plan, field by field")[2].partition("\n## ")[0]
    return {first.strip("`"): cells for first, *cells in _rows(text)[1:]}


def test_every_field_of_a_plan_is_described_and_no_other():
    assert set(_plan_rows()) == {name for name, _ in _plan_fields()}


def _usual(item: dataclasses.Field) -> str:
    """Return the default of a field of a plan as the table says it."""
    match item.default:
        case dataclasses.MISSING:
            return "needed" if item.default_factory is dataclasses.MISSING else "none"
        case bool():
            return str(item.default).lower()
        case tuple():
            return "all" if item.name == "stages" else ", ".join(item.default) or "none"
        case _:
            return str(item.default) if isinstance(item.default, str) else f"{item.default:g}"


@pytest.mark.parametrize(("name", "item"), _plan_fields(), ids=lambda one: str(one)[:20])
def test_defaults_and_values_of_a_plan(name, item):
    from dscqs.plan import DIMENSIONS, RANGES, STAGES

    default, values, meaning = _plan_rows()[name]
    assert meaning
    assert default.strip("`") == _usual(item)
    if name in RANGES:
        assert values == " to ".join(
            str(end) if isinstance(end, int) else f"{end:g}" for end in RANGES[name]
        )
    elif name in ("dimensions", "stages"):
        assert tuple(CODE.findall(values)) == {"dimensions": DIMENSIONS, "stages": STAGES}[name]
    elif isinstance(item.default, bool):
        assert values == "true, false"


# The house


def test_the_project_shows_its_readme():
    assert tomllib.loads(_text("pyproject.toml"))["project"]["readme"] == "README.md"


def test_what_the_readme_calls_planned_is_not_there_yet():
    planned = re.search(r"^Planned, not there yet: (.*)$", _text("README.md"), re.M)[1]
    has_search = (ROOT / "pipeline" / "psf_search.py").exists()
    assert ("--psf auto" in planned) != has_search, "README.md: bring 'Planned' up to date"


def test_the_changelog_has_its_form():
    text = _text("CHANGELOG.md")
    sections = re.findall(r"^## (.*)$", text, re.M)
    assert sections[0] == "[Unreleased]"
    assert all(re.fullmatch(r"\[[\d.]+\] - \d{4}-\d\d-\d\d", section) for section in sections[1:])
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert set(re.findall(r"^### (.*)$", text, re.M)) <= kinds


def test_the_picture_of_the_readme_is_small_enough():
    picture = ROOT / "docs" / "images" / "before-after.png"
    assert 0 < picture.stat().st_size < 600_000
