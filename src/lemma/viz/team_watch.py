"""Notes, taken while a simulation goes on, of what a line alone does not say.

A line of a sub-task says when it began and ended. Why its robot stood still meanwhile,
and from when on others could build on it, is known to the reservations alone.
"""

from dataclasses import dataclass, field

from lemma.env.simulation import TICK_S, Simulation


@dataclass(slots=True)
class _Notes:
    """Waits and ways home of one robot, in order."""

    waits: list[tuple[float, float]] = field(default_factory=list)
    """Simulated times from and to which it waited for a region [s]; the last one may
    go on."""
    turned_home_s: list[float] = field(default_factory=list)
    """When it had no more work in a sub-task and went home [s]."""
    went_home: bool = False


class TeamWatch:
    """Watches the robots of a simulation; it changes nothing."""

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
        """Return from when to when a robot waited for a region [s].

        Args:
            robot: Its name.
            start_s: Beginning of its sub-task [s].
            end_s: Its end, or the present [s].
        """
        return tuple(
            (max(since_s, start_s), min(until_s, end_s))
            for since_s, until_s in tuple(self._notes[robot].waits)
            if until_s > start_s and since_s < end_s
        )

    def effect_s(self, robot: str, start_s: float, end_s: float) -> float | None:
        """Return when a sub-task had its effect [s]: its robot let go and went home.

        Args:
            robot: Its name.
            start_s: Beginning of the sub-task [s].
            end_s: Its end, or the present [s].

        Returns:
            None where it did not, as far as is known.
        """
        times = tuple(self._notes[robot].turned_home_s)
        found = [t for t in times if start_s < t <= end_s + 0.5 * TICK_S]
        return found[-1] if found else None
