"""Waits for regions and effects of sub-tasks, observed during a simulation.

A line of a sub-task has its begin and end. The times at which its robot waited for a
region, and from which other sub-tasks could use its result, come from the simulation's
reservations.
"""

from dataclasses import dataclass, field

from lemma.env.simulation import Simulation
from lemma.scene.build import TICK_S


@dataclass(slots=True)
class _Notes:
    """Waits and returns home of one robot, in order."""

    waits: list[tuple[float, float]] = field(default_factory=list)
    """Begin and end of its waits for a region, in simulated time [s]; the last one may
    still continue."""
    turned_home_s: list[float] = field(default_factory=list)
    """Simulated times at which it finished a sub-task's work and went home [s]."""
    went_home: bool = False


class TeamWatch:
    """Observes the robots of a simulation without changing it."""

    def __init__(self, simulation: Simulation) -> None:
        """Watch a simulation from now on."""
        self._simulation = simulation
        self._notes = {name: _Notes() for name in simulation.arms}
        simulation.observers.append(self._look)

    def _look(self) -> None:
        table, now_s = self._simulation.reservations, self._simulation.time_s
        for name, notes in self._notes.items():
            goes_home = table.is_going_home(name)
            if goes_home and not notes.went_home:
                notes.turned_home_s.append(now_s)
            notes.went_home = goes_home
            wait = table.waits.get(name)
            if wait is None:
                continue
            if notes.waits and notes.waits[-1][0] == wait.since_s:
                notes.waits.pop()
            notes.waits.append((wait.since_s, now_s))

    def waits(
        self, robot: str, start_s: float, end_s: float
    ) -> tuple[tuple[float, float], ...]:
        """Return begin and end of a robot's waits for a region, in simulated time [s].

        Args:
            robot: Its name.
            start_s: Begin of its sub-task [s].
            end_s: End of the sub-task, or the present [s].
        """
        return tuple(
            (max(since_s, start_s), min(until_s, end_s))
            for since_s, until_s in tuple(self._notes[robot].waits)
            if until_s > start_s and since_s < end_s
        )

    def effect_s(self, robot: str, start_s: float, end_s: float) -> float | None:
        """Return the simulated time at which a sub-task's robot turned home.

        Args:
            robot: Its name.
            start_s: Begin of the sub-task [s].
            end_s: End of the sub-task, or the present [s].

        Returns:
            The time [s]; None if the robot was not seen to turn home.
        """
        times = tuple(self._notes[robot].turned_home_s)
        found = [t for t in times if start_s < t <= end_s + 0.5 * TICK_S]
        return found[-1] if found else None
