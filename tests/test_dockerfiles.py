"""The files that images are built from exist; tests lack the Docker to build them."""

import json
import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

from test_repository import ROOT, options_of, pins

DOCKERFILES = [ROOT / "Dockerfile", ROOT / "integrations/vla_eval/Dockerfile"]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
    "optional-dependencies"
]


def instructions(path: Path) -> list[tuple[str, str]]:
    """Return the instructions of a Dockerfile: what to do, with what."""
    lines = [line for line in path.read_text().splitlines() if line[:1] != "#"]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [
        (word, rest.strip())
        for word, _, rest in (line.partition(" ") for line in joined.splitlines())
        if word
    ]


def sources(path: Path) -> list[str]:
    """Return what is copied out of the repository."""
    copied = [rest.split()[:-1] for word, rest in instructions(path) if word == "COPY"]
    return [name for names in copied for name in names]


@pytest.mark.parametrize("path", DOCKERFILES, ids=lambda path: path.parent.name)
def test_what_is_copied_exists_and_is_not_ignored(path: Path) -> None:
    rules = (ROOT / ".dockerignore").read_text().splitlines()
    kept = [rule[1:] for rule in rules if rule.startswith("!")]
    assert "*" in rules
    for name in sources(path):
        assert (ROOT / name).exists(), name
        assert any(f"{name}/".startswith(f"{one}/") for one in kept), name


@pytest.mark.parametrize("path", DOCKERFILES, ids=lambda path: path.parent.name)
def test_a_package_that_is_built_has_all_that_it_is_built_from(path: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {"pyproject.toml", project["project"]["readme"], "constraints.txt"}
    needed |= {"src", *wheel["force-include"]}
    found = sources(path)
    for name in needed:
        assert any(fnmatch(name, one) or name.startswith(f"{one}/") for one in found)


@pytest.mark.parametrize("path", DOCKERFILES, ids=lambda path: path.parent.name)
def test_versions_are_the_pinned_ones_and_places_are_the_users(path: Path) -> None:
    text = path.read_text()
    for name, version in re.findall(r"([\w-]+)==([\w.+]+)", text):
        assert pins()[name] == version
    for extras in re.findall(r"\.\[([\w,]+)\]", text):
        assert set(extras.split(",")) <= set(EXTRAS)
    assert "://" not in text


def test_what_runs_in_the_image_is_a_command_with_such_options() -> None:
    found = dict(instructions(ROOT / "Dockerfile"))
    words = json.loads(found["ENTRYPOINT"]) + json.loads(found["CMD"])
    assert words[:2] == ["lemma", "play"]
    assert found["EXPOSE"] == words[words.index("--port") + 1]
    commands = [" ".join(words)]
    for word, rest in instructions(ROOT / "Dockerfile"):
        commands += [c.strip() for c in rest.split("&&") if word == "RUN"]
    for command in commands:
        if command.startswith("lemma "):
            verb, *options = command.split()[1:]
            given = {option for option in options if option.startswith("--")}
            assert given <= options_of(verb), command
