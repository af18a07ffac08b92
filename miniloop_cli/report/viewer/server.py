"""A server for one page on this machine: bound to 127.0.0.1, and it answers only with the token in the address."""

from __future__ import annotations

import gzip
import hmac
import secrets
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

from miniloop_cli.errors import MiniloopError
from miniloop_cli.report.viewer.shown import Shown

HOST = "127.0.0.1"
# As for a report, but the page may request from this server; images of GLB files are blobs.
POLICY = (
    "default-src 'none'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; script-src 'self'; "
    "connect-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
TEXT = ("text/", "application/json")


class ViewServer(ThreadingHTTPServer):
    """Serves the page below /TOKEN/. Call `serve_forever` until an interrupt, then `server_close`."""

    daemon_threads = True

    def __init__(self, shown: Shown, port: int = 0) -> None:
        """`port` 0: any free one. Raises MiniloopError if the port is in use."""
        self.shown, self.token = shown, secrets.token_urlsafe(16)
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            raise MiniloopError(f"cannot serve on port {port}: {error}; give another one to --port") from error

    @property
    def address(self) -> str:
        """The address of the page, token included."""
        return f"http://{HOST}:{self.server_address[1]}/{self.token}/"

    def allows(self, host: str, token: str) -> bool:
        """Whether a request comes from this page; another `host` is a site that resolves to it (DNS rebinding)."""
        named = host in (f"{HOST}:{self.server_address[1]}", f"localhost:{self.server_address[1]}")
        return named and hmac.compare_digest(token.encode(), self.token.encode())


class _Handler(BaseHTTPRequestHandler):
    server: ViewServer
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        token, _, path = unquote(urlsplit(self.path).path).removeprefix("/").partition("/")
        allowed = self.server.allows(self.headers.get("Host", ""), token)
        answer = self.server.shown.answer(path) if allowed else None
        if answer is None:
            self.send_error(404)
            return
        kind, content = answer
        self.send_response(200)
        self.send_header("Content-Type", f"{kind}; charset=utf-8" if kind.startswith(TEXT) else kind)
        if kind.startswith(TEXT) and "gzip" in self.headers.get("Accept-Encoding", ""):
            content = gzip.compress(content, 5)
            self.send_header("Content-Encoding", "gzip")
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing, to keep the terminal free."""
