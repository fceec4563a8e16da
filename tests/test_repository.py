"""Rules for the repository as a whole: budgets, imports, pins, documentation."""

import ast
import io
import re
import tomllib
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest
from interpreter import python, told_without
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import lemma
from lemma.cli import main
from lemma.core.kernels import NOTICE
from lemma.core.plugins import GROUP as ENTRY_POINTS

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
PYTHON_FILES = SOURCES + sorted(
    path
    for folder in ("tests", "examples", "scripts", "docs", "integrations")
    for path in (ROOT / folder).rglob("*.py")
)
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
"""Pages that describe the present; the changelog names what is gone, too."""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

MAX_FILE_LINES = 400
LONGER_FILES = (
    *("audit/control/row.py", "audit/control/stick.py", "serve/conversation.py"),
    *("dataset/lerobot/export.py", "dataset/rendered/dataset.py"),
    *("dataset/teleoperation.py", "env/stages.py", "evaluation/report/sections.py"),
    *("evaluation/report/tables.py", "policies/models/cliport/model.py"),
    *("policies/models/cliport/networks.py", "policies/models/episodic_transformer.py"),
    *("policies/models/reachnet/grounder.py", "policies/models/reachnet/planner.py"),
    "core/workers/pool.py",
    *("env/test_bad_input.py", "serve/test_sockets.py"),
    "evaluation/run/test_fault_isolation.py",
)
"""These have more, up to :data:`MAX_LONGER_LINES`."""
MAX_LONGER_LINES = 500
MAX_FUNCTION_LINES = 60
MAX_MODULES = 12
"""In one folder, ``__init__.py`` apart."""
VERBS = "src/lemma/cli"
"""Has a file for each verb of the command, however many there are."""
VAGUE_NAMES = {"utils", "util", "helpers", "helper", "misc", "common"}
LATE_IMPORTS = ("import_module", "__import__")
TOP_FOLDERS = ("src", "tests", "examples", "docs", "scripts", "integrations", ".ci")


@cache
def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def text_of(path: Path) -> str:
    return path.read_text()


def test_files_are_short() -> None:
    sizes = {relative(path): len(text_of(path).splitlines()) for path in PYTHON_FILES}
    long = {name: lines for name, lines in sizes.items() if lines > MAX_FILE_LINES}
    assert {n for n in long if not n.endswith(LONGER_FILES)} == set(), "split them"
    assert max(long.values()) <= MAX_LONGER_LINES, long


def test_files_are_named_by_a_noun() -> None:
    vague = [relative(path) for path in PYTHON_FILES if path.stem in VAGUE_NAMES]
    assert vague == [], "name them after what they hold"


def test_functions_are_short() -> None:
    too_long = {
        f"{relative(path)}:{node.lineno} {node.name}": lines
        for path in SOURCES
        for node in ast.walk(ast.parse(text_of(path)))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (lines := (node.end_lineno or 0) - node.lineno + 1) > MAX_FUNCTION_LINES
    }
    assert too_long == {}


def counted_modules(folder: Path) -> int:
    modules = [path for path in folder.glob("*.py") if path.stem != "__init__"]
    beside_verbs = [m for m in modules if m.stem not in verb_modules()]
    return len(beside_verbs if relative(folder) == VERBS else modules)


def test_folders_are_small() -> None:
    folders = sorted({path.parent for path in SOURCES})
    sizes = {relative(folder): counted_modules(folder) for folder in folders}
    too_many = {name: size for name, size in sizes.items() if size > MAX_MODULES}
    assert too_many == {}, "give what belongs together a sub-package"


def test_folders_of_tests_are_small() -> None:
    folders = {path.parent for path in (ROOT / "tests").rglob("test_*.py")}
    sizes = {relative(f): len(list(f.glob("*.py"))) for f in folders}
    assert {name: size for name, size in sizes.items() if size > MAX_MODULES + 2} == {}


def verb_modules() -> set[str]:
    return {verb.replace("-", "_") for verb in main.VERBS}


def modules_imported_by_string(path: Path) -> list[str]:
    """Return modules of this package that a file imports by a constant string."""
    if not any(name in text_of(path) for name in LATE_IMPORTS):
        return []
    calls = (
        node
        for node in ast.walk(ast.parse(text_of(path)))
        if isinstance(node, ast.Call)
    )
    return [
        str(call.args[0].value)
        for call in calls
        if ast.unparse(call.func).rpartition(".")[2] in LATE_IMPORTS
        and call.args
        and isinstance(call.args[0], ast.Constant)
        and str(call.args[0].value).startswith("lemma")
    ]


def test_no_layer_is_dodged_by_a_string() -> None:
    # import-linter and mypy see what is written as an import, and nothing else. Only
    # the two entrances of the package import late by name, from above all layers.
    entrances = ("src/lemma/__init__.py", "src/lemma/registration.py")
    dodging = {
        relative(path): names
        for path in SOURCES
        if relative(path) not in entrances
        and (names := modules_imported_by_string(path))
    }
    assert dodging == {}


def test_names_are_taken_apart_in_one_place() -> None:
    homes = ("core/robot_names.py", "scene/objects/entity.py")
    apart = re.compile(
        r"""f"robot_\{|removeprefix\("robot_|r?partition\("_"\)"""
        r"""|(?:endswith|removesuffix)\(\(?"_?(?:cube|pad|stick)"""
    )
    found = [
        relative(path)
        for path in SOURCES
        if apart.search(text_of(path)) and not relative(path).endswith(homes)
    ]
    assert found == []


def test_every_folder_of_sources_is_a_package() -> None:
    folders = {path.parent for path in SOURCES} - {ROOT / "src"}
    assert [f for f in sorted(folders) if not (f / "__init__.py").exists()] == []
    assert (ROOT / "src/lemma/py.typed").exists()


def test_test_files_have_different_names() -> None:
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert len(names) == len(set(names))


def test_import_is_silent_and_light() -> None:
    heavy = ("torch", "mujoco", "numba", "scipy", "pettingzoo")
    assert told_without(heavy, "import lemma") == ""


def test_public_names_stand_on_a_page_of_the_api() -> None:
    told = set(re.findall(r"lemma\.(\w+)", text_of(ROOT / "docs/api.md")))
    assert set(vars(lemma)["__all__"]) - {"__version__"} <= told


def test_version_is_the_same_everywhere() -> None:
    assert PROJECT["version"] == lemma.__version__
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {lemma.__version__}\n" in citation
    assert f"## [{lemma.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


UNPINNED = ("track", "schedule")
"""Extras that no target of the Makefile installs; the versions are the user's."""
APART = ("lerobot",)
"""Extras for an environment of their own, whose versions exclude ours."""


def requirements() -> list[Requirement]:
    every = PROJECT["optional-dependencies"]
    extras = [group for name, group in every.items() if name not in UNPINNED + APART]
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


def is_pinned_within_its_range(requirement: Requirement) -> bool:
    pinned = pins().get(canonicalize_name(requirement.name))
    return pinned is not None and requirement.specifier.contains(Version(pinned))


def test_dependencies_are_pinned_within_their_ranges() -> None:
    assert requirements()
    wrong = [str(one) for one in requirements() if not is_pinned_within_its_range(one)]
    assert wrong == []


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
    text = text_of(page)
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


def test_paths_in_the_documentation_exist() -> None:
    # A MyST link may leave out ".md"; what commands write is not in the repository.
    missing = [
        f"{relative(page)}: {path}"
        for page in PAGES
        for path in sorted(paths_in(page))
        if not path.exists() and not path.with_name(path.name + ".md").exists()
    ]
    assert missing == []


def commands_in(page: Path, program: str) -> list[list[str]]:
    """Return the words that follow ``program`` wherever a page's code calls it."""
    lines = (line.split("#")[0] for line in code_in(text_of(page)))
    calls = (
        re.match(rf"\s*\$?\s*(?:\.venv/bin/)?{program}\s+(.*)", line) for line in lines
    )
    return [match[1].split() for match in calls if match]


def python_names_in(page: Path) -> set[str]:
    names = re.findall(r"(?<![\w./-])lemma(?:\.[A-Za-z_]\w*)+(?![\w/-])", text_of(page))
    return set(names) - {ENTRY_POINTS}


def test_python_names_in_the_documentation_exist() -> None:
    wrong = [
        f"{relative(page)}: {name}"
        for page in PAGES
        for name in sorted(python_names_in(page))
        if not resolves(name)
    ]
    assert wrong == []


@cache
def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(found, part):
                return part in getattr(found, "__annotations__", ())
            found = getattr(found, part)
        return True
    return False


@pytest.mark.slow
def test_the_life_of_an_episode_runs_as_printed() -> None:
    page = (ROOT / "docs/concepts.md").read_text()
    code = (
        page.split("## Life of an episode")[1].split("```python\n")[1].split("```")[0]
    )
    done = python("-W", "error", "-c", code)
    assert (done.returncode, done.stderr.replace(NOTICE, "")) == (0, "")
    assert done.stdout.startswith("True ["), done.stdout


def test_make_targets_in_the_documentation_exist() -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z][a-z-]*):", makefile, re.MULTILINE))
    wrong = [
        f"{relative(page)}: make {word}"
        for page in PAGES
        for words in commands_in(page, "make")
        for word in words
        if re.fullmatch(r"[a-z][a-z-]*", word) and word not in targets
    ]
    assert wrong == []


def wrong_words(all_words: list[str]) -> list[str]:
    """Return the plugins and options of a call of ``lemma`` that do not exist."""
    words, plugins = main.split_plugins(all_words)
    options = {word.split("=")[0].strip("[],") for word in words if "--" in word}
    verb = words[0] if re.fullmatch(r"[a-z][a-z-]*", words[0]) else ""
    missing = [plugin for plugin in plugins if not (ROOT / plugin).exists()]
    return [f"lemma {verb} {word}" for word in (*missing, *options - options_of(verb))]


def test_lemma_commands_in_the_documentation_exist() -> None:
    wrong = [
        f"{relative(page)}: {found}"
        for page in PAGES
        for words in commands_in(page, "lemma")
        for found in wrong_words(words)
    ]
    assert wrong == []


@cache
def options_of(verb: str) -> frozenset[str]:
    """Return the options of ``lemma VERB``; a verb that does not exist fails."""
    out = io.StringIO()
    with redirect_stdout(out), pytest.raises(SystemExit) as end:
        main.main([*([verb] if verb else []), "--help"])
    assert not end.value.code, f"lemma {verb}: {out.getvalue()}"
    printed = re.findall(r"--[a-z][a-z.-]*", out.getvalue())
    return frozenset(printed) | {"--help", "--tyro-print-completion"}


def test_no_path_of_a_developers_machine() -> None:
    pattern = re.compile(r"(?<![\w.:/-])/(?:home|Users|root)/\w+")
    found = [
        f"{relative(path)}: {match[0]}"
        for path in (*PYTHON_FILES, *PAGES, ROOT / "Makefile", ROOT / "pyproject.toml")
        for match in pattern.finditer(text_of(path))
    ]
    assert not found
