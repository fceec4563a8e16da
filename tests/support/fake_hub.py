"""A Hugging Face Hub of our own on 127.0.0.1: one dataset, as much as tests need."""

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from huggingface_hub import constants

COMMIT = "c0ffee" * 6 + "c0ff"


@dataclass
class FakeHub:
    """The contents and the behavior of the hub."""

    url: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    """By path in the repository, once committed."""
    blobs: dict[str, bytes] = field(default_factory=dict)
    """Large files that were sent but may not be committed yet, by SHA-256."""
    requests: list[str] = field(default_factory=list)
    exists: bool = False
    status: int = 0
    """Answer everything with this status, if it is not 0."""
    refuses_uploads: bool = False
    """Answer 400 to large files."""
    token: str | None = None
    """Only who shows this token sees the dataset; everybody if None."""
    damaged: dict[str, int] = field(default_factory=dict)
    """How often a file will still arrive with a wrong byte, by path."""
    cut: dict[str, int] = field(default_factory=dict)
    """How often the connection will still break halfway through a file, by path."""


def point_at(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Do what HF_ENDPOINT would have done before the client was imported."""
    template = constants.HUGGINGFACE_CO_URL_TEMPLATE.removeprefix(constants.ENDPOINT)
    monkeypatch.setattr(constants, "ENDPOINT", url)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", url + template)


def taken_for_the_hub(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Iterator[FakeHub]:
    """Yield a hub that the client takes for the real one; makes a fixture."""
    with fake_hub() as served:
        point_at(served.url, monkeypatch)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        # Ours has no Xet storage, and speaks LFS.
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
        monkeypatch.setenv("HF_TOKEN", "hf_ours")
        yield served


@contextmanager
def fake_hub() -> Iterator[FakeHub]:
    """Run a hub as long as the context lasts."""
    hub = FakeHub()

    class Handler(_Handler):
        served = hub

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    hub.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
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
        elif hub.refuses_uploads and path.startswith("/upload/"):
            self._json({"error": "no"}, 400)
        elif not self._is_known():
            # To strangers, a private repository looks like a missing one.
            self._answer(b"{}", 401, {"X-Error-Code": "RepoNotFound"})
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

    def _is_known(self) -> bool:
        token = self.served.token
        return token is None or self.headers["Authorization"] == f"Bearer {token}"

    def _serve(self, path: str, body: bytes) -> None:
        hub = self.served
        if "/preupload/" in path:
            self._json({"files": [self._plan(f) for f in json.loads(body)["files"]]})
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
            self._json([_entry(name, data) for name, data in hub.files.items()])
        elif "/revision/" in path or path.startswith("/api/datasets/"):
            siblings = [{"rfilename": name} for name in hub.files]
            self._json({"id": "me/data", "sha": COMMIT, "siblings": siblings})
        elif "/resolve/" in path:
            self._send_file(path.split("/resolve/")[1].partition("/")[2])
        else:
            self._json({"error": f"nothing at {path}"}, 404)

    def _send_file(self, name: str) -> None:
        hub = self.served
        data = hub.files.get(name)
        if data is None:
            self._answer(b"", 404, {"X-Error-Code": "EntryNotFound"})
            return
        headers = {"ETag": f'"{_oid(name, data)}"', "X-Repo-Commit": COMMIT}
        if self.command == "GET" and hub.damaged.get(name, 0):
            hub.damaged[name] -= 1
            middle = len(data) // 2
            data = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
        if self.command == "GET" and hub.cut.get(name, 0):
            hub.cut[name] -= 1
            self.send_response(200)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data[: len(data) // 2])
            self.close_connection = True
            return
        self._answer(data, 200, headers)

    def _plan(self, wanted: dict[str, Any]) -> dict[str, Any]:
        name = wanted["path"]
        plan = {"path": name, "shouldIgnore": False}
        plan["uploadMode"] = "lfs" if _is_large(name) else "regular"
        there = self.served.files.get(name)
        return plan if there is None else {**plan, "oid": _oid(name, there)}

    def _place(self, wanted: dict[str, Any]) -> dict[str, Any]:
        if wanted["oid"] in self.served.blobs:
            return wanted
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


def _is_large(name: str) -> bool:
    return name.endswith(".parquet")


def _entry(name: str, data: bytes) -> dict[str, Any]:
    entry = {"type": "file", "path": name, "size": len(data), "oid": _git(data)}
    if _is_large(name):
        oid = _oid(name, data)
        entry["lfs"] = {"oid": oid, "size": len(data), "pointerSize": 130}
    return entry


def _oid(name: str, data: bytes) -> str:
    """Return what the hub calls a content: SHA-256 of large files, git's of others."""
    return hashlib.sha256(data).hexdigest() if _is_large(name) else _git(data)


def _git(data: bytes) -> str:
    head = f"blob {len(data)}\0".encode()
    return hashlib.sha1(head + data, usedforsecurity=False).hexdigest()
