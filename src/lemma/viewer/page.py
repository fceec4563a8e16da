"""The page: a server, a session, a panel, and the loop that keeps them in step."""

import viser

from lemma.viewer.episode.play import Play
from lemma.viewer.episode.session import Session
from lemma.viewer.panel.panel import Panel
from lemma.viewer.scene.pictures import Pictures
from lemma.viewer.scene.stage import Stage
from lemma.viewer.server import Rounds, address_of, close_server, prepare_panel

_LOOK_AT_FIRST = {"names"}


class Page:
    """A page on an address; all of its tabs see the same."""

    def __init__(self, session: Session, server: viser.ViserServer) -> None:
        """Show a session.

        Args:
            session: Closed with the page.
            server: Of the page; closed with it.
        """
        self._server = server
        self.session = session
        prepare_panel(server)
        self.port = server.get_port()
        self.address = address_of(server.get_host(), self.port)
        self.stage = Stage(self._server, _LOOK_AT_FIRST)
        self.panel = Panel(
            self._server, session, _LOOK_AT_FIRST, self.stage.set_visible
        )
        self.pictures = Pictures(self.panel.show_picture)
        self._shown: Play | None = None
        self._rounds = Rounds()
        self.updates = 0
        """How often the loop has gone round."""

    def tick(self, real_s: float) -> None:
        """Move on by some real time [s], and show it."""
        play = self.session.play
        play.transport.advance(real_s)
        qpos = play.transport.qpos()
        if play.scene is not None and play.instance is not None and qpos is not None:
            new = play is not self._shown
            if new and self.stage.set_scene(play.scene, play.instance):
                self.panel.teleoperation.forget()
            self.stage.viewpoint.step_back()
            self.stage.show(qpos)
            if play is not self._shown:
                assert self.stage.bodies is not None
                self.panel.table.dragging.watch(self.stage.bodies, play.scene)
                self._shown = play
            self.panel.table.allow(play.instance)
            explanation = play.explanation()
            self.stage.explain(
                explanation.insight, explanation.robot, explanation.waypoints
            )
            self.pictures.want(self.panel.picture.value, play.instance, qpos)
        else:
            self.stage.refresh()
        self.panel.refresh(play)
        self.updates += 1

    def visitors(self) -> list[viser.ClientHandle]:
        """Return who looks at it now: each tab is one."""
        return list(self._server.get_clients().values())

    def run(self) -> None:
        """Go on until it is closed from another thread, or interrupted."""
        self._rounds.go(self.tick)

    def close(self) -> None:
        """Stop listening, and free what was held."""
        # The loop uses the session and the scene: it ends first.
        self._rounds.end()
        self.session.close()
        self.pictures.close()
        close_server(self._server)
