"""The pages about policies and training tell the truth about models."""

import re
from pathlib import Path

import pytest

from lemma.policies.models.catalog import MODELS, make_model
from lemma.policies.training.config import DEFAULTS

DOCS = Path(__file__).parents[2] / "docs"
# Not all that is in the table: tests add models of their own.
NAMES = (
    *("episodic-transformer", "cliport", "m-cliport"),
    *("reachnet", "team-reachnet", "keypose"),
)


def row_of(page: str, name: str) -> list[str]:
    """Return the cells behind the name in the first table that has such a row."""
    text = (DOCS / page).read_text(encoding="utf-8")
    row, *_ = re.findall(rf"^\| `{name}` \|(.*)\|$", text, re.MULTILINE)
    return [cell.strip() for cell in row.split("|")]


def test_all_models_are_asked_for() -> None:
    assert set(NAMES) <= set(MODELS)
    assert set(NAMES) == set(DEFAULTS)


@pytest.mark.parametrize("name", NAMES)
def test_the_page_gives_the_size_of_every_model(name: str) -> None:
    count = sum(weight.numel() for weight in make_model(name, {}).parameters())
    assert row_of("policies.md", name)[-1] == f"{count / 1e6:.1f}"
    # In 16 bits, what ships has at most 35 MB.
    assert 2 * count < 35e6


@pytest.mark.parametrize("name", NAMES)
def test_the_page_says_how_every_model_is_trained(name: str) -> None:
    drawn, samples, batch, rate, chosen = row_of("training.md", name)
    defaults, model = DEFAULTS[name], MODELS[name][0]
    assert drawn == f"{model.unit}s"
    assert samples.partition(":")[0] == f"{defaults.samples:,}"
    assert int(batch) == defaults.batch_size
    assert float(rate) == defaults.learning_rate
    assert chosen == f"`{model.selection}`"
