"""The live page's server, without a browser: read-only, guarded, bounded for slow browsers."""

import asyncio
import itertools
import json
import time

import aiohttp
import pytest
from live_feed import Feed
from unit.bringup.test_live_model import opened

from deepseis_bringup.live import viewer
from deepseis_bringup.live.guard import Guard
from deepseis_bringup.live.model import LiveModel
from deepseis_bringup.live.server import PageServer
from deepseis_core.errors import InputError

TOKEN = "correct horse battery staple"


@pytest.fixture
def serve():
    servers = []

    def start(guard=None, feed=lambda: None, model=None):
        server = PageServer(model or LiveModel(), guard or Guard("127.0.0.1"), 0, feed)
        server.start()
        servers.append(server)
        return server

    yield start
    for server in servers:
        server.close()


def ask(server, path="", method="GET", **options):
    """Return status, headers and text."""

    async def work():
        url = f"http://127.0.0.1:{server.port}/{path}"
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
            options.setdefault("allow_redirects", False)
            async with session.request(method, url, **options) as answer:
                return answer.status, answer.headers, await answer.text()

    return asyncio.run(work())


def test_the_page_is_whole_and_asks_nobody_else(serve):
    server = serve()
    status, headers, text = ask(server)
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "unsafe" not in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Server"] == "DeepSeis"
    for name, asset in server.assets.items():
        status, headers, _ = ask(server, f"page/{name}")
        assert (status, headers["Content-Type"].split(";")[0]) == (200, asset.content_type)
        local = asset.data.replace(b"http://www.w3.org/2000/svg", b"")
        assert b"http://" not in local
        assert b"https://" not in local
        assert b" style=" not in local
    assert "<script>" not in text
    assert ask(server, "page/main.js", headers={"If-None-Match": headers["ETag"]})[0] == 200
    tag = ask(server, "page/main.js")[1]["ETag"]
    assert ask(server, "page/main.js", headers={"If-None-Match": tag})[0] == 304


@pytest.mark.parametrize(
    "path", ["x", "page/", "page/none.js", "page/..%2f..%2fserver.py", "login"]
)
def test_there_is_nothing_else(serve, path):
    assert ask(serve(), path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
@pytest.mark.parametrize("path", ["", "state", "live", "page/main.js"])
def test_nothing_can_be_written(serve, method, path):
    assert ask(serve(), path, method)[0] == 405


def test_a_name_that_was_not_given_is_refused(serve):
    server = serve()
    for path in ("", "state", "live", "page/main.js"):
        assert ask(server, path, headers={"Host": "evil.example"})[0] == 421
    assert ask(server, headers={"Host": "localhost:1"})[0] == 200


def test_without_the_token_there_is_only_the_form(serve):
    server = serve(Guard("127.0.0.1", TOKEN))
    for path in ("", "state", "live", "page/main.js", "page/index.html"):
        status, headers, text = ask(server, path)
        assert (status, headers["WWW-Authenticate"]) == (401, "Bearer")
        assert "<form" in text
    assert ask(server, "page/style.css")[0] == 200
    given = {"Authorization": f"Bearer {TOKEN}"}
    assert ask(server, "state", headers=given)[0] == 200


def test_the_form_gives_a_cookie_that_outlives_the_server(serve):
    server = serve(Guard("127.0.0.1", TOKEN))
    status, headers, _ = ask(server, "login", "POST", data={"token": TOKEN})
    assert (status, headers["Location"]) == (303, "./")
    cookie = headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert "Secure" not in cookie
    assert TOKEN not in cookie
    value = cookie.partition(";")[0].partition("=")[2]
    for same in (server, serve(Guard("127.0.0.1", TOKEN))):
        assert ask(same, cookies={same._cookie: value})[0] == 200
    other = serve(Guard("127.0.0.1", TOKEN + "!"))
    assert ask(other, cookies={other._cookie: value})[0] == 401
    secure = {"X-Forwarded-Proto": "https"}
    status, headers, _ = ask(server, "login", "POST", data={"token": TOKEN}, headers=secure)
    assert "Secure" in headers["Set-Cookie"]


def test_a_wrong_token_gets_the_form_again_and_has_to_wait(serve):
    server = serve(Guard("127.0.0.1", TOKEN))
    began = time.monotonic()
    status, headers, text = ask(server, "login", "POST", data={"token": TOKEN[:-1]})
    assert status == 403
    assert time.monotonic() - began >= 0.5
    assert "Set-Cookie" not in headers
    assert "<form" in text


def test_a_port_that_is_taken_is_told_in_one_line(serve):
    server = serve()
    with pytest.raises(InputError, match=f"port {server.port}: Address already in use"):
        PageServer(LiveModel(), Guard("127.0.0.1"), server.port)


def listen(server, work, **options):
    """Connect as the page does; ``work(socket)``."""

    async def run():
        url = f"http://127.0.0.1:{server.port}/live"
        async with aiohttp.ClientSession() as session, session.ws_connect(url, **options) as live:
            return await work(live)

    return asyncio.run(run())


def fed():
    model = LiveModel()
    feed = Feed(model)
    feed.advance(2.0)
    return model, lambda: feed.advance(0.04)


def test_a_browser_that_shows_frames_gets_more(serve):
    model, feed = fed()

    async def work(live):
        frames = []
        while len(frames) < 12:
            header, blocks = opened(await live.receive_bytes(timeout=10))
            frames.append((header, blocks))
            await live.send_str(f"s{header['frame']}")
        return frames

    frames = listen(serve(model=model, feed=feed), work)
    assert [header["frame"] for header, _ in frames] == list(range(1, 13))
    times = [time for _, blocks in frames for time in blocks.get(("motion", 0), ([], []))[1]]
    assert max(abs(b - a - 0.005) for a, b in itertools.pairwise(times)) < 1e-6
    shown = [header["state"]["shown"] for header, _ in frames if "state" in header]
    assert shown[-1]["median_ms"] >= 60.0  # the source was 60 ms before the motion


def test_a_browser_that_shows_nothing_gets_no_more_than_a_few_frames(serve):
    model, feed = fed()
    server = serve(model=model, feed=feed)

    async def work(live):
        for _ in range(viewer.AHEAD):
            header, blocks = opened(await live.receive_bytes(timeout=10))
        last = blocks["motion", 0][1][-1]
        with pytest.raises(asyncio.TimeoutError):
            await live.receive_bytes(timeout=0.6)
        newest = model.traces["motion"].newest
        await live.send_str(f"r{header['frame']}")
        header, blocks = opened(await live.receive_bytes(timeout=10))
        return last, newest, header, blocks["motion", 0][1]

    last, newest, header, times = listen(server, work)
    assert header["frame"] == viewer.AHEAD + 1
    assert times[0] == pytest.approx(last + 0.005)  # what came meanwhile, in one frame
    assert times[-1] >= newest > last


@pytest.mark.parametrize(
    "words", ["stop", "s", "s-1", '{"pll_bandwidth_hz": 1}', "s1 s2", "x" * 500]
)
def test_a_browser_that_says_anything_else_is_left(serve, words):
    async def work(live):
        await live.send_str(words)
        while not live.closed:
            await live.receive(timeout=10)

    listen(serve(), work)


def test_only_the_page_itself_may_listen(serve):
    async def nothing(_live):
        pass

    server = serve()
    with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
        listen(server, nothing, headers={"Origin": "http://evil.example"})
    listen(server, nothing, headers={"Origin": f"http://127.0.0.1:{server.port}"})
    guarded = serve(Guard("127.0.0.1", TOKEN))
    with pytest.raises(aiohttp.WSServerHandshakeError, match="401"):
        listen(guarded, nothing)
    listen(guarded, nothing, headers={"Authorization": f"Bearer {TOKEN}"})


def test_a_program_can_ask_for_the_state(serve):
    model, _ = fed()
    status, headers, text = ask(serve(model=model), "state")
    assert status == 200
    assert headers["Content-Type"].startswith("application/json")
    told = json.loads(text)
    assert told["station"]["name"] == "DSEI"
    assert len(told["satellites"]) == 9
