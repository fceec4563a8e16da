"""PettingZoo environments for robots that act together, one agent per robot."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from gymnasium import spaces
from pettingzoo import AECEnv, ParallelEnv

from lemma.core.errors import ResetNeededError
from lemma.env.action_spaces import Action, check_keys
from lemma.env.learning.parallel_env import Agents, ParallelStep
from lemma.env.observation import Observation
from lemma.env.team.team_env import TeamEnv


class _TeamAgents(Agents[TeamEnv]):
    """Common base of both environments: orders and their masks by agent."""

    def __init__(self, inner: TeamEnv) -> None:
        super().__init__(inner)
        self.metadata["is_parallelizable"] = False
        self._action_spaces = {
            name: deepcopy(inner.order_space) for name in self.possible_agents
        }

    def action_space(self, agent: str) -> spaces.Dict:
        """Return the action space of an agent: orders for its own robot."""
        return self._action_spaces[agent]

    def _infos_of(self, info: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        masks = self.inner.last_masks
        return {name: {**info, "action_mask": masks[name]} for name in masks}


class TeamParallelEnv(_TeamAgents, ParallelEnv[str, Observation, Any]):
    """All agents act at each decision; actions of busy agents are ignored.

    ``infos[agent]["action_mask"]`` fits ``action_space(agent).sample(mask=...)``; all
    else is as in :class:`~lemma.env.team.team_env.TeamEnv`.
    """

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start a new episode; return observations and infos by agent."""
        self.inner.set_table(seed, options)
        self.agents = list(self.possible_agents)
        seen = {name: self.observe(name) for name in self.agents}
        return seen, self._infos_of(self.inner.info())

    def step(self, actions: Action) -> ParallelStep:
        """Give orders to the free robots.

        Args:
            actions: An order for each agent.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            InvalidActionError: An agent is missing or unknown, or the order of a free
                one is not in its space. In this case nothing has moved.
            ResetNeededError: The episode is over.
        """
        check_keys(actions, self.possible_agents)
        agents, free = self.possible_agents, self.inner.team.free
        _, reward, terminated, truncated, info = self.inner.step(
            {name: actions[name] for name in free}
        )
        if terminated or truncated:
            self.agents = []
        return (
            {name: self.observe(name) for name in agents},
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            self._infos_of(info),
        )


class TeamAECEnv(_TeamAgents, AECEnv[str, Observation, Any]):
    """Free agents act one after another; then time passes to the next decision.

    The mask of an agent does not account for orders that others gave before it.
    """

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> None:
        """Start a new episode."""
        self.inner.set_table(seed, options)
        self.agents = list(self.possible_agents)
        self._orders: dict[str, Action] = {}
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self._tell(0.0, False, False, self.inner.info())

    def _tell(
        self, reward: float, terminated: bool, truncated: bool, info: dict[str, Any]
    ) -> None:
        self.rewards = dict.fromkeys(self.agents, reward)
        self.terminations = dict.fromkeys(self.agents, terminated)
        self.truncations = dict.fromkeys(self.agents, truncated)
        self.infos = self._infos_of(info)
        self._asked = list(self.inner.team.free) or list(self.agents)
        self.agent_selection = self._asked.pop(0)

    def step(self, action: Action | None) -> None:
        """Take the order of the selected agent; None from an agent that is done.

        Raises:
            InvalidActionError: The order is not in its space; the same agent stays
            selected.
            ResetNeededError: There is no episode, or it is over.
        """
        if not self.agents:
            raise ResetNeededError("The episode is over. Call reset() before step().")
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        assert action is not None
        self.inner.read({agent: action})
        self._cumulative_rewards[agent] = 0.0
        self._clear_rewards()
        self._orders[agent] = action
        if self._asked:
            self.agent_selection = self._asked.pop(0)
        else:
            orders, self._orders = self._orders, {}
            _, reward, terminated, truncated, info = self.inner.step(orders)
            self._tell(reward, terminated, truncated, info)
        self._accumulate_rewards()
