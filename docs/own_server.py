"""A policy server that knows nothing of LEMMA: it moves the highest object.

Run it: ``python own_server.py 8000``. It needs NumPy, msgpack and websockets.
"""

import sys

import msgpack
import numpy as np
from websockets.sync.server import serve

CELL_M = 0.008


def array(sent):
    """Return an array as it was sent."""
    return np.frombuffer(sent["data"], sent["dtype"]).reshape(sent["shape"])


def decide(asked, view):
    """Return a decision on one input."""
    if len(asked["past"]) == 2:
        stop = {"robot": "", "primitive": "stop", "pick": "", "place": ""}
        return {"subtask": stop, "grounded": None, "explanation": ""}
    height_m = array(view["height_m"])
    row, column = np.unravel_index(height_m.argmax(), height_m.shape)
    x, y = (column + 0.5 - 208) * CELL_M, (208 - row - 0.5) * CELL_M
    who = {"robot": "robot_0" if x < 0 else "robot_1", "primitive": "move"}
    pick = {"x": float(x), "y": float(y), "yaw": 0.0}
    place = {"x": 0.0, "y": 0.0, "yaw": 0.0}
    return {
        "subtask": {**who, "pick": "", "place": ""},
        "grounded": {**who, "pick": pick, "place": place},
        "explanation": "It is the highest.",
    }


def talk(connection):
    """Answer one client."""
    views = {}
    for frame in connection:
        asked = msgpack.unpackb(frame)
        if asked["type"] == "hello":
            answer = {"type": "hello", "protocol": 2, "methods": ["act"]}
            answer["policy"] = {"name": "highest"}
        elif asked["type"] == "act":
            views |= {view["number"]: view for view in asked["views"]}
            # Of this request, those that are seen now: this policy needs no others.
            views = {one["view"]: views[one["view"]] for one in asked["inputs"]}
            decisions = [decide(one, views[one["view"]]) for one in asked["inputs"]]
            answer = {"type": "decisions", "decisions": decisions}
        else:
            answer = {"type": "error", "kind": "request", "message": "I only act."}
        connection.send(msgpack.packb(answer))


if __name__ == "__main__":
    with serve(talk, "127.0.0.1", int(sys.argv[1]), max_size=2**28) as server:
        print(server.socket.getsockname()[1], flush=True)
        server.serve_forever()
