"""Which policies a page offers."""

from importlib.util import find_spec

from lemma.evaluation.run.loading import weights_of
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.policies.weights import are_here
from lemma.viewer.episode.teleoperator import BY_HAND

_LEARNED = ("reachnet", "episodic-transformer+cliport", "m-cliport")


def choices(wanted: str | None = None) -> tuple[str, ...]:
    """Return names of policies that can be loaded here, the best one first.

    Args:
        wanted: One that shall be among them. Its weights are looked for; servers and
            classes are asked when it is loaded.

    Raises:
        LemmaError: The name of that one means no policy, or its weights are missing or
            damaged.
    """
    found = [*_installed(), ORACLE, BY_HAND]
    if wanted is not None and wanted not in found:
        weights_of(PolicySpec(wanted))
        found.append(wanted)
    return tuple(found)


def _installed() -> list[str]:
    """Return learned policies whose weights are on this machine."""
    if find_spec("torch") is None:
        return []
    return [name for name in _LEARNED if all(map(are_here, name.split("+")))]
