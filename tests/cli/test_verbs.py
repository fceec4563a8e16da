import errno
import io
import json
import re
import sys
from pathlib import Path

import pytest
from command import run
from interpreter import python, told_without

from lemma import __version__
from lemma.cli import main as command
from lemma.cli.main import VERBS
from lemma.cli.options import messages, output
from lemma.tasks.suite import SUITE


@pytest.mark.parametrize("verb", VERBS)
def test_help_says_what_a_verb_does(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(verb, "--help") == 0
    text = capsys.readouterr().out
    assert f"usage: lemma {verb}" in text
    assert command.summary_of(verb) in " ".join(text.split())
    assert "None" not in text


@pytest.mark.parametrize("words", [["--help"], []])
def test_help_lists_every_verb(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*words) == 0
    text = capsys.readouterr().out
    assert re.findall(r"^  ([a-z-]+) ", text, re.MULTILINE) == list(VERBS)
    told = " ".join(text.split())
    assert all(f"{verb} {command.summary_of(verb)}" in told for verb in VERBS)


LIGHT = [
    *(["--help"], ["--version"], ["evalaute"]),
    *(["evaluate", "--help"], ["serve", "--help"], ["doctor", "--help"]),
]
HEAVY = {"mujoco", "numba", "scipy", "pyarrow", "av", "PIL", "torch", "matplotlib"}


def test_what_runs_nothing_imports_nothing() -> None:
    code = (
        "import sys\n"
        "from lemma.cli.main import main\n"
        f"for words in {LIGHT}:\n"
        "    try: main(words)\n"
        "    except SystemExit: pass\n"
        "    print('loaded', *sys.modules, file=sys.stderr)"
    )
    done = python("-c", code)
    told = [line for line in done.stderr.splitlines() if line.startswith("loaded ")]
    asked: set[str] = set()
    for words, line in zip(LIGHT, told, strict=True):
        loaded = set(line.split())
        assert "lemma.cli.main" in loaded
        assert loaded & HEAVY == set()
        verbs = {v for v in VERBS if f"lemma.cli.{v.replace('-', '_')}" in loaded}
        asked |= set(words) & set(VERBS)
        assert verbs == asked


@pytest.mark.slow
def test_results_are_made_without_an_encoder_of_videos() -> None:
    assert told_without(("av",), "import lemma.cli.reproduce") == ""


@pytest.mark.parametrize(
    ("typed", "meant"), [("evalaute", "evaluate"), ("task", "tasks")]
)
def test_a_misspelled_verb_is_understood(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(typed, "--policy", "oracle") == 2
    assert f"Did you mean '{meant}'?" in capsys.readouterr().err


def test_completion_of_the_shell(capsys: pytest.CaptureFixture[str]) -> None:
    assert not run("--tyro-print-completion", "bash")
    text = capsys.readouterr().out
    assert all(verb in text for verb in VERBS)
    assert "--perturb-start" in text


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version") == 0
    assert capsys.readouterr().out == f"lemma {__version__}\n"


def test_tasks_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("tasks", "--json") == 0
    records = json.loads(capsys.readouterr().out)
    assert [record["task"] for record in records] == list(SUITE)
    by_name = {record["task"]: record for record in records}
    assert by_name["hook_stack"]["stick"] is True
    assert by_name["hook_stack"]["subtasks"] == 7
    assert by_name["pass"]["stick"] is False
    for record in records:
        few, many = record["distractors"]
        assert record["objects"][1] - record["objects"][0] == many - few
        assert record["gym_id"].startswith("lemma/")
        assert "{" in record["high_level"]


def test_tasks_as_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("tasks") == 0
    text = capsys.readouterr().out
    assert all(name in text for name in SUITE)


@pytest.mark.parametrize(
    "words", [["swim"], ["show"], ["show", "stack", "--index", "three"]]
)
def test_arguments_that_cannot_be_parsed(words: list[str]) -> None:
    assert run(*words) == 2


@pytest.mark.parametrize(
    ("missing", "remedy"),
    [("numba", "--force-reinstall lemma-bench"), ("torch", "'lemma-bench[learn]'")],
)
def test_an_incomplete_installation_is_explained(
    missing: str,
    remedy: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)

    monkeypatch.setattr(command, "import_module", fail)
    assert run("tasks") == 2
    assert remedy in capsys.readouterr().err


WITHOUT_TORCH = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "safetensors"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from lemma.cli.main import main
for policy in ("reachnt", "reachnet"):
    try:
        main(["evaluate", "--policy", policy, *sys.argv[1:]])
    except SystemExit as end:
        print(end.code)
"""


@pytest.mark.slow
def test_a_misspelled_policy_is_understood_without_torch(tmp_path: Path) -> None:
    done = python("-c", WITHOUT_TORCH, "--out", tmp_path / "out", "--episodes", "1")
    assert done.stdout == "2\n2\n"
    misspelled, _ = done.stderr.split("'lemma-bench[learn]'")
    assert "Did you mean 'reachnet'?" in misspelled
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "encoding", "errors"),
    [
        (["tasks"], "latin-1", "strict"),
        (["tasks"], "ascii", "surrogateescape"),
        (["tasks", "--json"], "latin-1", "strict"),
        (["show", "–"], "latin-1", "strict"),
    ],
)
def test_a_locale_that_lacks_letters_gets_others(
    words: list[str], encoding: str, errors: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    streams = {
        name: io.TextIOWrapper(io.BytesIO(), encoding, errors)
        for name in ("stdout", "stderr")
    }
    for name, stream in streams.items():
        monkeypatch.setattr(sys, name, stream)
    assert run(*words) == (2 if "show" in words else 0)
    for stream in streams.values():
        stream.flush()
    text = b"".join(one.buffer.getvalue() for one in streams.values()).decode("latin-1")
    if "--json" in words:
        assert json.loads(text)
    else:
        assert "?" in text


class Full(io.StringIO):
    """A stream to a disk without space."""

    def write(self, text: str) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("words", [["--help"], ["tasks", "--help"]])
def test_an_output_that_is_closed_or_full_is_no_traceback(
    words: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert run(*words) == 0
    sys.stdout.close()
    monkeypatch.setattr(sys, "stdout", Full())
    assert run(*words) == 2
    assert "No space left" in capsys.readouterr().err


def test_brackets_of_a_path_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    for console in (output(), messages()):
        console.print("out/[draft] run[/x]", style="bold", soft_wrap=True)
    printed = capsys.readouterr()
    assert printed.out == printed.err == "out/[draft] run[/x]\n"
