"""A policy that is heard: what it decides is told before it is done, and why."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lemma.evaluation.run.fault_isolation import Fault, check
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Composite, Decision, Explainer, Insight, told


@dataclass(frozen=True)
class ObservedPolicy(Composite):
    """Asks a policy, and tells what it answers."""

    policy: Any
    tell: Callable[[Decision | Actions | None], None]
    """Told of a decision; None before there is one."""
    explain: Callable[[Insight], None]
    """Told why, where the policy says so."""

    @property
    def parts(self) -> tuple[object, ...]:
        """What it is made of."""
        return (self.policy,)

    def act(self, inputs: Sequence[Any]) -> Any:
        """Return what the policy answers, whatever that is."""
        if not isinstance(inputs[0], ControlInput):
            # That would be said twenty times a second.
            self.tell(None)
        answers = self.policy.act(inputs)
        if isinstance(answers, list | tuple) and answers:
            # What makes no sense becomes a fault elsewhere.
            decision = check(answers[0], inputs[0])
            if not isinstance(decision, Fault):
                explainer = find_explainer(self.policy)
                if explainer is not None:
                    self.explain(explainer.explain(told(explainer, inputs[:1]))[0])
                self.tell(decision)
        return answers


def find_explainer(policy: Any) -> Explainer | None:
    """Return the part of a policy that says why, if there is one."""
    if isinstance(policy, Composite):
        found = (find_explainer(part) for part in policy.parts)
        return next((each for each in found if each is not None), None)
    return policy if isinstance(policy, Explainer) else None
