"""What the page about policies says of sizes is true."""

import re
from pathlib import Path

import pytest

from lemma.policies.zoo import MODELS, make_model

PAGE = (Path(__file__).parents[2] / "docs" / "policies.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", list(MODELS))
def test_the_page_gives_the_size_of_every_model(name: str) -> None:
    (said,) = re.findall(rf"^\| `{name}` \|.*\| ([0-9.]+) \|$", PAGE, re.MULTILINE)
    count = sum(weight.numel() for weight in make_model(name, {}).parameters())
    assert said == f"{count / 1e6:.1f}"
    # In 16 bits, what ships has at most 35 MB.
    assert 2 * count < 35e6
