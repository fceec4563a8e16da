"""Plan and skill level for robots that act in parallel, by orders to free robots.

A step gives orders to free robots. It ends at the next decision: when a robot becomes
free, or when an order has had its effect while a robot is free. Steps differ in
duration, as in a semi-Markov decision process: ``info["duration_s"]`` is the duration
of the last one.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lemma.core.errors import InvalidActionError, shown
from lemma.core.robot_names import robot_number
from lemma.env.action_spaces import (
    SKILL_POSES,
    Action,
    check_keys,
    decode_plan,
    decode_skill,
    encode_plan,
    encode_skill,
    picks,
    places,
)
from lemma.env.base_env import LemmaEnv, StepResult
from lemma.env.config import EnvConfig
from lemma.env.episode import LEAST_STEP_S, Episode
from lemma.env.team.orders import Team
from lemma.env.team.records import Done
from lemma.env.team.valid_orders import valid_options
from lemma.tasks.subtask import (
    GroundedSubTask,
    Primitive,
    SubTask,
    primitive_names,
)

Mask = dict[str, NDArray[np.int8]]


class TeamEnv(LemmaEnv):
    """Common base of both levels: an action is a mapping from robot to order.

    A robot without an order waits, and so does one whose primitive is ``wait``, the
    number after those of :func:`~lemma.tasks.subtask.primitive_names`. ``stop`` of any
    robot ends the episode: busy robots finish, then it is judged. An order that cannot
    be carried out raises no error: its robot is busy for a second. An order of
    :data:`~lemma.tasks.subtask.JOINT` takes a second robot, and waits until that one is
    free; if it is, its own order later in the same step is dropped.

    ``info`` additionally holds: ``duration_s`` of the step; ``free``, the robots that
    can be given orders; ``doing`` and ``waits_for`` by robot; ``ended``, the orders
    that ended in the step; ``masks`` of valid orders by robot.
    """

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Define the spaces; nothing is simulated before the first reset.

        Args:
            config: The options.
            render_mode: ``"rgb_array"`` for :meth:`render`, ``"human"``, or None.

        Raises:
            UnknownNameError: No such render mode.
        """
        super().__init__(config, render_mode)
        self.metadata["render_fps"] = 1
        self._max_episode_steps = max(1, round(config.horizon_s / LEAST_STEP_S))
        self.order_space = self._order_space()
        """The space of one robot's order."""
        self.action_space = spaces.Dict(
            {name: self._order_space() for name in self.robot_names}
        )
        self.last_masks: dict[str, Mask] = {}
        """Masks in the last ``info``."""
        self._team: Team | None = None
        self._duration_s = 0.0
        self._ended: tuple[Done, ...] = ()

    def _order_space(self) -> spaces.Dict:
        raise NotImplementedError

    def _decode(self, order: Action, robot: int) -> Any:
        """Decode an order other than ``wait``; return None for ``stop``."""
        raise NotImplementedError

    def _mask(self, robot: str) -> Mask:
        raise NotImplementedError

    @property
    def team(self) -> Team:
        """The team, with its free robots and its orders."""
        _ = self.episode
        assert self._team is not None
        return self._team

    def _begin(self, episode: Episode) -> None:
        super()._begin(episode)
        self._team = Team(episode)
        self._duration_s, self._ended = 0.0, ()

    def step(self, action: Mapping[str, Action]) -> StepResult:
        """Give orders to free robots, and let time pass to the next decision.

        Args:
            action: Orders by robot. Each is grounded in the state expected after those
                before it, so one step can order several sub-tasks of a plan.

        Returns:
            Observation, reward, terminated, truncated and info.

        Raises:
            InvalidActionError: An order is not in its space, or its robot is busy;
                nothing has moved then.
            ResetNeededError: The episode is over.
        """
        episode, team = self._running(), self.team
        stops, orders = self.read(action)
        start_s, ended = episode.elapsed_s, list[Done]()
        for subtask, grounded in orders:
            commanded = subtask or grounded
            if commanded is not None and team.works_on(commanded.robot):
                # An order before it has taken the robot as a partner.
                continue
            refused = team.order(subtask, grounded)
            ended += [refused] if refused else []
        ended += team.stop() if stops else team.advance()
        self._duration_s = episode.elapsed_s - start_s
        self._ended = tuple(ended)
        reward = self.rewards.reward(episode)
        terminated = episode.stopped or episode.has_failed
        truncated = episode.out_of_time and not terminated
        return self.observe(), reward, terminated, truncated, self.info()

    def read(
        self, action: Mapping[str, Action]
    ) -> tuple[bool, list[tuple[SubTask | None, GroundedSubTask | None]]]:
        """Return whether the team stops, and the decoded orders."""
        if not isinstance(action, Mapping) or not set(action) <= set(self.robot_names):
            raise InvalidActionError(
                f"The action is {shown(action)}. Valid: a dictionary from some of "
                f"{', '.join(self.robot_names)} to orders. Try the environment's "
                "encode()."
            )
        stops, free = False, self.team.free
        orders: list[tuple[SubTask | None, GroundedSubTask | None]] = []
        for name, order in action.items():
            if self._waits(order):
                continue
            if name not in free:
                raise InvalidActionError(
                    f"{name} is busy. Orders are for free robots: "
                    f"{', '.join(free) or 'there is none now'}."
                )
            meant = self._decode(order, robot_number(name))
            if meant is None:
                stops = True
            elif isinstance(meant, GroundedSubTask):
                orders.append((None, meant))
            else:
                orders.append((meant, None))
        return stops, [] if stops else orders

    def _waits(self, order: Any) -> bool:
        check_keys(order, tuple(self.order_space.spaces))
        return np.array_equal(order["primitive"], len(primitive_names()))

    def _full_info(self, progress: float | None) -> dict[str, Any]:
        found, team = super()._full_info(progress), self.team
        waits_for, free = team.waits_for, team.free
        found["duration_s"] = self._duration_s
        found["free"] = free
        found["doing"] = {
            name: str(order.subtask or order.grounded.primitive)
            for name in self.robot_names
            if (order := team.orders.get(team.works_on(name))) is not None
        }
        found["waits_for"] = waits_for
        found["ended"] = [
            {
                "robot": done.robot,
                "subtask": None if done.subtask is None else str(done.subtask),
                "outcome": str(done.result.outcome),
                "explanation": done.result.explanation,
            }
            for done in self._ended
        ]
        found["masks"] = self.last_masks = self.action_masks()
        return found

    def action_masks(self) -> dict[str, Mask]:
        """Return masks of the valid numbers of an order now, by robot.

        They fit ``order_space.sample``: a busy robot can only ``wait``.
        """
        free = () if self.episode.is_over else self.team.free
        return {
            name: self._mask(name) if name in free else self._busy_mask()
            for name in self.robot_names
        }

    def _busy_mask(self) -> Mask:
        found = {}
        for name, space in self.order_space.spaces.items():
            if isinstance(space, spaces.Discrete):
                found[name] = np.zeros(int(space.n), np.int8)
                found[name][-1 if name == "primitive" else 0] = 1
        return found

    def _remember(self) -> dict[str, Any]:
        return {
            "team": self.team.state(),
            "duration_s": self._duration_s,
            "ended": self._ended,
        }

    def _recall(self, memory: dict[str, Any]) -> None:
        self.team.restore(memory["team"])
        self._duration_s, self._ended = memory["duration_s"], memory["ended"]


class TeamPlanEnv(TeamEnv):
    """An environment whose orders are a primitive, a pick and a place."""

    def _order_space(self) -> spaces.Dict:
        return spaces.Dict(
            {
                "primitive": spaces.Discrete(len(primitive_names()) + 1),
                "pick": spaces.Discrete(len(picks(self.config.kinds))),
                "place": spaces.Discrete(
                    len(places(len(self.robot_names), self.config.kinds))
                ),
            }
        )

    def encode(self, *subtasks: SubTask) -> dict[str, dict[str, Any]]:
        """Return the action that orders some sub-tasks; without any, all robots wait.

        Raises:
            InvalidActionError: There is no such entity.
        """
        found = {}
        for subtask in subtasks:
            order = encode_plan(subtask, len(self.robot_names), self.config.kinds)
            robot = self.robot_names[order.pop("robot")]
            found[robot] = order
        return found

    def _decode(self, order: Action, robot: int) -> SubTask | None:
        subtask = decode_plan(
            {"robot": robot, **order}, len(self.robot_names), self.config.kinds
        )
        return None if subtask.primitive is Primitive.STOP else subtask

    def valid_orders(self, robot: str) -> tuple[SubTask, ...]:
        """Return the sub-tasks that are valid orders for a robot now.

        They can be grounded in the state expected after all orders in progress.
        """
        team = self.team
        now = team.observe()
        state = team.expected(now, team.settled(now))
        options = valid_options(robot, state, team.grounder)
        return tuple(option.subtask for option in options)

    def _mask(self, robot: str) -> Mask:
        found = self._busy_mask()
        found["primitive"][primitive_names().index(Primitive.STOP)] = 1
        for subtask in self.valid_orders(robot):
            order = encode_plan(subtask, len(self.robot_names), self.config.kinds)
            for part, mask in found.items():
                mask[order[part]] = 1
        return found


class TeamSkillEnv(TeamEnv):
    """An environment whose orders are a primitive and two poses, and begin at once."""

    def _order_space(self) -> spaces.Dict:
        return spaces.Dict(
            {
                "primitive": spaces.Discrete(len(primitive_names()) + 1),
                "poses": SKILL_POSES.box(np.float64),
            }
        )

    def encode(self, *subtasks: GroundedSubTask | None) -> dict[str, dict[str, Any]]:
        """Return the action that orders some grounded sub-tasks, ``stop`` for None.

        Raises:
            InvalidActionError: An argument is neither.
        """
        found = {}
        for subtask in subtasks:
            order = encode_skill(subtask)
            robot = self.robot_names[order.pop("robot")]
            found[robot] = order
        return found

    def _decode(self, order: Action, robot: int) -> GroundedSubTask | None:
        return decode_skill({"robot": robot, **order}, len(self.robot_names))

    def _mask(self, robot: str) -> Mask:
        del robot
        found = self._busy_mask()
        found["primitive"][:] = 1
        return found
