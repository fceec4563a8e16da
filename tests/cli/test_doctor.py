import json
import sys
import tomllib
from pathlib import Path

import pytest
from command import run
from packaging.requirements import Requirement

from lemma.bench import checks, states
from lemma.core.errors import RenderingError
from lemma.env.control.modes import CONTROLS
from lemma.scene.rendering import gl_backend
from lemma.tasks.suite import SUITE

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
DEPENDENCIES = [Requirement(text) for text in PROJECT["project"]["dependencies"]]


@pytest.mark.render
def test_doctor_is_content_here(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("doctor", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is True
    names = [check["name"] for check in report["checks"]]
    assert len(set(names)) == len(names)
    assert {"python", "mujoco", "rendering", "physics and expert"} <= set(names)
    missing = [c["name"] for c in report["checks"] if not c["ok"]]
    assert [name for name in missing if not name.startswith("extra ")] == []


def test_doctor_says_what_is_wrong(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def nothing_renders() -> None:
        raise RenderingError("No OpenGL here. Install [libegl1].")

    monkeypatch.setattr(gl_backend, "choose_backend", nothing_renders)
    assert run("doctor") == 1
    text = capsys.readouterr().out
    assert "FAILED" in text
    assert "Install [libegl1]" in text


def test_what_cannot_be_imported_is_an_answer(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setitem(sys.modules, "lemma.env.simulation", None)
    assert run("doctor", "--json") == 1
    report = json.loads(capsys.readouterr().out)
    failed = {c["name"]: c for c in report["checks"] if not c["ok"]}
    assert {"physics and expert", "video encoder"} <= set(failed)
    assert "cannot be imported" in failed["video encoder"]["found"]
    assert "--force-reinstall" in failed["video encoder"]["advice"]


def test_what_is_not_essential_does_not_fail(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [
        checks.Check("python", True, "3.11"),
        checks.Check("encoder", False, "missing", "install it", essential=False),
    ]
    monkeypatch.setattr("lemma.cli.doctor.run_checks", lambda **_: found)
    assert run("doctor") == 0
    assert "install it" in capsys.readouterr().out


def test_every_extra_is_listed_with_what_it_needs() -> None:
    extras = PROJECT["project"]["optional-dependencies"]
    listed = {check.name: check.found for check in checks.run_checks()[-len(extras) :]}
    for extra in set(extras) - {"dev", "docs"}:
        for requirement in map(Requirement, extras[extra]):
            name = requirement.name.replace("_", "-")
            assert name in listed[f"extra {extra}"].replace("_", "-")


def test_versions_are_those_of_the_project() -> None:
    needed = {requirement.name for requirement in DEPENDENCIES}
    assert needed == {"mujoco", *checks.PACKAGES}
    engine = next(r for r in DEPENDENCIES if r.name == "mujoco")
    assert engine.specifier.contains(f"{checks.ENGINE}.0")
    pythons = PROJECT["project"]["requires-python"]
    (low, end) = (".".join(map(str, version)) for version in checks.PYTHONS)
    assert pythons == f">={low},<{end}"


def test_every_mode_and_task_has_hashes() -> None:
    expected = states.expected_hashes()
    assert set(expected) == {
        f"{mode}/{task}" for mode in (states.SKILL, *CONTROLS) for task in SUITE
    }
    assert {case.mode for case in states.fast_cases()} == {states.SKILL, *CONTROLS}
    assert {case.task for case in states.fast_cases()} == set(SUITE)


@pytest.mark.slow
def test_every_mode_and_task_repeats_its_hashes() -> None:
    assert states.differing(states.all_cases()) == []


def test_states_that_differ_are_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    changed = states.expected_hashes() | {"joint_velocity/pass": ["0" * 16] * 2}
    cases = [states.Case(mode, "pass") for mode in ("joint_position", "joint_velocity")]
    monkeypatch.setattr(states, "expected_hashes", lambda: changed)
    monkeypatch.setattr(states, "fast_cases", lambda: cases)
    (check,) = (one for one in checks.run_checks() if one.name == "same states")
    assert not check.ok
    assert not check.essential
    assert check.found == "1 of 2 cases differ: joint_velocity/pass"
