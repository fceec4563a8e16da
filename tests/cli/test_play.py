"""`lemma play`: its options, and refusals before a page opens."""

from pathlib import Path

import pytest

from lemma.core.errors import UnknownNameError, WeightsError
from lemma.policies.spec import ORACLE
from lemma.viewer.episode.session import choices
from lemma.viewer.episode.status import TOGETHER
from lemma.viewer.episode.teleoperator import BY_HAND


def test_expert_and_visitors_are_always_offered() -> None:
    assert choices()[-3:] == (ORACLE, TOGETHER, BY_HAND)


@pytest.mark.parametrize(
    "known", [ORACLE, BY_HAND, "my_module:MyPolicy", "ws://127.0.0.1:9"]
)
def test_wanted_one_is_among_them_once(known: str) -> None:
    assert choices(known).count(known) == 1


@pytest.mark.parametrize("unknown", ["nope", "reachnet+nope"])
def test_unknown_one_is_refused_before_the_page_opens(unknown: str) -> None:
    with pytest.raises(UnknownNameError, match="Unknown policy 'nope'"):
        choices(unknown)


def test_damaged_weights_are_refused_before_the_page_opens(tmp_path: Path) -> None:
    damaged = tmp_path / "weights.safetensors"
    damaged.write_bytes(b"no weights")
    with pytest.raises(WeightsError, match=str(damaged)):
        choices(str(damaged))
