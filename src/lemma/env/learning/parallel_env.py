"""The control level for PettingZoo: one agent per robot."""

from typing import Any, Generic, TypeVar

from gymnasium import spaces
from pettingzoo import ParallelEnv

from lemma.env.action_spaces import Action, check_keys
from lemma.env.camera_rig import (
    OVERVIEW_NAME,
    TABLE_NAME,
    reach_name,
    wrist_name,
)
from lemma.env.control_env import ControlEnv
from lemma.env.observation import Observation, Observer
from lemma.env.team.team_env import TeamEnv
from lemma.scene.cameras import RgbImage

E = TypeVar("E", ControlEnv, TeamEnv)

ParallelStep = tuple[
    dict[str, Observation],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


class Agents(Generic[E]):
    """Base of the PettingZoo environments: one agent per robot of an environment."""

    def __init__(self, inner: E) -> None:
        """Split an environment among its robots.

        Args:
            inner: The environment that all agents share.
        """
        self.inner: E = inner
        self.metadata = {**inner.metadata, "name": f"lemma/{inner.task}"}
        self.render_mode = inner.render_mode
        self.possible_agents = list(inner.robot_names)
        self.agents: list[str] = []
        config = inner.config
        self._observers = {
            name: Observer(
                config.observation,
                (i,),
                config.image_size,
                self._cameras_of(name),
                config.kinds,
            )
            for i, name in enumerate(self.possible_agents)
        }

    def _cameras_of(self, agent: str) -> tuple[str, ...] | None:
        """Return the names of an agent's cameras; None for those of its robot."""
        return None

    def observation_space(self, agent: str) -> spaces.Dict:
        """Return the observation space of an agent."""
        return self._observers[agent].space

    def observe(self, agent: str) -> Observation:
        """Return the present observation of an agent."""
        observer, inner = self._observers[agent], self.inner
        return observer.observe(inner.episode, inner.config.instruction)

    def state_hash(self) -> str:
        """Return the SHA-256 of the full integration state of the physics."""
        return self.inner.state_hash()

    def render(self) -> RgbImage | None:
        """Return an image for people; None without a render mode."""
        return self.inner.render()

    def close(self) -> None:
        """Free the resources of rendering."""
        for observer in self._observers.values():
            observer.close()
        self.inner.close()


class LemmaParallelEnv(Agents[ControlEnv], ParallelEnv[str, Observation, Any]):
    """A PettingZoo environment with one agent per robot and a shared reward.

    An agent observes the joints and cameras of its robot and commands its motors.
    Everything else is as in the wrapped :class:`~lemma.env.control_env.ControlEnv`.
    """

    def __init__(self, inner: ControlEnv) -> None:
        """Split an environment among its robots."""
        super().__init__(inner)
        self._action_spaces = {
            name: inner.action_layout.row_box() for name in self.possible_agents
        }

    def _cameras_of(self, agent: str) -> tuple[str, ...] | None:
        """Return an agent's cameras: those of its robot, and those of no robot."""
        if self.inner.config.cameras is None:
            return None
        own = {agent, wrist_name(agent), reach_name(agent), OVERVIEW_NAME, TABLE_NAME}
        return tuple(name for name in self.inner.config.cameras if name in own)

    def action_space(self, agent: str) -> spaces.Box:
        """Return the action space of an agent: one row of ``inner.action_layout``."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start a new episode.

        Args:
            seed: Seeds the random choice of instances.
            options: As for :class:`~lemma.env.base_env.LemmaEnv`.

        Returns:
            Observations and infos by agent.
        """
        self.inner.set_table(seed, options)
        self.agents = list(self.possible_agents)
        seen = {agent: self.observe(agent) for agent in self.agents}
        return seen, self._infos()

    def step(self, actions: Action) -> ParallelStep:
        """Command all motors for one control step.

        Args:
            actions: One row of numbers for each agent.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            InvalidActionError: An agent is missing or unknown, or its action is not in
                its space. In this case nothing has moved.
            ResetNeededError: The episode is over.
        """
        check_keys(actions, self.possible_agents)
        agents = self.possible_agents
        reward, terminated, truncated = self.inner.advance(
            [actions[agent] for agent in agents]
        )
        if terminated or truncated:
            self.agents = []
        return (
            {agent: self.observe(agent) for agent in agents},
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            self._infos(),
        )

    def _infos(self) -> dict[str, dict[str, Any]]:
        return {agent: self.inner.info() for agent in self.possible_agents}
