"""A page of failures: two tables side by side, at the moment of the mistake."""

import viser

from lemma.viewer.failures.catalog import Catalog, Filter
from lemma.viewer.failures.comparison import Comparison, Cursor, Replayer
from lemma.viewer.failures.panel import FailurePanel
from lemma.viewer.scene.side_by_side import SideBySide
from lemma.viewer.scene.viewpoint import Viewpoint
from lemma.viewer.server import Rounds, address_of, close_server, prepare_panel

_HALF_WIDTH_M = 3.6
"""Half the width of the first view of two tables [m]."""


class FailurePage:
    """A page on an address; all of its tabs see the same."""

    def __init__(
        self,
        catalog: Catalog,
        server: viser.ViserServer,
        wanted: Filter | None = None,
    ) -> None:
        """Show the first failure.

        Args:
            catalog: The failures.
            server: Of the page; closed with it.
            wanted: Filter to begin with.
        """
        self._server = server
        prepare_panel(server)
        self.address = address_of(server)
        self.cursor, self.replayer = Cursor(), Replayer()
        self.panel = FailurePanel(
            self._server, catalog, self.replayer, self.cursor, wanted or Filter()
        )
        self._viewpoint = Viewpoint(self._server, _HALF_WIDTH_M)
        self._shown: Comparison | None = None
        self._tables: SideBySide | None = None
        self._rounds = Rounds()

    def tick(self, real_s: float) -> None:
        """Move on by some real time [s], and show it."""
        comparison = self.replayer.comparison
        if comparison is not None and comparison is not self._shown:
            self._shown = comparison
            end_s = max((side.end_s for side in comparison.sides), default=0.0)
            self.cursor.open(min(comparison.opens_s, end_s), end_s)
            if comparison.sides:
                with self._server.atomic():
                    self._tables = SideBySide(self._server, comparison.sides)
                self._viewpoint.widen(self._tables.half_width_m)
            else:
                self._server.scene.reset()
                self._tables = None
        self.cursor.advance(real_s)
        if self._tables is not None:
            self._viewpoint.step_back()
            self._tables.show(self.cursor.at_s)
        self.panel.refresh(comparison)

    def run(self) -> None:
        """Go on until it is closed from another thread, or interrupted."""
        self._rounds.go(self.tick)

    def close(self) -> None:
        """Stop listening, and free what was held."""
        # The loop uses the scene: it ends first.
        self._rounds.end()
        self.replayer.close()
        close_server(self._server)
