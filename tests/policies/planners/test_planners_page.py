"""The page about planners prints examples that run, and every name there is."""

import re
from dataclasses import fields
from pathlib import Path

import pytest
from chat_server import chat_server
from interpreter import python

from lemma.policies.planners.answers import InvalidAnswer
from lemma.policies.planners.chat import ChatOptions
from lemma.policies.planners.registry import PLANNERS

PAGE = (Path(__file__).parents[3] / "docs/planners.md").read_text(encoding="utf-8")
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def test_the_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code = CODE[0].replace("episodes=10", "episodes=1")
    assert "http://127.0.0.1:8000/v1" in code
    assert len(code.splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    with chat_server() as server:
        exec(code.replace("http://127.0.0.1:8000/v1", server.url), {})
        assert server.requests[0]["model"] in code
    told = capsys.readouterr().out
    assert "| pass" in told
    assert "calls=3" in told
    assert (tmp_path / "out/run.jsonl").exists()


@pytest.mark.slow
def test_a_planner_of_ones_own_is_found_by_name(tmp_path: Path) -> None:
    (tmp_path / "idle.py").write_text(CODE[1])
    line = "evaluate --plugin idle.py --policy idle --split val --tasks pass"
    line += " --episodes 1 --workers 1 --out out"
    code = "from lemma.cli.main import main; main()"
    done = python("-c", code, *line.split(), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "0.0" in done.stdout


def test_names_on_the_page_are_all_that_there_are() -> None:
    shipped = {"llm", "random-valid", "greedy-reach", "noisy-oracle"}
    assert shipped <= set(PLANNERS)
    for name in (*shipped, *map(str, InvalidAnswer), "record", "replay", "strict"):
        assert re.search(rf"^\| `{name}[`:]", PAGE, re.MULTILINE), name
    defaults = ChatOptions()
    for field in fields(defaults):
        assert f"--{field.name.replace('_', '-')}" in PAGE
    assert f"; {defaults.tries}. |" in PAGE
    assert f"; {defaults.max_tokens}." in PAGE
    assert f"; {defaults.concurrency}." in PAGE
