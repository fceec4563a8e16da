"""What holds for the repository as a whole: budgets, imports, pins, documentation."""

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import lemma

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
PYTHON_FILES = SOURCES + sorted(
    path
    for folder in ("tests", "examples", "scripts", "docs")
    for path in (ROOT / folder).rglob("*.py")
)
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
VAGUE_NAMES = {"utils", "util", "helpers", "helper", "misc", "common"}
TOP_FOLDERS = ("src", "tests", "examples", "docs", "scripts", ".ci")


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", PYTHON_FILES, ids=relative)
def test_file_is_short_and_named_by_a_noun(path: Path) -> None:
    lines = len(path.read_text().splitlines())
    assert lines <= MAX_FILE_LINES, f"{lines} lines: split it"
    assert path.stem not in VAGUE_NAMES, "name it after what it holds"


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_functions_are_short(path: Path) -> None:
    too_long = {
        f"{node.name} (line {node.lineno})": lines
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (lines := (node.end_lineno or 0) - node.lineno + 1) > MAX_FUNCTION_LINES
    }
    assert not too_long


def test_every_folder_of_sources_is_a_package() -> None:
    folders = {path.parent for path in SOURCES} - {ROOT / "src"}
    assert [f for f in sorted(folders) if not (f / "__init__.py").exists()] == []
    assert (ROOT / "src/lemma/py.typed").exists()


def test_test_files_have_different_names() -> None:
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert len(names) == len(set(names))


def test_import_is_silent_and_light() -> None:
    code = (
        "import sys, lemma\n"
        "heavy = {'torch', 'mujoco', 'numba'} & set(sys.modules)\n"
        "sys.exit(f'imported {sorted(heavy)}' if heavy else 0)"
    )
    done = run_python("-W", "error", "-c", code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_public_names_resolve() -> None:
    names = vars(lemma)["__all__"]
    assert names
    assert [name for name in names if getattr(lemma, name, None) is None] == []


def test_version_is_the_same_everywhere() -> None:
    assert PROJECT["version"] == lemma.__version__
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {lemma.__version__}\n" in citation
    assert f"## [{lemma.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


UNPINNED = ("text", "track")
"""Extras that no target of the Makefile installs; the versions are the user's."""


def requirements() -> list[Requirement]:
    every = PROJECT["optional-dependencies"]
    extras = [group for name, group in every.items() if name not in UNPINNED]
    return [
        Requirement(text)
        for group in (PROJECT["dependencies"], *extras)
        for text in group
    ]


@cache
def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): pinned for name, pinned in pairs}


@pytest.mark.parametrize("requirement", requirements(), ids=lambda r: r.name)
def test_dependency_is_pinned_within_its_range(requirement: Requirement) -> None:
    pinned = pins()[canonicalize_name(requirement.name)]
    assert requirement.specifier.contains(Version(pinned))


def test_what_is_not_pinned_is_not_installed_here() -> None:
    installed = re.findall(r"'\.\[(.*?)\]'", (ROOT / "Makefile").read_text())
    assert installed
    names = {name for group in installed for name in group.split(",")}
    assert names <= set(PROJECT["optional-dependencies"]) - set(UNPINNED)


def test_core_needs_no_torch() -> None:
    names = {Requirement(text).name for text in PROJECT["dependencies"]}
    assert names.isdisjoint({"torch", "torchvision", "transformers"})


def test_engine_is_the_pinned_one() -> None:
    assert version("mujoco") == pins()["mujoco"]


def code_in(page: str) -> list[str]:
    """Return the lines of the code blocks and the inline code of a Markdown page."""
    fence = re.compile(r"^ *(`{3,}|~{3,})[^\n]*\n(.*?)^ *\1", re.MULTILINE | re.DOTALL)
    blocks = [match[2] for match in fence.finditer(page)]
    rest = fence.sub("", page)
    indented = re.findall(r"^ {4}(\S.*)$", rest, re.MULTILINE)
    inline = re.findall(r"`([^`\n]+)`", rest)
    return [
        line for text in (*blocks, *indented, *inline) for line in text.splitlines()
    ]


def is_pattern(text: str) -> bool:
    return any(character in text for character in "<>*{}…[]$")


def paths_in(page: Path) -> set[Path]:
    """Return the files of the repository that a page mentions or links to."""
    text = page.read_text()
    folders = "|".join(re.escape(folder) for folder in TOP_FOLDERS)
    mentioned = {
        ROOT / word.rstrip(".,:;")
        for line in code_in(text)
        for word in re.findall(rf"(?<![\w/.-])(?:{folders})/[^\s`'\",;:()]+", line)
        if not is_pattern(word)
    }
    links = re.findall(r"\]\(([^)\s#]+)[^)]*\)|src=\"([^\"]+)\"", text)
    linked = {
        page.parent / target
        for target in (first or second for first, second in links)
        if "://" not in target and not target.startswith(("mailto:", "#"))
    }
    return mentioned | linked


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_paths_in_the_documentation_exist(page: Path) -> None:
    # A MyST link may leave out ".md"; what commands write is not in the repository.
    missing = [
        relative(path.resolve())
        for path in sorted(paths_in(page))
        if not path.exists() and not path.with_name(path.name + ".md").exists()
    ]
    assert not missing


def commands_in(page: Path, program: str) -> list[list[str]]:
    """Return the words that follow ``program`` wherever a page's code calls it."""
    lines = (line.split("#")[0] for line in code_in(page.read_text()))
    calls = (
        re.match(rf"\s*\$?\s*(?:\.venv/bin/)?{program}\s+(.*)", line) for line in lines
    )
    return [match[1].split() for match in calls if match]


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_make_targets_in_the_documentation_exist(page: Path) -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z][a-z-]*):", makefile, re.MULTILINE))
    used = {
        word
        for words in commands_in(page, "make")
        for word in words
        if re.fullmatch(r"[a-z][a-z-]*", word)
    }
    assert used <= targets


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_lemma_commands_in_the_documentation_exist(page: Path) -> None:
    wrong = []
    for words in commands_in(page, "lemma"):
        options = {word.split("=")[0].strip("[],") for word in words if "--" in word}
        verb = words[0] if re.fullmatch(r"[a-z][a-z-]*", words[0]) else ""
        known = options_of(verb)
        wrong += [f"lemma {verb} {option}" for option in options - known]
    assert not wrong


@cache
def options_of(verb: str) -> frozenset[str]:
    """Return the options of ``lemma VERB``; a verb that does not exist fails."""
    code = "from lemma.cli.main import main; main()"
    done = run_python("-c", code, *([verb] if verb else []), "--help")
    assert done.returncode == 0, f"lemma {verb}: {done.stdout}{done.stderr}"
    return frozenset(re.findall(r"--[a-z][a-z-]*", done.stdout)) | {"--help"}


def run_python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=False
    )


def test_no_path_of_a_developers_machine() -> None:
    pattern = re.compile(r"(?<![\w.:/-])/(?:home|Users|root)/\w+")
    found = [
        f"{relative(path)}: {match[0]}"
        for path in (*PYTHON_FILES, *PAGES, ROOT / "Makefile", ROOT / "pyproject.toml")
        for match in pattern.finditer(path.read_text())
    ]
    assert not found
