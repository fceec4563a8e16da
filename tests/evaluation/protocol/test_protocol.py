"""The protocol: frozen, quoted, on its page, and never mixed with another."""

import json
from pathlib import Path
from typing import Any

import pytest
from made_up import result

from lemma.cli.evaluate import EvaluateOptions, evaluate
from lemma.cli.reproduce import reproduce
from lemma.cli.workers import Workers
from lemma.core.errors import DatasetError
from lemma.evaluation.protocol import rules as protocol
from lemma.evaluation.protocol.rules import (
    check_protocol,
    departures,
    frozen,
    in_force,
    quote,
    sha256_of_protocol,
)
from protocol import PAGE, text


def test_what_is_in_force_is_what_is_frozen() -> None:
    assert departures() == [], (
        "The protocol has changed. Name it anew, and: python scripts/protocol.py"
    )
    # As JSON reads it back.
    assert json.loads(json.dumps(in_force())) == frozen()
    assert sha256_of_protocol(frozen()) == quote()


def test_the_page_is_made_from_the_file() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert text(frozen()) == page, (
        "docs/protocol.md is out of date: python scripts/protocol.py"
    )
    assert quote() in page


def test_another_release_of_mujoco_is_another_protocol(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = quote()

    def another() -> dict[str, Any]:
        told = frozen()
        return {**told, "physics": {**told["physics"], "mujoco": "9.9.9"}}

    monkeypatch.setattr(protocol, "in_force", another)
    assert quote() != before
    (departure,) = departures()
    assert departure.startswith("physics.mujoco 9.9.9 instead of ")


def test_who_departs_is_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    told = {**frozen(), "name": "mine"}
    monkeypatch.setattr(protocol, "in_force", lambda: told)
    ask = EvaluateOptions(tasks="stack", episodes=1)
    assert evaluate("oracle", tmp_path, ask, Workers(workers=1)) == 0
    assert "name mine instead of lemma-v2" in capsys.readouterr().err
    about = json.loads((tmp_path / "about.json").read_text())
    assert about["protocol"] == sha256_of_protocol(told)


def test_nothing_is_played_beside_results_of_another_protocol(tmp_path: Path) -> None:
    made = result(3)
    made.write(tmp_path / "reachnet" / "seed-0.json")
    with pytest.raises(DatasetError, match="follows 555"):
        reproduce("oracle", tmp_path, working=Workers(workers=1))
    assert not (tmp_path / "oracle").exists()


@pytest.mark.parametrize("missing", [True, False])
def test_protocols_are_not_mixed(missing: bool) -> None:
    other = {} if missing else {"protocol": "6" * 64}
    with pytest.raises(DatasetError, match="here follows protocol 555"):
        check_protocol({"protocol": "5" * 64}, other, "here", "there")
    check_protocol(other, other, "here", "there")
