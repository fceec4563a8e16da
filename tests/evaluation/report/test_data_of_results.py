"""Data that rows were trained on, rebuilt from the published digests of episodes."""

from dataclasses import replace
from pathlib import Path

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
from lemma.evaluation.report.policy_results import entries_of
from lemma.policies.training.run import digests_of
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.instance import BENCHMARK_VERSION
from lemma.tasks.names import SUITE

RESULTS = Path(__file__).parents[3] / "results" / "reachnet"
VERSIONS = {"mujoco": "3.17.0", "numpy": "2.5.2", "numba": "0.68.0"}
"""Software of the machines that rendered the data."""


def content() -> dict[str, str]:
    """Return the digest of the episodes in each file of the rendered suite."""
    return {
        f"{part}/{split}/{task}-{first // ROW_GROUP:03d}.arrow": content_digest(
            digests[first : first + ROW_GROUP]
        )
        for split in ("train", "val", "test")
        for task in SUITE
        for digests in [expected_digests(task, split)]
        for first in range(0, len(digests), ROW_GROUP)
        for part in ("maps", "cameras")
    }


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_all_seeds_were_trained_on_the_demonstrations_of_this_package(
    seed: int,
) -> None:
    recorded = read_json(RESULTS / f"seed-{seed}.json")["about"]["weights"]["reachnet"]
    data = recorded["data"]
    versions = {"format": FORMAT_VERSION, "benchmark": BENCHMARK_VERSION} | VERSIONS
    about = KeyframeForm().header(versions | {"lemma": VERSION}).about()
    about |= {"renderer": data["renderer"], "entities": list(ENTITIES)}
    rebuilt = digests_of(about, content())
    assert {name: data[name] for name in rebuilt} == rebuilt


def test_seeds_share_their_data() -> None:
    def trained(seed: int, **data: str) -> Result:
        made = result(6, seed=seed)
        weights = {"reachnet": {**made.about["weights"]["reachnet"], "data": data}}
        return replace(made, about={**made.about, "weights": weights})

    first = trained(0, digest="a", renderer="one card", of_any_renderer="e")
    # The digest covers the card that rendered the images; the other one does not.
    entries_of([first, trained(1, digest="b", renderer="another", of_any_renderer="e")])
    for other in (
        trained(1, digest="b", renderer="one card", of_any_renderer="e"),
        trained(1, digest="b", renderer="another", of_any_renderer="f"),
        trained(1, digest="b", renderer="another"),
    ):
        with pytest.raises(DatasetError, match="other data"):
            entries_of([first, other])
