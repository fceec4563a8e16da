"""Plugins are imported once, wherever they are named; a bad one says what is wrong."""

import os
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from own_plugins import loaded

from lemma.core import plugins
from lemma.core.errors import PluginError
from lemma.core.plugins import ENVIRONMENT, load_plugins, split_names
from lemma.core.workers.pool import ProcessPool

came: list[str] = []
"""The plugins of these tests add to this when they are imported."""
CODE = f"import {__name__}\n{__name__}.came.append(__name__)\n"


def write(path: Path, code: str) -> Path:
    path.write_text(code)
    return path


@pytest.fixture(autouse=True)
def nothing_loaded():
    came.clear()
    with loaded():
        yield


def test_a_file_is_loaded_once(tmp_path: Path) -> None:
    path = write(tmp_path / "03-mine.py", CODE)
    assert load_plugins([str(path)]) == load_plugins([str(path)]) == (str(path),)
    assert len(came) == 1


def test_a_module_of_the_current_folder_is_found(tmp_path, monkeypatch) -> None:
    write(tmp_path / "plugin_of_this_test.py", CODE)
    monkeypatch.chdir(tmp_path)
    assert load_plugins(["plugin_of_this_test"]) == ("plugin_of_this_test",)
    assert came == ["plugin_of_this_test"]


@pytest.mark.parametrize("folder", ["lab", "lab, room 2"])
def test_the_environment_names_plugins_and_hands_them_on(
    tmp_path, monkeypatch, folder: str
) -> None:
    (tmp_path / folder).mkdir()
    first, second = (write(tmp_path / folder / f"{name}.py", "") for name in "ab")
    monkeypatch.setenv(ENVIRONMENT, f"{first}" if "," in folder else f" {first}, ")
    load_plugins([str(second)])
    assert split_names(os.environ[ENVIRONMENT]) == [str(first), str(second)]


def names_of_loaded() -> list[str]:
    return list(plugins._loaded)


@pytest.mark.slow
def test_workers_load_them_too(tmp_path: Path) -> None:
    (tmp_path / "lab, room 2").mkdir()
    path = write(tmp_path / "lab, room 2" / "mine.py", "")
    load_plugins([str(path)])
    assert list(ProcessPool(1).run(names_of_loaded, [()])) == [[str(path)]]


def test_installed_distributions_bring_their_own(tmp_path, monkeypatch) -> None:
    write(tmp_path / "installed_plugin.py", CODE)
    monkeypatch.syspath_prepend(tmp_path)
    entry = EntryPoint("anything", "installed_plugin", plugins.GROUP)
    monkeypatch.setattr(plugins, "_installed", lambda: (entry,))
    assert load_plugins() == ("installed_plugin",)
    assert came == ["installed_plugin"]


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("\n1/0", r"ZeroDivisionError: division by zero \(.*bad\.py, line 2\)"),
        ("import nothing_such", "ModuleNotFoundError: No module named 'nothing_such'"),
        ("def", "SyntaxError"),
        ("import sys\nsys.exit()", "it ends the process .* if __name__"),
    ],
)
def test_a_bad_one_is_named_with_the_reason(tmp_path, code: str, why: str) -> None:
    path = write(tmp_path / "bad.py", code)
    with pytest.raises(PluginError, match=rf"plugin .*bad\.py cannot be loaded: {why}"):
        load_plugins([str(path)])
    assert load_plugins() == ()


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("nowhere.py", "there is no file"),
        ("no_such_module", "No module named"),
        ("folder_of_this_test", "the folder has no __init__"),
        ("file.json", "the file is no Python module: .* ends with .py"),
    ],
)
def test_a_missing_one_is_named(name: str, why: str, tmp_path, monkeypatch) -> None:
    (tmp_path / "folder_of_this_test").mkdir()
    (tmp_path / "file.json").write_text("{}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PluginError, match=f"plugin {name} cannot be loaded: .*{why}"):
        load_plugins([name])
    assert load_plugins() == ()
