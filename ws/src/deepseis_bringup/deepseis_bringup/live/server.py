"""The live page's web server: a thread with a loop of its own, read-only."""

from __future__ import annotations

import asyncio
import logging
import threading
import traceback
from collections.abc import Awaitable, Callable
from typing import Any, Final

from aiohttp import web

from deepseis_bringup.listening import listening
from deepseis_bringup.live.assets import OPEN, digest, read_assets
from deepseis_bringup.live.guard import HEADERS, Guard
from deepseis_bringup.live.model import LiveModel
from deepseis_bringup.live.viewer import Viewer
from deepseis_bringup.live.web_options import PAGE

FEED_S: Final = 0.03
"""Time between looks at the topics [s]."""
MOST_VIEWERS: Final = 20
"""Browsers at a time."""
WRONG_TOKEN_S: Final = 0.5
"""Time that a wrong token costs [s]."""
COOKIE: Final = "deepseis"

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class PageServer:
    """Serves the page of a model, and has it fed, in one thread.

    Parameters
    ----------
    model : LiveModel
        Only this thread touches it after `start`.
    guard : Guard
        Who may look.
    port : int
        0: any that is free; which, says ``port`` afterwards.
    feed : callable, optional
        Called every `FEED_S`: gives the model what is new.
    on_failure : callable, optional
        Told the text of what ended the thread.

    Raises
    ------
    InputError
        The port is taken.
    """

    def __init__(
        self,
        model: LiveModel,
        guard: Guard,
        port: int,
        feed: Callable[[], None] = lambda: None,
        on_failure: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self.model, self.guard, self.feed, self.on_failure = model, guard, feed, on_failure
        self.assets = read_assets()
        self.page = digest(self.assets)
        self.viewers: set[web.WebSocketResponse] = set()
        self._socket = listening(guard.address, port, *PAGE)
        self.port = self._socket.getsockname()[1]
        self._cookie = f"{COOKIE}_{self.port}"  # browsers share cookies between ports
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="live page", daemon=True)

    @property
    def address(self) -> str:
        """Where the page is."""
        host = self.guard.address
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/"

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End; browsers are told."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        except Exception as error:
            traceback.print_exc()
            self.on_failure(f"live page: {error}")
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        logging.getLogger("aiohttp.server").setLevel(logging.CRITICAL)  # scanners send nonsense
        runner = web.AppRunner(
            self.application(), access_log=None, handle_signals=False, shutdown_timeout=1.0
        )
        await runner.setup()
        await web.SockSite(runner, self._socket).start()
        try:
            while not self._stop.is_set():
                self.feed()
                await asyncio.sleep(FEED_S)
        finally:
            for viewer in list(self.viewers):
                await viewer.close(code=1001, message=b"the station ended")
            await runner.cleanup()

    def application(self) -> web.Application:
        """Return the routes."""
        application = web.Application(middlewares=[self._guarded], client_max_size=4096)
        application.router.add_get("/", self._page)
        application.router.add_get("/live", self._live)
        application.router.add_get("/state", self._state)
        application.router.add_get("/page/{name}", self._file)
        if self.guard.token:
            application.router.add_post("/login", self._login)
        application.on_response_prepare.append(_add_headers)
        return application

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse who may not look."""
        if not self.guard.knows_host(request.headers.get("Host")):
            return web.Response(status=421, text="This page is not known by that name.\n")
        if self._is_open(request):
            return await handler(request)
        given = request.headers.get("Authorization", "")
        if self.guard.admits(given, request.cookies.get(self._cookie, "")):
            return await handler(request)
        return self._form(401)

    def _is_open(self, request: web.Request) -> bool:
        name = request.path.removeprefix("/page/")
        return name in OPEN or (request.path == "/login" and request.method == "POST")

    def _form(self, status: int) -> web.Response:
        """Ask for the token."""
        form = self.assets["login.html"]
        headers = {"WWW-Authenticate": "Bearer"}
        return web.Response(
            status=status, body=form.data, content_type=form.content_type, headers=headers
        )

    async def _login(self, request: web.Request) -> web.StreamResponse:
        """Give a cookie for the token."""
        token = (await request.post()).get("token", "")
        if not isinstance(token, str) or not self.guard.is_token(token.strip()):
            await asyncio.sleep(WRONG_TOKEN_S)
            return self._form(403)
        response = web.Response(status=303, headers={"Location": "./"})
        proxied = request.headers.get("X-Forwarded-Proto", "").lower() == "https"
        response.set_cookie(
            self._cookie,
            self.guard.cookie,
            max_age=31_536_000,
            httponly=True,
            samesite="Strict",
            secure=proxied or request.secure,
        )
        return response

    async def _page(self, request: web.Request) -> web.StreamResponse:
        return self._answer(request, "index.html")

    async def _file(self, request: web.Request) -> web.StreamResponse:
        return self._answer(request, request.match_info["name"])

    def _answer(self, request: web.Request, name: str) -> web.Response:
        """Send a file, or say that the browser has it."""
        asset = self.assets.get(name)
        if asset is None:
            raise web.HTTPNotFound
        tag = {"ETag": f'"{asset.tag}"'}
        if request.headers.get("If-None-Match") == tag["ETag"]:
            return web.Response(status=304, headers=tag)
        return web.Response(
            body=asset.data, content_type=asset.content_type, charset="utf-8", headers=tag
        )

    async def _state(self, _request: web.Request) -> web.StreamResponse:
        """Send the present state, for programs."""
        return web.json_response({**self.model.state(), **self._more()})

    def _more(self) -> dict[str, Any]:
        return {"viewers": len(self.viewers), "page": self.page}

    async def _live(self, request: web.Request) -> web.StreamResponse:
        """Send frames to a browser."""
        host = request.headers.get("Host")
        if not self.guard.knows_origin(request.headers.get("Origin"), host):
            return web.Response(status=403, text="Only this page itself may listen.\n")
        if len(self.viewers) >= MOST_VIEWERS:
            return web.Response(status=503, text="Too many look on already.\n")
        live = web.WebSocketResponse(heartbeat=15.0, max_msg_size=64, compress=False)
        await live.prepare(request)
        self.viewers.add(live)
        try:
            await Viewer(self.model, live, self._more).run()
        finally:
            self.viewers.discard(live)
            await live.close()
        return live


async def _add_headers(_request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)
    response.headers["Server"] = "DeepSeis"
