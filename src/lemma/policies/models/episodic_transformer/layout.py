"""Frames of a batch laid out as episodes, and features of views seen before."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from lemma.env.view import View
from lemma.policies.batch import MAX_PAST, NOBODY, Batch, decision_numbers
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.interfaces import PolicyInput

SLOTS = MAX_PAST + 1
"""Frames of the longest history: one before each past decision, and the present."""


@dataclass(frozen=True, eq=False)
class TokenLayout:
    """Where each frame of a batch belongs; G episodes or parts of them, B frames."""

    episode: Tensor
    """Which of the G each frame belongs to, (B,) int64."""
    slot: Tensor
    """How many decisions of its episode came before each frame, (B,) int64."""
    actions: Tensor
    """Decisions of each episode, (G, MAX_PAST, 4) int64, padded with -1."""
    instructions: list[str]
    """One for each of the G."""
    foreseeable: Tensor
    """Whether all follows from the first frame, because nothing went wrong, (G,)
    bool."""

    @property
    def present(self) -> Tensor:
        """Which slots hold a frame, (G, SLOTS) bool."""
        found = self.episode.new_zeros(len(self.actions), SLOTS, dtype=torch.bool)
        found[self.episode, self.slot] = True
        return found


def of_batch(batch: Batch) -> TokenLayout:
    """Return how a labelled batch splits into episodes.

    Frames of one episode that follow one another are seen together, each knowing those
    before it. A frame whose predecessor is not before it in the batch starts anew: it
    knows what was done before, not what was seen.

    Args:
        batch: Frames in any order, with labels.
    """
    assert batch.labels is not None
    done = (batch.past[:, :, 1] != NOBODY).sum(1)
    numbers = torch.stack([batch.labels.episode, batch.labels.keyframe, done])
    rows = numbers.t().tolist()
    firsts: list[int] = []
    for i, (episode, keyframe, slot) in enumerate(rows):
        follows = i > 0 and rows[i - 1] == [episode, keyframe - 1, slot - 1]
        if not follows:
            firsts.append(i)
    lasts = [*(first - 1 for first in firsts[1:]), len(rows) - 1]
    sizes = [last - first + 1 for first, last in zip(firsts, lasts, strict=True)]
    device = batch.past.device
    return TokenLayout(
        episode=torch.arange(len(sizes), device=device).repeat_interleave(
            torch.tensor(sizes, device=device), output_size=len(rows)
        ),
        slot=done,
        actions=batch.past[torch.tensor(lasts, device=device)],
        instructions=[batch.instructions[first] for first in firsts],
        foreseeable=~batch.labels.perturbed[torch.tensor(firsts, device=device)],
    )


def of_inputs(
    inputs: Sequence[PolicyInput],
    device: torch.device,
    entities: EntitySet = BENCHMARK,
) -> tuple[TokenLayout, list[View], Tensor]:
    """Return how policies' inputs lie, with all that they saw.

    Args:
        inputs: One per episode.
        device: Where the tensors shall be.
        entities: Entities, in the order of their numbers.

    Returns:
        The layout; each view once; and which of them each frame of the layout shows.
    """
    views: dict[View, int] = {}
    episodes, slots, shown = [], [], []
    actions = torch.full((len(inputs), MAX_PAST, 4), NOBODY)
    for number, given in enumerate(inputs):
        steps = given.past[-MAX_PAST:]
        for slot, step in enumerate(steps):
            numbers = decision_numbers(step.subtask.to_dict(), entities)
            actions[number, slot] = torch.tensor(numbers)
        seen = [*(step.view for step in steps), given.view]
        for slot, view in enumerate(seen):
            episodes.append(number)
            slots.append(slot)
            shown.append(views.setdefault(view, len(views)))
    layout = TokenLayout(
        episode=torch.tensor(episodes, device=device),
        slot=torch.tensor(slots, device=device),
        actions=actions.to(device),
        instructions=[given.instruction for given in inputs],
        foreseeable=torch.ones(len(inputs), dtype=torch.bool, device=device),
    )
    return layout, list(views), torch.tensor(shown, device=device)


class ViewCache:
    """A network's features of views; forgets a view that nobody else refers to.

    A closed loop looks at each view again at every later decision. A copy starts empty.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._found: WeakKeyDictionary[View, Tensor] = WeakKeyDictionary()
        self._state: object = None

    def __len__(self) -> int:
        """Return how many views are known."""
        return len(self._found)

    def clear(self) -> None:
        """Forget all."""
        self._found.clear()

    def features(
        self,
        views: Sequence[View],
        compute: Callable[[list[View]], Tensor],
        state: object = None,
    ) -> Tensor:
        """Return the features of views, (len(views), ...), computing what is new.

        Args:
            views: At least one.
            compute: Maps views to features, one row each.
            state: State of the network; when another is given, all is forgotten.
        """
        if state != self._state:
            self.clear()
            self._state = state
        new = [view for view in dict.fromkeys(views) if view not in self._found]
        if new:
            self._found.update(zip(new, compute(new), strict=True))
        return torch.stack([self._found[view] for view in views])

    def __deepcopy__(self, memo: dict[int, Any]) -> "ViewCache":
        """Return an empty one."""
        return ViewCache()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as an empty one."""
        return ViewCache, ()
