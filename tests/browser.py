"""Opens pages in a headless browser and tells what went wrong in them; used by tests of pages.

Speaks the DevTools protocol of Chromium over a pipe, so it needs the browser and nothing else. `TOUCHNET_BROWSER` names
another one. No host name resolves in it and no server but one on this machine can be reached.
"""

import atexit
import base64
import contextlib
import io
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PATIENCE = 60.0  # seconds that anything may take; software WebGL on a busy machine is slow


def find_browser() -> str | None:
    """The path of a Chromium, `None` where there is none."""
    if sys.platform == "win32":  # no descriptors can be handed to it there
        return None
    given = os.environ.get("TOUCHNET_BROWSER")
    return shutil.which(given) if given else next((path for name in NAMES if (path := shutil.which(name))), None)


def need_browser() -> str:
    """The path of a Chromium; skips the test where there is none."""
    path = find_browser()
    if path is None:
        pytest.skip("no headless browser: install chromium-headless-shell or chromium, or name one in TOUCHNET_BROWSER")
    return path


class Page:
    """A page in the browser; what it says about itself is collected while any method runs."""

    def __init__(self, browser: "_Browser", target: str, width: int, height: int, dark: bool) -> None:
        self.errors: list[str] = []  # uncaught exceptions, console.error, failed assertions, the browser's own errors
        self.requests: list[str] = []  # every address asked for, inlined ones (data:, blob:) apart
        self.failed: list[str] = []  # requests without an answer, or with a status of 400 or more
        self._origin: str | None = None
        self._asked: dict[str, str] = {}
        self._loaded = False
        self._browser = browser
        self._session = browser.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        browser.listeners[self._session] = self._hear
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)

    @property
    def outside(self) -> list[str]:
        """Requests for anything but the page itself and, of a page that a server sends, more of that server."""
        return [address for address in self.requests if _origin(address) != self._origin]

    @property
    def broken_pictures(self) -> list[str]:
        """The addresses (their beginnings) of <img> that have not loaded."""
        return self.evaluate(
            "[...document.images].filter(i => !i.complete || !i.naturalWidth).map(i => i.src.slice(0, 80))"
        )

    def check(self) -> None:
        """Fails if the page threw or reported an error, asked for anything outside, or lacks something."""
        self.evaluate("new Promise(done => requestAnimationFrame(() => setTimeout(done)))")
        assert not self.errors, self.errors
        assert not self.outside, self.outside
        assert not self.failed, self.failed
        assert not self.broken_pictures, self.broken_pictures

    def open(self, address: str) -> None:
        """Loads a page and waits until it has loaded."""
        self._origin, self._loaded = _origin(address), False
        answer = self.call("Page.navigate", url=address)
        assert "errorText" not in answer, f"{address}: {answer['errorText']}"
        self._browser.wait(lambda: self._loaded, f"{address} to load")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A method of the DevTools protocol."""
        return self._browser.call(method, session=self._session, **params)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression (as JSON goes); of a promise what it comes to."""
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise AssertionError(f"{expression}: {_thrown(answer['exceptionDetails'])}")
        return answer["result"].get("value")

    def wait_for(self, expression: str, *, seconds: float = PATIENCE) -> Any:
        """Evaluates an expression until it is true; returns its value."""
        end = time.monotonic() + seconds
        while not (value := self.evaluate(expression)):
            assert time.monotonic() < end, f"{expression} did not become true in {seconds} s; errors: {self.errors}"
            time.sleep(0.05)
        return value

    def click(self, selector: str) -> None:
        """Presses and releases the mouse in the middle of an element, whatever lies above it."""
        self._scroll(selector)
        x, y = self._middle(selector)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def drag(self, selector: str, dx: float, dy: float) -> None:
        """Drags from the middle of an element by (dx, dy) pixels, downwards positive."""
        x, y = self._middle(selector)
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", clickCount=1)
        for step in (0.5, 1.0):
            place = {"x": x + step * dx, "y": y + step * dy}
            self.call("Input.dispatchMouseEvent", type="mouseMoved", **place, button="left", buttons=1)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", **place, button="left", clickCount=1)

    def press(self, key: str) -> None:
        """Presses a key such as "ArrowRight" or "a" where the focus is."""
        code = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "Home": 36, "End": 35}.get(key)
        text = {"text": key} if len(key) == 1 else {}
        numbered = {} if code is None else {"windowsVirtualKeyCode": code}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text, **numbered)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, **numbered)

    def screenshot(self, path: str | os.PathLike[str] | None = None, *, whole: bool = False) -> NDArray[np.uint8]:
        """The picture (H, W, 3) of the window, or of the whole page; also written to `path` where given."""
        answer = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        png = base64.b64decode(answer["data"])
        if path is not None:
            Path(path).write_bytes(png)
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))

    def _scroll(self, selector: str) -> None:
        self.evaluate(f"document.querySelector({json.dumps(selector)}).scrollIntoView({{block: 'nearest'}})")

    def _middle(self, selector: str) -> tuple[float, float]:
        box = self.evaluate(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().toJSON()")
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def _hear(self, method: str, params: dict[str, Any]) -> None:
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Runtime.exceptionThrown":
            self.errors.append(_thrown(params["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(arg.get("value", arg.get("description"))) for arg in params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            entry = params["entry"]
            self.errors.append(" ".join([entry["text"], entry.get("url", "")[:200]]).strip())
        elif method == "Network.requestWillBeSent":
            address = params["request"]["url"]
            if not address.startswith(("data:", "blob:")):
                self.requests.append(address)
            self._asked[params["requestId"]] = address[:200]
        elif method == "Network.webSocketCreated":
            self.requests.append(params["url"])
        elif method == "Network.loadingFailed" and not params.get("canceled"):
            self.failed.append(f"{self._asked.get(params['requestId'])}: {params['errorText']}")
        elif method == "Network.responseReceived" and params["response"]["status"] >= 400:
            self.failed.append(f"{params['response']['url'][:200]}: {params['response']['status']}")


@contextlib.contextmanager
def open_page(
    what: str | os.PathLike[str], *, width: int = 1280, height: int = 800, dark: bool = False
) -> Iterator[Page]:
    """Opens a file or an address in a headless browser; skips the test where there is none.

    The browser starts with the first page and stays for the others; each has its own cookies, storage and cache.

    Args:
        what: the path of a file, or an address that starts with http:, https: or file:.
        width: of the window, in pixels.
        height: of the window, in pixels.
        dark: what the page is told of the user's colour scheme.
    """
    address = str(what)
    if not address.startswith(("http:", "https:", "file:")):
        address = Path(what).resolve(strict=True).as_uri()
    browser = _Browser.running()
    context = browser.call("Target.createBrowserContext")["browserContextId"]
    try:
        target = browser.call("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        page = Page(browser, target, width, height, dark)
        page.open(address)
        yield page
    finally:
        with contextlib.suppress(OSError, AssertionError):  # it may have crashed
            browser.call("Target.disposeBrowserContext", browserContextId=context)


def _origin(address: str) -> str:
    """Scheme, host and port; of a file its whole address, since a page may not lean on its neighbours."""
    parts = urlsplit(address)
    if parts.scheme == "file":
        return address.partition("#")[0]
    scheme = {"ws": "http", "wss": "https"}.get(parts.scheme, parts.scheme)
    return f"{scheme}://{parts.netloc}"


def _thrown(details: dict[str, Any]) -> str:
    return details.get("exception", {}).get("description") or details["text"]


class _Browser:
    """A browser and the pipe to it."""

    _last: "_Browser | None" = None

    OPTIONS = (
        "--headless",
        "--remote-debugging-pipe",
        "--no-sandbox",  # root in a container cannot have one; the pages are our own
        "--no-first-run",
        "--disable-gpu",
        "--use-angle=swiftshader",  # WebGL without a graphics card
        "--enable-unsafe-swiftshader",
        "--disable-dev-shm-usage",  # small in containers
        "--disable-background-networking",
        "--disable-component-update",
        "--hide-scrollbars",
        "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE localhost , EXCLUDE 127.0.0.1",
    )

    def __init__(self, path: str) -> None:
        self.listeners: dict[str, Any] = {}
        self._answers: dict[int, dict[str, Any]] = {}
        self._sent = 0
        self._rest = b""
        self._home = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        command = [path, *self.OPTIONS, f"--user-data-dir={self._home.name}"]
        self._process = subprocess.Popen(
            # The browser reads descriptor 3 and writes to descriptor 4.
            ["/bin/sh", "-c", 'exec "$@" 3<&0 4>&1 </dev/null >/dev/null', "sh", *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
        )

    @classmethod
    def running(cls) -> "_Browser":
        """The browser of this process; a new one where there is none or the last one has ended."""
        if cls._last is None or cls._last._process.poll() is not None:
            cls._last = cls(need_browser())
            atexit.register(cls._last.close)
        return cls._last

    def close(self) -> None:
        with contextlib.suppress(OSError, AssertionError):
            self.call("Browser.close")
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()
        self._home.cleanup()

    def call(self, method: str, *, session: str | None = None, **params: Any) -> dict[str, Any]:
        self._sent += 1
        number = self._sent
        message = {"id": number, "method": method, "params": params} | ({"sessionId": session} if session else {})
        self._write(json.dumps(message).encode() + b"\0")
        self.wait(lambda: number in self._answers, method)
        answer = self._answers.pop(number)
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def wait(self, done: Any, what: str) -> None:
        """Reads messages until `done()`."""
        end = time.monotonic() + PATIENCE
        while not done():
            ready, _, _ = select.select([self._process.stdout], [], [], max(0.0, end - time.monotonic()))
            assert ready, f"waited {PATIENCE} s for {what}"
            came = os.read(self._process.stdout.fileno(), 1 << 20)
            assert came, f"the browser ended while waiting for {what}, exit status {self._process.poll()}"
            *messages, self._rest = (self._rest + came).split(b"\0")
            for message in map(json.loads, messages):
                if "id" in message:
                    self._answers[message["id"]] = message
                elif listener := self.listeners.get(message.get("sessionId")):
                    listener(message["method"], message["params"])

    def _write(self, data: bytes) -> None:
        while data:  # a raw pipe takes what fits
            data = data[self._process.stdin.write(data) :]
