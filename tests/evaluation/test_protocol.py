"""The protocol: frozen, quoted, on its page, and never mixed with another."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from lemma.core.errors import DatasetError
from lemma.evaluation import protocol
from lemma.evaluation.protocol import (
    check_protocol,
    departures,
    frozen,
    in_force,
    quote,
    sha256_of_protocol,
)

ROOT = Path(__file__).parents[2]


def test_what_is_in_force_is_what_is_frozen() -> None:
    assert departures() == [], (
        "The protocol has changed. Name it anew, and: python scripts/protocol.py"
    )
    # As JSON reads it back.
    assert json.loads(json.dumps(in_force())) == frozen()
    assert sha256_of_protocol(frozen()) == quote()


def test_the_page_is_made_from_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
    script = __import__("protocol")
    page = script.PAGE.read_text(encoding="utf-8")
    assert script.text(frozen()) == page, (
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


@pytest.mark.parametrize("missing", [True, False])
def test_protocols_are_not_mixed(missing: bool) -> None:
    other = {} if missing else {"protocol": "6" * 64}
    with pytest.raises(DatasetError, match="here follows protocol 555"):
        check_protocol({"protocol": "5" * 64}, other, "here", "there")
    check_protocol(other, other, "here", "there")
