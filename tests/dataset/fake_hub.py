"""A Hugging Face Hub of our own on 127.0.0.1: one dataset, as much as tests need."""

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import unquote, urlsplit

COMMIT = "c0ffee" * 6 + "c0ff"


@dataclass
class FakeHub:
    """What the hub knows, and how it behaves."""

    url: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    """By path in the repository, once committed."""
    blobs: dict[str, bytes] = field(default_factory=dict)
    """Large files that were sent but may not be committed yet, by SHA-256."""
    requests: list[str] = field(default_factory=list)
    exists: bool = False
    status: int = 0
    """Answer everything with this status, if it is not 0."""


@contextmanager
def fake_hub() -> Iterator[FakeHub]:
    """Run a hub as long as the context lasts."""
    hub = FakeHub()

    class Handler(_Handler):
        served = hub

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    hub.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield hub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    served: FakeHub
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: object) -> None:
        pass

    def _body(self) -> bytes:
        if self.headers.get("Transfer-Encoding", "") != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length") or 0))
        chunks = []
        while size := int(self.rfile.readline(), 16):
            chunks.append(self.rfile.read(size))
            self.rfile.readline()
        self.rfile.readline()
        return b"".join(chunks)

    def _answer(
        self, body: bytes, status: int = 200, headers: dict[str, str] | None = None
    ) -> None:
        self.send_response(status)
        for name, value in (headers or {}).items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _json(self, data: Any, status: int = 200) -> None:
        headers = {"Content-Type": "application/json"}
        self._answer(json.dumps(data).encode(), status, headers)

    def _handle(self) -> None:
        hub, body = self.served, self._body()
        path = unquote(urlsplit(self.path).path)
        hub.requests.append(f"{self.command} {path}")
        if hub.status:
            self._json({"error": "no"}, hub.status)
        elif path == "/api/repos/create":
            hub.exists = True
            request = json.loads(body)
            name = f"{request.get('organization', 'me')}/{request['name']}"
            self._json({"url": f"{hub.url}/datasets/{name}", "id": name, "name": name})
        elif path == "/api/validate-yaml":
            self._json({"errors": [], "warnings": []})
        elif path.startswith("/upload/"):
            hub.blobs[path.removeprefix("/upload/")] = body
            self._answer(b"")
        elif not hub.exists:
            headers = {"X-Error-Code": "RepoNotFound"}
            self._answer(b"{}", 404, headers)
        else:
            self._serve(path, body)

    def _serve(self, path: str, body: bytes) -> None:
        hub = self.served
        if "/preupload/" in path:
            self._json({"files": [_plan(f) for f in json.loads(body)["files"]]})
        elif path.endswith("/info/lfs/objects/batch"):
            objects = json.loads(body)["objects"]
            self._json(
                {"transfer": "basic", "objects": [self._place(o) for o in objects]}
            )
        elif "/commit/" in path:
            self._commit(body)
            self._json(
                {
                    "success": True,
                    "commitOid": COMMIT,
                    "commitUrl": f"{hub.url}/datasets/me/data/commit/{COMMIT}",
                    "hookOutput": "",
                }
            )
        elif "/tree/" in path:
            self._json(
                [
                    {"type": "file", "path": name, "size": len(data), "oid": _git(data)}
                    for name, data in hub.files.items()
                ]
            )
        elif "/revision/" in path or path.startswith("/api/datasets/"):
            siblings = [{"rfilename": name} for name in hub.files]
            self._json({"id": "me/data", "sha": COMMIT, "siblings": siblings})
        elif "/resolve/" in path:
            data = hub.files.get(path.split("/resolve/")[1].partition("/")[2])
            if data is None:
                self._answer(b"", 404, {"X-Error-Code": "EntryNotFound"})
            else:
                headers = {"ETag": f'"{_git(data)}"', "X-Repo-Commit": COMMIT}
                self._answer(data, 200, headers)
        else:
            self._json({"error": f"nothing at {path}"}, 404)

    def _place(self, wanted: dict[str, Any]) -> dict[str, Any]:
        href = f"{self.served.url}/upload/{wanted['oid']}"
        return {**wanted, "actions": {"upload": {"href": href}}}

    def _commit(self, body: bytes) -> None:
        hub = self.served
        for line in body.splitlines():
            entry = json.loads(line)
            value = entry["value"]
            if entry["key"] == "file":
                hub.files[value["path"]] = base64.b64decode(value["content"])
            elif entry["key"] == "lfsFile":
                hub.files[value["path"]] = hub.blobs[value["oid"]]

    do_GET = do_HEAD = do_POST = do_PUT = _handle


def _plan(wanted: dict[str, Any]) -> dict[str, Any]:
    large = wanted["path"].endswith(".parquet")
    mode = "lfs" if large else "regular"
    return {"path": wanted["path"], "uploadMode": mode, "shouldIgnore": False}


def _git(data: bytes) -> str:
    return hashlib.sha1(data, usedforsecurity=False).hexdigest()
