"""A check of reserved sectors, in every tick."""

from itertools import combinations

from lemma.env.simulation import Simulation
from lemma.evaluation.run.watches import ClearanceWatch
from lemma.motion.arm_motion import largest_turn
from lemma.motion.sectors import cell_at


def watch_sectors(simulation: Simulation) -> ClearanceWatch:
    """Check in every tick that no cell has two holders; watch the clearance as well.

    A hand over the table that is not at home is in a cell of its arm.
    """

    def look() -> None:
        cells = simulation.reservations.cells
        for a, b in combinations(cells.values(), 2):
            assert not (a & b).any()
        for name, arm in simulation.arms.items():
            if largest_turn(arm.measured, arm.park) > 0.1:
                at = cell_at(*arm.tcp_pose()[:2, 3])
                assert at is None or cells[name][at]

    simulation.observers.append(look)
    return ClearanceWatch(simulation)
