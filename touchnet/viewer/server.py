"""A web server of the standard library that shows one scene to a browser on this machine."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from touchnet.viewer.page import render_page
from touchnet.viewer.scene import Scene, Step

__all__ = ["Server"]

LOCAL = ("localhost", "127.0.0.1")


class Server(ThreadingHTTPServer):
    """Serves the page of a scene at / and further steps of it at /step?count=N.

    Args:
        scene: what the page shows.
        make_step: the step after so many contacts; called once for each number, by one thread at a time. `None`: there
            are no more than the scene has.
        host: the name or address to listen at.
        port: the port to listen at; 0 takes a free one.

    Raises:
        OSError: the address is taken or not one of this machine.
    """

    daemon_threads = True

    def __init__(
        self, scene: Scene, make_step: Callable[[int], Step] | None, *, host: str = "localhost", port: int = 0
    ) -> None:
        self.host = host
        self._make_step, self._lock = make_step, threading.Lock()
        super().__init__((host, port), _Handler)
        self.total = len(scene.contacts.points)
        self.page = render_page(scene).encode()
        self._scene = scene
        self._steps = {step.count: scene.pack_step(step) for step in scene.steps}

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{self.host}:{self.server_port}/"

    def server_bind(self) -> None:
        super().server_bind()
        # The standard library's asks the name service for the name of this machine, which may take seconds.
        self.server_name = self.host

    def server_close(self) -> None:
        """Ends the server; waits for the step at work, during which torch would abort a process that ends."""
        super().server_close()
        self._make_step = None
        with self._lock:
            pass

    def handle_error(self, request: object, client_address: object) -> None:
        # A page that is closed or asks anew does not wait for the answer.
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def is_for_us(self, host: str | None) -> bool:
        """Whether a request names this server. Elsewhere a page could point its own name at this machine and read."""
        if self.host not in LOCAL:
            return True
        return host is not None and host.rsplit(":", 1)[0].lower() in LOCAL

    def step(self, count: int) -> bytes:
        """The packed step after so many contacts; KeyError where there is none."""
        with self._lock:  # one reconstruction uses all cores
            make_step = self._make_step
            if count not in self._steps and make_step is not None:
                self._steps[count] = self._scene.pack_step(make_step(count))
            return self._steps[count]


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        address = urlsplit(self.path)
        if not self.server.is_for_us(self.headers.get("Host")):
            self._answer(HTTPStatus.FORBIDDEN, b"this server answers to localhost only")
        elif address.path == "/":
            self._answer(HTTPStatus.OK, self.server.page, "text/html; charset=utf-8")
        elif address.path == "/step":
            self._answer_step(parse_qs(address.query).get("count", [""])[-1])
        else:
            self._answer(HTTPStatus.NOT_FOUND, b"no such page")

    def _answer_step(self, count: str) -> None:
        total = self.server.total
        if not (count.isascii() and count.isdecimal() and len(count) < 10 and 1 <= int(count) <= total):
            self._answer(HTTPStatus.BAD_REQUEST, f"count should be a number from 1 to {total}".encode())
            return
        try:
            step = self.server.step(int(count))
        except KeyError:
            self._answer(HTTPStatus.NOT_FOUND, b"this page has one mesh")
            return
        self._answer(HTTPStatus.OK, step, "application/gzip")

    def _answer(self, status: HTTPStatus, body: bytes, kind: str = "text/plain; charset=utf-8") -> None:
        self.send_response(status)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Cross-Origin-Resource-Policy": "same-origin",
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Says nothing: the terminal belongs to the command."""
