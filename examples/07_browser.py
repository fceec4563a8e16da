"""A page in the browser with a policy: here the expert, at high speed.

python examples/07_browser.py [PORT]            until Ctrl-C
python examples/07_browser.py [PORT] --once     until the expert is done

Needs viser: pip install "lemma-bench[play]". From a shell: lemma play.
"""

import sys
import threading
import time

from lemma.viewer.episode.session import Session
from lemma.viewer.episode.status import ENDS, EpisodeRequest
from lemma.viewer.page import Page
from lemma.viewer.server import open_server

port = int(sys.argv[1]) if len(sys.argv) > 1 else 8080
once = "--once" in sys.argv

# Policies have the names of ``lemma evaluate``: your own class, weights, a server.
request = EpisodeRequest("stack", "test", 0, policy="oracle")
session = Session(request, ("oracle",))
page = Page(session, open_server("127.0.0.1", port))
print(page.address)

# The page runs in its own thread; commands come from here, or from its visitors.
loop = threading.Thread(target=page.run)
loop.start()
try:
    session.set_speed(8.0)
    session.ask(request, acts=True)
    while session.play.status.phase not in ENDS:
        time.sleep(0.05)
    for line in session.play.status.lines:
        print(f"{line.start_s:5.2f} s  {line.words}: {line.outcome}")
    print(session.play.status.phase)
    while not once:
        time.sleep(1.0)
except KeyboardInterrupt:
    pass
finally:
    page.close()
    loop.join()
