"""Data that rows were trained on, rebuilt from the published digests of episodes."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from made_up import result

from lemma.core.errors import DatasetError
from lemma.core.files import read_json
from lemma.core.version import VERSION
from lemma.dataset.files import content_digest
from lemma.dataset.recipe.files import ROW_GROUP
from lemma.dataset.recipe.replay import expected_digests
from lemma.dataset.recipe.schema import FORMAT_VERSION
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.evaluation.analysis.result import Result
from lemma.evaluation.experiments.catalog import CONTROL_LEVEL, EXPERIMENTS
from lemma.evaluation.report.policy_results import entries_of
from lemma.policies.training.run import digests_of
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.instance import BENCHMARK_VERSION
from lemma.tasks.names import SUITE

RESULTS = Path(__file__).parents[3] / "results"
SPLITS = ("train", "val", "test")
VERSIONS = {"mujoco": "3.17.0", "numpy": "2.5.2", "numba": "0.68.0"}
"""Software of the machines that rendered the data."""


@cache
def content(splits: tuple[str, ...]) -> dict[str, str]:
    """Return the digest of the episodes in each file of rendered splits."""
    return {
        f"{part}/{split}/{task}-{first // ROW_GROUP:03d}.arrow": content_digest(
            digests[first : first + ROW_GROUP]
        )
        for split in splits
        for task in SUITE
        for digests in [expected_digests(task, split)]
        for first in range(0, len(digests), ROW_GROUP)
        for part in ("maps", "cameras")
    }


LEARNED = [
    pytest.param(weights["data"], id=f"{path.parent.name}, {path.stem}, {name}")
    for path in sorted(RESULTS.glob("*/seed-*.json"))
    for name, weights in read_json(path)["about"]["weights"].items()
    # Those of rungs learn from other demonstrations.
    if EXPERIMENTS[path.parent.name].suite != CONTROL_LEVEL
]


@pytest.mark.parametrize("data", LEARNED)
def test_all_rows_were_trained_on_the_demonstrations_of_this_package(
    data: dict[str, Any],
) -> None:
    versions = {"format": FORMAT_VERSION, "benchmark": BENCHMARK_VERSION} | VERSIONS
    about = KeyframeForm().header(versions | {"lemma": VERSION}).about()
    about |= {"renderer": data["renderer"], "entities": list(ENTITIES)}
    # Some had split test in the folder, too, which training does not read.
    rebuilt = [
        digests_of(about, content(splits), SPLITS[:2])
        for splits in (SPLITS, SPLITS[:2])
    ]
    assert {name: data[name] for name in rebuilt[0]} in rebuilt


def test_the_digest_that_seeds_share_leaves_out_splits_that_are_not_read() -> None:
    shares = {
        digests_of({"renderer": card}, content(splits), SPLITS[:2])["of_any_renderer"]
        for card, splits in (("one", SPLITS), ("another", SPLITS[:2]))
    }
    assert len(shares) == 1
    assert digests_of({}, content(SPLITS), SPLITS)["of_any_renderer"] not in shares


def test_seeds_share_their_data() -> None:
    def trained(seed: int, **data: str) -> Result:
        made = result(6, seed=seed)
        weights = {"reachnet": {**made.about["weights"]["reachnet"], "data": data}}
        return replace(made, about={**made.about, "weights": weights})

    first = trained(0, digest="a", renderer="one card", of_any_renderer="e")
    # The digest covers the card that rendered the images, and splits that training
    # does not read; the other one does not.
    for card in ("one card", "another"):
        same = trained(1, digest="b", renderer=card, of_any_renderer="e")
        entries_of([first, same])
    entries_of([first, trained(1, digest="a", renderer="one card")])
    for other in (
        trained(1, digest="a", renderer="one card", of_any_renderer="f"),
        trained(1, digest="b", renderer="another", of_any_renderer="f"),
        trained(1, digest="b", renderer="one card"),
        trained(1, digest="a", renderer="another"),
    ):
        with pytest.raises(DatasetError, match="other data"):
            entries_of([first, other])
