"""Acting together for PettingZoo: one agent per robot, asked when it is free."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from gymnasium import spaces
from pettingzoo import AECEnv, ParallelEnv

from lemma.core.errors import ResetNeededError
from lemma.env.action_spaces import Action, check_keys
from lemma.env.learning.parallel_env import ParallelStep
from lemma.env.observation import Observation, Observer
from lemma.env.team.team_env import TeamEnv
from lemma.scene.cameras import RgbImage


class _Agents:
    """The common part of both views: observations and infos by agent."""

    def __init__(self, inner: TeamEnv) -> None:
        self.inner = inner
        self.metadata = {
            **inner.metadata,
            "name": f"lemma/{inner.task}",
            "is_parallelizable": False,
        }
        self.render_mode = inner.render_mode
        self.possible_agents = list(inner.robot_names)
        self.agents: list[str] = []
        self._action_spaces = {
            name: deepcopy(inner.order_space) for name in self.possible_agents
        }
        config = inner.config
        self._observers = {
            name: Observer(config.observation, (i,), config.image_size)
            for i, name in enumerate(self.possible_agents)
        }

    def observation_space(self, agent: str) -> spaces.Dict:
        """Return what an agent observes: its joints and its own camera."""
        return self._observers[agent].space

    def action_space(self, agent: str) -> spaces.Dict:
        """Return the orders that an agent can give itself."""
        return self._action_spaces[agent]

    def observe(self, agent: str) -> Observation:
        """Return what an agent observes now."""
        return self._observers[agent].observe(
            self.inner.episode, self.inner.config.instruction
        )

    def _infos_of(self, info: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        masks = self.inner.last_masks
        return {name: {**info, "action_mask": masks[name]} for name in masks}

    def state_hash(self) -> str:
        """Return the SHA-256 of the full integration state of the physics."""
        return self.inner.state_hash()

    def render(self) -> RgbImage | None:
        """Return a picture for people; None without a render mode."""
        return self.inner.render()

    def close(self) -> None:
        """Free what rendering uses."""
        for observer in self._observers.values():
            observer.close()
        self.inner.close()


class TeamParallelEnv(_Agents, ParallelEnv[str, Observation, Any]):
    """All agents at each decision; nobody looks at the actions of those at work.

    ``infos[agent]["action_mask"]`` fits ``action_space(agent).sample(mask=...)``; the
    rest of it and of the steps is as in :class:`~lemma.env.team.team_env.TeamEnv`.
    """

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Set the table for a new episode; observations and infos by agent."""
        self.inner.set_table(seed, options)
        self.agents = list(self.possible_agents)
        seen = {name: self.observe(name) for name in self.agents}
        return seen, self._infos_of(self.inner.info())

    def step(self, actions: Action) -> ParallelStep:
        """Give the orders of those that are free.

        Args:
            actions: An order for each agent.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            InvalidActionError: An agent is missing or unknown, or the order of a free
                one is not in its space. Nothing has moved then.
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


class TeamAECEnv(_Agents, AECEnv[str, Observation, Any]):
    """Free agents are asked one after another; then time passes to the next decision.

    Masks of those asked later do not know the orders of those asked before.
    """

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> None:
        """Set the table for a new episode."""
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
        """Take the order of the agent that was asked; None from one that is done.

        Raises:
            InvalidActionError: It is not in its space; the same agent is asked again.
            ResetNeededError: There is no episode, or nobody is left in it.
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
