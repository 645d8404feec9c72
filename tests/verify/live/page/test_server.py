"""The page over HTTP and in a browser, and access to it."""

import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import robots
from tests.support.devices.chromium import Browser, Tab, phone_sections
from tests.support.processes import wait_until
from tests.support.spot_level import HOME, facing_rig
from verify.core.records import Measurement, Sighting, StereoPair
from verify.errors import InputError
from verify.live.alarms.joints import AlarmLimits
from verify.live.clock import LiveClock
from verify.live.joint_row import JointRow
from verify.live.outputs.metrics import MetricsServer
from verify.live.page.access import check_access
from verify.live.page.feed import Page
from verify.live.page.run import RunFacts, RunPageSource
from verify.live.page.server import CONNECTION_TIMEOUT
from verify.live.protocols import Alarm, MonitoredRobot
from verify.live.state import DeviceStatus, LiveState

HOSTILE = "<b>bold</b><script>document.title='taken'</script><img src=x onerror=document.title='x'>"
TOKEN = "a-token-that-nobody-guesses"
ARM = robots.load("iust_6r")
RIG, MARKER = facing_rig()


class Playing:
    """A state that fills as a run would fill it."""

    def __init__(self, description: str = "played") -> None:
        self.state = LiveState()
        subject = MonitoredRobot(ARM, RIG, MARKER, None)
        facts = RunFacts(
            "iust_6r", description, AlarmLimits(0.1, 30.0, np.full(6, np.deg2rad(0.2)))
        )
        self.source = RunPageSource(self.state, subject, facts)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)

    def __enter__(self) -> "Playing":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _play(self) -> None:
        frame = 0
        alarm = Alarm(1, "tolerance", time.time(), 0.0, f"Joint 4 {HOSTILE}", (4,), 0.01, 0.001)
        self.state.alarm(alarm)
        while not self._stop.wait(1 / 30):
            frame += 1
            self.state.row(played_row(frame), np.full(6, 0.4))
            self.state.pictures = played_pictures(frame)
            lines = (DeviceStatus("left camera", True, f"reading {HOSTILE}"),)
            self.state.set_status(lines, {"no partner in time": 2}, "kept")


def played_row(frame: int) -> JointRow:
    error = np.deg2rad(0.1 * np.sin(frame / 20 + np.arange(6)))
    pose = robots.forward(ARM, HOME)
    return JointRow(
        frame, frame / 30, "measured", 4, HOME, HOME + error, error, np.full(6, 5e-4), error,
        LiveClock(0.1, 1e-4, "estimated"), pose, robots.forward(ARM, HOME + error),
    )  # fmt: skip


def played_pictures(frame: int) -> tuple[StereoPair, Measurement]:
    image = np.full((720, 1280), 40 + frame % 100, dtype=np.uint8)
    seen = Sighting(
        np.arange(4), np.array([[300.0, 200], [500, 250], [420, 400], [640, 300]]),
        np.tile(np.eye(2), (4, 1, 1)), 0.0, 0.0, np.ones(4), np.zeros((4, 2)), np.zeros(4),
    )  # fmt: skip
    pair = StereoPair(frame, 0.0, 0.0, 0.0, 0.0, image, image)
    return pair, Measurement(frame, 0.0, "measured", 4, left=seen, right=seen)


@pytest.fixture(scope="module")
def served() -> Iterator[Page]:
    with Playing(HOSTILE) as playing:
        page = Page(playing.source, 0)
        yield page
        page.close()


def port(page: Page) -> int:
    return int(page.url.split(":")[2].split("/")[0])


@dataclass(frozen=True)
class Answer:
    status: int
    headers: http.client.HTTPMessage
    text: str


def get(page: Page | int, path: str = "/", **headers: str) -> Answer:
    number = page if isinstance(page, int) else port(page)
    with closing(http.client.HTTPConnection("127.0.0.1", number, timeout=20)) as line:
        line.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in headers.items():
            line.putheader(name, value)
        line.endheaders()
        answer = line.getresponse()
        return Answer(answer.status, answer.headers, answer.read().decode())


def test_the_page_comes_with_a_policy_that_runs_no_foreign_script(served: Page) -> None:
    answer = get(served)
    assert answer.status == 200
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    for outside in ("http://", "https://", "//cdn", "<style", "onclick"):
        assert outside not in answer.text


@pytest.mark.realtime
def test_another_host_name_is_refused(served: Page) -> None:
    answer = get(served, Host=f"evil.example:{port(served)}")
    assert answer.status == 403
    assert "127.0.0.1" in answer.text
    assert get(served, "/metrics", Host="evil.example").status == 403


@pytest.mark.realtime
def test_only_the_pages_own_files_are_served(served: Page) -> None:
    for path in ("/../access.py", "/%2e%2e/access.py", "/server.py", "/etc/passwd"):
        assert get(served, path).status == 404


@pytest.mark.realtime
@pytest.mark.parametrize("origin", ["http://evil.example", "null", None, "http://127.0.0.1:1"])
def test_another_origin_s_script_gets_no_line(served: Page, origin: Any) -> None:
    with pytest.raises((InvalidStatus, ConnectionClosed)):  # noqa: SIM117
        with connect(f"ws://127.0.0.1:{port(served)}/live", origin=origin) as line:
            line.recv(timeout=5)


def own(page: Page) -> Any:
    """A viewer; it takes what comes, so that it need not be read for its line to close."""
    host = f"127.0.0.1:{port(page)}"
    return connect(f"ws://{host}/live", origin=f"http://{host}", max_queue=None)


def test_the_page_gets_all_data_as_json(served: Page) -> None:
    kinds, pictures = set(), 0
    with own(served) as line:
        for _ in range(60):
            message = line.recv(timeout=20)
            if isinstance(message, bytes):
                pictures += 1
                length = int.from_bytes(message[1:5], "big")
                assert len(json.loads(message[5 : 5 + length])["leds"]) == 4
                assert message[5 + length : 7 + length] == b"\xff\xd8"  # a JPEG begins
            else:
                kinds.add(json.loads(message)["type"])
    assert kinds == {"hello", "state", "alarms", "rows"}
    assert pictures


@pytest.mark.realtime
def test_pictures_are_encoded_once_and_only_for_viewers() -> None:
    with Playing() as playing:
        source, calls = playing.source, []
        given = source.pictures
        source.pictures = lambda: calls.append(time.monotonic()) or given()  # type: ignore[method-assign, func-returns-value, return-value]
        page = Page(source, 0)
        assert not calls
        with ExitStack() as stack:
            lines = [stack.enter_context(own(page)) for _ in range(20)]
            wait_until(lambda: page.viewers == 20, 30.0)
            begin = len(calls)
            for line in lines:
                line.recv(timeout=20)
            time.sleep(1.0)
            assert len(calls) - begin <= 30  # ten a second, whoever looks
        wait_until(lambda: page.viewers == 0, 30.0)
        page.close()


@pytest.mark.realtime
def test_half_requests_and_idle_lines_end_and_keep_nobody_out(served: Page) -> None:
    slow_body = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n1"
    starts = [b""] * 200 + [b"GET", b"GET / HTTP/1.1\r\nHost: 127", slow_body]
    with ExitStack() as stack, own(served) as viewer:
        address = ("127.0.0.1", port(served))
        lines = [stack.enter_context(socket.create_connection(address)) for _ in starts]
        for line, start in zip(lines, starts, strict=True):
            line.sendall(start)
        assert get(served).status == 200
        for line in lines:
            line.settimeout(CONNECTION_TIMEOUT + 20.0)
            with suppress(ConnectionResetError):
                while line.recv(1 << 12):
                    pass
        assert viewer.recv(timeout=20)


@pytest.mark.realtime
def test_metrics_are_prometheus_text(served: Page) -> None:
    wait_until(lambda: "verify_joint_error_degrees" in get(served, "/metrics").text, 30.0)
    text = get(served, "/metrics").text
    assert "# TYPE verify_joint_error_degrees gauge" in text
    assert 'verify_joint_error_degrees{joint="6"}' in text
    assert 'verify_dropped_total{reason="no partner in time"} 2' in text


def test_another_address_needs_a_random_token() -> None:
    with pytest.raises(InputError, match="token"):
        check_access("0.0.0.0", 1, None)
    with pytest.raises(InputError, match="at least"):
        check_access("0.0.0.0", 1, "short")
    assert check_access("::1", 1, None).token is None


@pytest.mark.parametrize("host", ["127.0.0.2", "[::1]", "127.0.0.1", "localhost"])
def test_the_page_answers_under_the_loopback_address_that_it_is_served_at(host: str) -> None:
    access = check_access(host.strip("[]"), 8646, None)
    assert access.refusal({"host": f"{host}:8646"}, None, script=False) is None
    refused = access.refusal({"host": "elsewhere.example:8646"}, None, script=False)
    assert refused is not None
    assert f"open http://{host}:8646/" in refused


@pytest.mark.realtime
def test_the_token_opens_the_page_once_and_then_the_cookie_does() -> None:
    with Playing() as playing:
        page = Page(playing.source, 0, "0.0.0.0", TOKEN)
        assert get(page).status == 403
        assert get(page, "/?token=wrong").status == 403
        answer = get(page, f"/?token={TOKEN}")
        assert answer.status == 303
        assert answer.headers["Location"] == "/"
        cookie = answer.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "samesite=strict" in cookie.lower()
        kept = cookie.split(";")[0]
        assert get(page, Cookie=kept).status == 200
        assert get(page, "/metrics", Authorization=f"Bearer {TOKEN}").status == 200
        host = f"127.0.0.1:{port(page)}"
        with pytest.raises((InvalidStatus, ConnectionClosed)):  # noqa: SIM117
            with connect(f"ws://{host}/live", origin=f"http://{host}") as line:
                line.recv(timeout=5)
        with connect(
            f"ws://{host}/live", origin=f"http://{host}", additional_headers={"Cookie": kept}
        ) as line:
            assert json.loads(line.recv(timeout=20))["type"] == "hello"
        page.close()


@pytest.mark.realtime
def test_a_taken_port_is_reported_in_one_line(served: Page) -> None:
    with Playing() as playing, pytest.raises(InputError, match="taken"):
        Page(playing.source, port(served))


@pytest.mark.realtime
def test_an_address_of_another_computer_is_reported_as_that() -> None:
    with Playing() as playing, pytest.raises(InputError, match=r"has no address 192\.0\.2\.1"):
        Page(playing.source, 0, "192.0.2.1", "0123456789abcdef")


@pytest.mark.realtime
def test_metrics_have_an_address_of_their_own_where_no_page_is_wanted() -> None:
    with pytest.raises(InputError, match="HOST:PORT"):
        MetricsServer("nowhere", str)
    server = MetricsServer("127.0.0.1:0", lambda: "verify_pairs_total 1\n")
    text = "verify_pairs_total 1\n"
    for path, origin, status in (
        ("/metrics", {}, 200), ("/", {}, 404), ("/metrics", {"Origin": "http://x"}, 403),
        ("/metrics", {"Host": f"localhost:{server.port}"}, 200),
        ("/metrics", {"Host": f"evil.example:{server.port}"}, 403),
    ):  # fmt: skip
        answer = get(server.port, path, **origin)
        assert answer.status == status
        assert (answer.text == text) == (status == 200)
        assert "verify_pairs" not in answer.text or status == 200
    server.close()


@pytest.mark.realtime
def test_metrics_are_served_at_an_address_of_version_6() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:  # a machine without such addresses
        with pytest.raises(InputError, match="cannot be served"):
            MetricsServer("[::1]:0", str)
        return
    server = MetricsServer("[::1]:0", lambda: "verify_pairs_total 1\n")
    with urlopen(f"http://[::1]:{server.port}/metrics", timeout=10) as answer:
        assert answer.read() == b"verify_pairs_total 1\n"
    server.close()


# in the browser


LIVE = "document.querySelector('#connection')?.textContent === 'live'"
INK = """id => { const c = document.getElementById(id) ?? document.querySelector(id);
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 0; i < d.length; i += 4) n += d[i + 3] > 0 && d[i] + d[i+1] + d[i+2] > 0;
  return n / (d.length / 4); }"""
KINDS = """selector => { const c = document.querySelector(selector);
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  const seen = { measured: 0, band: 0, tolerance: 0 };
  for (let i = 0; i < d.length; i += 4) {
    const [r, g, b, a] = d.slice(i, i + 4);
    if (a === 255 && b > r + 100) seen.measured++;
    else if (a && a < 90 && b > r + 100) seen.band++;
    else if (r > g + 30 && b > g + 20) seen.tolerance++;
  }
  return seen; }"""  # by their colours in style.css, light: blue, thin blue, purple


@contextmanager
def looking(browser: Browser, page: Page, *size: int, scheme: str = "light") -> Iterator[Tab]:
    with browser.open(page.url, *size, scheme=scheme) as tab:
        tab.until(LIVE)
        tab.until("document.querySelectorAll('.strip canvas').length === 6")
        yield tab


@pytest.mark.browser
def test_the_browser_draws_and_keeps_drawing(browser: Browser, served: Page) -> None:
    with looking(browser, served) as tab:
        tab.until("document.querySelector('#left').ariaLabel.includes('4 of 4')")
        assert tab.evaluate(f"({INK})('left')") > 0.9
        tab.until(f"({INK})('scene') > 0.01")
        before = tab.text(".strip .value")
        tab.until(f"document.querySelector('.strip .value').innerText !== {before!r}")
        assert tab.complaints == []


@pytest.mark.browser
def test_a_strip_shows_error_band_and_tolerance(browser: Browser, served: Page) -> None:
    with looking(browser, served) as tab:
        tab.until(f"({KINDS})('.strip canvas').measured > 50")
        seen = tab.evaluate(f"({KINDS})('.strip canvas')")
        assert seen["band"] > seen["measured"]
        assert seen["tolerance"] > 20
        assert tab.complaints == []


@pytest.mark.browser
def test_html_in_names_is_shown_as_text(browser: Browser, served: Page) -> None:
    with looking(browser, served) as tab:
        assert tab.text("#description") == HOSTILE
        tab.until("document.querySelector('#devices li') && document.querySelector('#alarms time')")
        for place in ("#devices", "#alarms", "#banner"):
            assert HOSTILE in tab.text(place)
        assert tab.evaluate("document.title") == "iust_6r · verify"
        made = "document.querySelectorAll('#description *, #alarms img, #devices b').length"
        assert tab.evaluate(made) == 0
        assert tab.complaints == []


@pytest.mark.browser
def test_the_browser_comes_back_after_the_server_does(browser: Browser) -> None:
    with Playing("first") as playing:
        page = Page(playing.source, 0)
        where = port(page)
        with looking(browser, page) as tab:
            page.close()
            tab.until("document.querySelector('#connection').className.includes('ill')")
            with Playing("second") as later:
                again = Page(later.source, where)
                tab.until(
                    f"{LIVE} && document.querySelector('#description').textContent === 'second'"
                )
                tab.until("document.querySelectorAll('.strip canvas').length === 6")
                again.close()


@pytest.mark.browser
def test_keys_do_what_the_pointer_does(browser: Browser, served: Page) -> None:
    with looking(browser, served) as tab:
        tab.press("4")
        fourth = "document.querySelectorAll('.strip')[3]"
        assert "tall" in tab.evaluate(f"{fourth}.className")
        tab.until(f"{fourth}.querySelector('canvas').clientHeight > 200")
        tab.press("t")
        assert tab.evaluate("document.documentElement.dataset.theme") == "dark"
        tab.press(" ")
        assert tab.text("#connection") == "paused"
        tab.evaluate("document.querySelector('#scene').focus()")
        tab.evaluate("window.before = document.querySelector('#scene').toDataURL(); 0")
        tab.press("ArrowLeft")
        tab.until("document.querySelector('#scene').toDataURL() !== window.before")
        assert tab.complaints == []


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_scrolls_down_only(browser: Browser, served: Page, scheme: str) -> None:
    with looking(browser, served, 360, 740, scheme=scheme) as tab:
        tab.until("document.querySelector('#devices li')")
        phone_sections(tab, scheme)
        assert tab.complaints == []


LABELS = """async () => {
  const { Strips } = await import("/strips.js");
  const root = document.body.appendChild(document.createElement("div"));
  const strips = new Strips(root), found = [];
  strips.begin(6, [0.02, 0.1, 0.2, 0.5, 1, null]);
  for (const size of [0.02, 0.1, 0.35, 0.8, 1.4, 4, 30]) {
    const [error_deg, u_deg] = [Array(6).fill(size), Array(6).fill(size / 20)];
    strips.rows = Array.from({ length: 50 }, (_, t) => ({ t_s: t / 10, error_deg, u_deg }));
    strips.draw({ band: "#ccc", tolerance: "#808", measured: "#00f", muted: "#555" });
    await new Promise(requestAnimationFrame);
    for (const { plot, mark } of strips.strips)
      found.push([mark, 0, -mark].map((value) => plot.valToPos(value, "y")));
  }
  root.remove();
  return found;
}"""  # where the labels of six strips stand, px from the top, for errors of seven sizes


@pytest.mark.browser
@pytest.mark.parametrize("width", [1300, 500])
def test_labels_of_a_strips_scale_have_room(browser: Browser, served: Page, width: int) -> None:
    with looking(browser, served, width) as tab:
        found = np.array(tab.evaluate(LABELS))
        assert len(found) == 42
        assert np.diff(found).min() > 12  # px: the letters are 11 px high
        assert found.min() > -1  # within the strip
        assert tab.complaints == []


@pytest.mark.browser
def test_the_bar_of_a_joint_in_alarm_is_full(browser: Browser, served: Page) -> None:
    with looking(browser, served) as tab:
        fourth = "document.querySelectorAll('.strip')[3]"
        tab.until(f"{fourth}.innerText.includes('in alarm')")
        wide = "querySelector('.meter').clientWidth"
        fill = f"{fourth}.querySelector('.meter i')"
        assert tab.evaluate(f"{fill}.clientWidth") == tab.evaluate(f"{fourth}.{wide}")
        assert "high" in tab.evaluate(f"{fill}.className")
        third = "document.querySelectorAll('.strip')[2].querySelector('.meter i')"
        assert tab.evaluate(f"{third}.style.width") == "40%"  # as it was played
        assert tab.complaints == []
