"""Loading of team policies by name, with adapters for sequential policies."""

from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import takes
from lemma.policies.compose import PlannerWithGrounder
from lemma.policies.interfaces import Policy
from lemma.policies.oracle import OracleGrounder
from lemma.policies.spec import ADAPTERS, ORACLE, PLANNINGS, Load, PolicySpec
from lemma.policies.together.adapters import (
    Greedy,
    Symbols,
    Turns,
    WithExpertPoses,
    WithGrounder,
)
from lemma.policies.together.each_asked import EachAsked
from lemma.policies.together.interfaces import TeamPolicy
from lemma.policies.together.rules import TEAM_RULES


def team_of(spec: PolicySpec, load: Load | None = None) -> TeamPolicy:
    """Return the policy of a spec as a team policy.

    Rules of :data:`TEAM_RULES` and objects with ``act_together`` or ``act_alone`` need
    no adapter; all others get one.

    Args:
        spec: The policy's name and options.
        load: Returns the planner, grounder or policy of a name.

    Raises:
        LemmaError: There is no such policy, or it does not support the options.
    """
    first, *more = spec.parts
    rule = TEAM_RULES.get(first.partition(":")[0])
    plain = not (spec.gta or spec.planning != PLANNINGS[0])
    if rule and plain and not spec.adapter and more in ([], [ORACLE]):
        return WithExpertPoses(rule(first.partition(":")[2]))
    part = None if first == ORACLE or spec.is_planner(first) else spec.part(first, load)
    team = None if spec.adapter else _team(part)
    if team is None:

        def known(name: str) -> Any:
            return part if name == first else spec.part(name, load)

        return _adapted(spec, known)
    if not plain:
        raise InvalidConfigError(
            f"{spec.name} decides for a team, so neither multi-step planning nor "
            "ground-truth allocation applies to it."
        )
    if more == [ORACLE]:
        return WithExpertPoses(team)
    if not more and getattr(part, "symbolic", False) is True:
        raise InvalidConfigError(
            f"{spec.name} orders sub-tasks without poses. Add the expert's, as "
            f"{spec.name}+{ORACLE}."
        )
    return WithGrounder(team, spec.part(more[0], load)) if more else team


def _team(part: Any) -> TeamPolicy | None:
    """Return an object as a team policy; None for a sequential policy."""
    if takes(getattr(part, "act_together", None), 1):
        found: TeamPolicy = part
        return found
    return EachAsked(part) if takes(getattr(part, "act_alone", None), 1) else None


def _adapted(spec: PolicySpec, load: Load) -> TeamPolicy:
    """Return a sequential policy with an adapter."""
    policy: Policy = spec.load_sequential(load)
    symbolic = False
    if isinstance(policy, PlannerWithGrounder):
        symbolic = isinstance(policy.grounder, OracleGrounder)
        policy = Symbols(policy.planner) if symbolic else policy
    team: TeamPolicy = Turns(policy)
    if spec.adapter in ("", ADAPTERS[0]):
        team = Greedy(policy, symbolic)
    return WithExpertPoses(team) if symbolic else team
