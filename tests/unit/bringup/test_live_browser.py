"""The live page in a headless Chromium: it loads, moves, and outlives its server."""

import shutil
import time

import pytest
from live_feed import Feed

from deepseis_bringup.live.guard import Guard
from deepseis_bringup.live.model import LiveModel
from deepseis_bringup.live.server import PageServer

TOKEN = "correct horse battery staple"
PATIENCE_MS = 30_000
"""For a busy machine; on a quiet one everything here takes tenths of seconds."""


@pytest.fixture(scope="module")
def chromium():
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if program is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


class Station:
    """A server with a feed at the pace of the clock; its motion, or all of it, may die."""

    def __init__(self, port=0, guard=None, **feed):
        self.late, self.lives = 0.0, True
        self.model = LiveModel(lambda: time.monotonic() + self.late)
        self.feed = Feed(self.model, **feed)
        self.feed.advance(6.0)
        self.begun = time.monotonic() - self.feed.seconds
        guard = guard or Guard("127.0.0.1")
        self.server = PageServer(self.model, guard, port, self.say)
        self.server.start()

    def say(self):
        behind = time.monotonic() - self.begun - self.feed.seconds
        steps = range(min(25, int(behind / 0.02)))
        for _ in steps:
            if self.lives:
                self.feed.block()
                continue
            last = self.feed.step * 80_000
            self.model.take_source(last, time.time_ns())
            self.feed.slow(last)
            self.feed.step += 1


@pytest.fixture
def station():
    stations = []

    def start(**how):
        stations.append(Station(**how))
        return stations[-1]

    yield start
    for one in stations:
        one.server.close()


@pytest.fixture
def opened(chromium):
    pages = []

    def open_page(station, path="", **how):
        page = chromium.new_context(**how).new_page()
        page.set_default_timeout(PATIENCE_MS)
        pages.append(page)
        page.complaints = []
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.on("console", lambda said: page.complaints.append(said.text))
        page.goto(f"http://127.0.0.1:{station.server.port}/{path}")
        return page

    yield open_page
    for page in pages:
        page.context.close()


def until(page, expression, arg=None):
    """Wait for something to be true; Playwright's own way needs `eval`, which the page forbids."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(expression, arg):
        assert time.monotonic() < deadline, expression
        page.wait_for_timeout(30)


def drawn(page, more=3):
    """Wait until the page has drawn some more pictures."""
    until(page, "globalThis.deepseis !== undefined")
    before = page.evaluate("deepseis.view.drawn")
    until(page, f"deepseis.view.drawn >= {before + more}")


def picture(page, name):
    return page.evaluate(f"document.getElementById('{name}').toDataURL()")


def test_the_page_moves_and_shows_the_event(station, opened):
    page = opened(station(quake_s=1.0), viewport={"width": 1400, "height": 900})
    drawn(page)
    first = {name: picture(page, name) for name in ("acceleration", "displacement", "innovation")}
    clock = page.text_content("#utc")
    until(page, f"document.getElementById('utc').textContent !== '{clock}'")
    drawn(page)
    assert all(picture(page, name) != before for name, before in first.items())
    assert page.text_content("#event-title") == "Event in progress"
    assert page.text_content("#pga").startswith("19.6m/s²")
    assert page.text_content("#station") == "JP.DSEI"
    assert page.locator("#satellites tbody tr").count() == 9
    assert page.locator("#skyplot .sat.aided").count() == 7
    assert "live" in page.text_content("#link")
    assert not page.complaints


PEAKS = """async (positions) => {
  const { drawEnvelope } = await import(new URL("page/canvas.js", location));
  const { Ring } = await import(new URL("page/store.js", location));
  const context = new OffscreenCanvas(300, 100).getContext("2d");
  return positions.map((position) => {
    const ring = new Ring(12000, 1, 0.005);
    const values = new Float32Array(12000);
    values[position] = 80;
    ring.push(Float64Array.from(values, (_, k) => k * 0.005), values);
    context.clearRect(0, 0, 300, 100);
    drawEnvelope(context, { ring }, 0, ring.begin, (t) => 5 * t, (v) => 90 - v, 1);
    const { data } = context.getImageData(0, 0, 300, 100);
    return data.findIndex((alpha, k) => k % 4 === 3 && alpha > 60) / 1200;
  });
}"""


def test_a_peak_of_one_sample_in_forty_a_pixel_is_drawn_to_its_height(station, opened):
    page = opened(station())
    rows = page.evaluate(PEAKS, [0, 1, 19, 20, 21, 4567, 11_980, 11_999])
    assert [int(row) for row in rows] == pytest.approx([10] * 8, abs=1)  # of 100, downwards


def test_a_node_that_dies_is_seen(station, opened):
    one = station()
    page = opened(one)
    drawn(page)
    assert page.locator("section.stale").count() == 0
    one.lives, one.late = False, 10.0  # ten seconds later by the model's clock
    page.wait_for_selector("#traces.stale")
    assert "silent for" in page.text_content("#traces .tag")
    page.wait_for_selector("#stillness:not(.stale)")  # that one goes on, with its next word
    assert "live" in page.text_content("#link")
    one.lives = True
    page.wait_for_selector("#traces:not(.stale)")


def test_the_page_outlives_its_server(station, opened):
    one = station()
    page = opened(one)
    drawn(page)
    one.server.close()
    page.wait_for_selector("#banner:has-text('No connection')")
    assert "no connection" in page.text_content("#link")
    newest = page.evaluate("deepseis.store.newest")
    station(port=one.server.port)
    page.wait_for_selector("#banner", state="hidden")
    drawn(page)
    assert "live" in page.text_content("#link")
    assert 0 < page.evaluate("deepseis.store.newest") != newest
    assert page.evaluate("deepseis.view.frame") < 1000


def test_on_a_phone_in_the_dark(station, opened):
    size = {"width": 390, "height": 844}
    page = opened(station(), viewport=size, color_scheme="dark", is_mobile=True)
    drawn(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    red, green, blue = page.evaluate(
        "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"
    )
    assert max(red, green, blue) < 40
    width = page.evaluate("acceleration.getBoundingClientRect().width")
    assert 330 < width < 390


def test_the_token_is_asked_for_once(station, opened):
    one = station(guard=Guard("127.0.0.1", TOKEN))
    page = opened(one)
    page.fill("#token", TOKEN)
    page.click("button")
    page.wait_for_selector("#acceleration")
    drawn(page)
    page.reload()
    drawn(page)
    wall = opened(one, f"#token={TOKEN}")
    wall.wait_for_selector("#acceleration")
    drawn(wall)
    assert "token" not in wall.url
