"""The page of a grasp in a browser: drawing, selection, orders, STOP always visible."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.support.devices.chromium import Browser, Tab, phone_sections
from tests.support.grasp.page import STANDS, Cell, grabbing
from verify.grasping.control.states import MOVING_STATES, GraspState
from verify.simulation.cell.scene import Cap, CellScene

pytestmark = pytest.mark.browser
WANDERS = CellScene((Cap("blue", (0.40, -0.20), (0.0, 0.04), 30.0),), seed=2)
YELLOW = """id => { const c = document.getElementById(id);
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0, x = 0, y = 0;
  for (let i = 0; i < d.length; i += 4) if (d[i] > 230 && d[i+1] > 200 && d[i+2] < 110) {
    n++; x += i / 4 % c.width; y += Math.floor(i / 4 / c.width); }
  return [n, x / n / c.width, y / n / c.height]; }"""  # the ellipse: pixels, and its middle, shares


@contextmanager
def looking(browser: Browser, cell: Cell, *size: int, scheme: str = "light") -> Iterator[Tab]:
    with browser.open(cell.page._page.url, *size, scheme=scheme) as tab:
        tab.until("document.querySelector('#connection')?.textContent === 'live'")
        tab.until("document.querySelector('#left').ariaLabel.includes('target')")
        yield tab


def drag(tab: Tab, side: str, box: tuple[int, int, int, int]) -> None:
    """Draw a box, px of the camera's picture."""
    left, top, width = tab.evaluate(
        f"(() => {{ const b = document.getElementById('{side}').getBoundingClientRect();"
        " return [b.x, b.y, b.width]; })()"
    )
    scale = width / 640
    x, y, w, h = (scale * v for v in box)
    mouse = tab.page.mouse
    mouse.move(left + x, top + y)
    mouse.down()
    mouse.move(left + x + w / 2, top + y + h / 3)
    mouse.move(left + x + w, top + y + h)
    mouse.up()


def tracks(cell: Cell, cap: int) -> None:
    """The cap that really is followed is this one, within 3 mm."""
    cell.until(lambda: cell.grab.loop.aim.target is not None)
    known = cell.grab.loop.aim.target
    assert np.linalg.norm(known.thing.position - cell.place(cap)) < 3e-3


def test_target_state_and_plan_are_shown(browser: Browser) -> None:
    with grabbing() as cell, looking(browser, cell) as tab:
        tab.until("document.querySelector('#state').textContent === 'following'")
        tab.until(f"({YELLOW})('left')[0] > 20 && ({YELLOW})('right')[0] > 20")
        for side, name in enumerate(("left", "right")):
            x, y, w, h = cell.box(side=side)
            _, across, down = tab.evaluate(f"({YELLOW})('{name}')")
            assert abs(across - (x + w / 2) / 640) < 0.01
            assert abs(down - (y + h / 2) / 360) < 0.015
        place = 1e3 * cell.place(0)
        message = tab.text("#target")
        shown = [float(message.split(f"{axis} ")[1].split(" ")[0]) for axis in "xyz"]
        np.testing.assert_allclose(shown, place, atol=3.0)
        assert "±" in message
        tab.until("document.querySelector('#plan-words').textContent.startsWith('planned')")
        assert "needed" in tab.text("#plan")
        message = tab.text("#passages")
        assert message.index("following") < message.index("tracking") < message.index("searching")
        assert "ready" in tab.text("#devices")
        assert tab.complaints == []


def test_a_rectangle_that_is_dragged_is_the_target(browser: Browser) -> None:
    with grabbing(selects=True) as cell, looking(browser, cell) as tab:
        tab.until("document.querySelector('#select').ariaPressed === 'true'")
        cell.until(lambda: cell.state is GraspState.SEARCHING)  # once the fingers are ready
        tab.until("document.querySelector('#reason').textContent === 'no object is selected'")
        assert "no object is selected" in tab.text("#target")
        drag(tab, "left", (300, 300, 3, 3))  # a slip
        drag(tab, "right", cell.box(side=1))
        tracks(cell, 0)
        tab.until("document.querySelector('#answer').textContent.includes('right ')")
        tab.until("document.querySelector('#state').textContent === 'following'")
        assert tab.evaluate("document.querySelector('#select').disabled")
        tab.press("s")  # not possible now, which is said
        tab.until("document.querySelector('#answer').textContent.includes('nothing moves')")
        assert tab.complaints == []


def test_a_target_is_selected_by_keys_alone(browser: Browser) -> None:
    with grabbing(selects=True, execute=False) as cell, looking(browser, cell) as tab:
        tab.until("document.querySelector('#select').ariaPressed === 'true'")
        tab.evaluate("document.querySelector('#left').focus()")
        tab.press("ArrowRight")
        x, y, w, h = cell.box()
        here = "(() => { const s = document.querySelector('.drawn').style;"
        here += " return [s.left, s.top].map(parseFloat); })()"
        for key, place, size, axis in (("ArrowRight", x, 640, 0), ("ArrowDown", y, 360, 1)):
            back = {"ArrowRight": "ArrowLeft", "ArrowDown": "ArrowUp"}[key]
            while abs(off := size * tab.evaluate(here)[axis] / 100 - place + 5) > 5:
                tab.press(back if off > 0 else key)
        span = "(() => { const s = document.querySelector('.drawn').style;"
        span += " return [s.width, s.height].map(parseFloat); })()"
        for back, wanted, size, axis in (("ArrowLeft", w, 640, 0), ("ArrowUp", h, 360, 1)):
            while size * tab.evaluate(span)[axis] / 100 > wanted + 16:
                tab.press(f"Shift+{back}")
        tab.press("Enter")
        tracks(cell, 0)
        assert not MOVING_STATES & set(cell.states)


@pytest.mark.parametrize("how", ["click", "space", "space on a button"])
def test_stop_holds_the_arm(browser: Browser, how: str) -> None:
    with grabbing(WANDERS) as cell, looking(browser, cell) as tab:
        cell.until(lambda: cell.state is GraspState.FOLLOWING)
        assert cell.travelled(20) > np.deg2rad(0.3)
        if how == "click":
            tab.page.click("#stop")
        else:
            focus = "#theme" if how.endswith("button") else "body"
            tab.evaluate(f"document.querySelector('{focus}').focus()")
            tab.press(" ")
        cell.until(lambda: cell.state is GraspState.HOLDING_OPERATOR)
        tab.until("document.querySelector('#answer').textContent.startsWith('STOP was received')")
        assert tab.evaluate("document.documentElement.dataset.theme") == "light"
        cell.turns(20)
        assert cell.travelled(20) < 1e-6
        assert not tab.evaluate("document.querySelector('#stop').disabled")
        assert tab.complaints == []


def test_the_view_in_space_draws_the_cameras_as_they_stood_for_the_pictures(
    browser: Browser,
) -> None:
    """The file's places until a row tells others; then those: drawn, and fitted into view."""
    places = "import('./scene.js').then(({ Scene }) => {"
    places += " const canvas = document.createElement('canvas');"
    places += " const scene = new Scene(canvas);"
    places += " const at = (x) => [{ rotation: [[1,0,0],[0,1,0],[0,0,1]], at_mm: [x, 0, 0] }];"
    places += " const colours = new Proxy({}, { get: () => '#123456' });"
    places += " const middle = () => { scene.middle = null; scene.draw(colours);"
    places += "   return [scene.cameras[0].at_mm[0], scene.middle[0]]; };"
    places += " scene.begin({ cameras: at(600) }); const file = middle();"
    places += " scene.show({}); const none = middle();"
    places += " scene.show({ cameras: at(1000) }); return [file, none, middle()]; })"
    with grabbing(execute=False) as cell, looking(browser, cell) as tab:
        assert tab.evaluate(places) == [[600, 300], [600, 300], [1000, 500]]
        assert tab.complaints == []


def test_the_grab_button_works_in_the_state_in_which_the_key_does(browser: Browser) -> None:
    with grabbing(selects=True) as cell, looking(browser, cell) as tab:
        cell.until(lambda: cell.state is GraspState.SEARCHING)  # until an object is selected
        assert tab.evaluate("document.querySelector('#grab').disabled")
        tab.press("g")  # as little
        drag(tab, "left", cell.box())
        tab.until("!document.querySelector('#grab').disabled")
        assert cell.state is GraspState.FOLLOWING
        tab.page.click("#grab")
        cell.until(lambda: GraspState.APPROACHING in cell.states)
        tab.until("document.querySelector('#grab').disabled")
        tab.until("document.querySelector('#answer').textContent.startsWith('lifted')")
        assert cell.grab.world.held is not None
        cell.end()
        tab.until("document.querySelector('#connection').textContent === 'finished'")
        assert tab.evaluate("document.querySelector('#banner').hidden")


def test_a_lost_connection_and_an_unsent_stop_are_shown(browser: Browser) -> None:
    with grabbing(WANDERS) as cell, looking(browser, cell) as tab:
        cell.until(lambda: cell.state is GraspState.FOLLOWING)
        cell.page._page._server._process.terminate()
        tab.until("document.querySelector('#banner').textContent.includes('stops nothing')")
        assert not tab.evaluate("document.querySelector('#banner').hidden")
        tab.page.click("#stop")
        tab.until("document.querySelector('#banner').textContent.includes('NOT sent')")
        cell.turns(10)
        assert cell.state is GraspState.FOLLOWING


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_on_a_phone_stop_is_always_in_sight(browser: Browser, scheme: str) -> None:
    with (
        grabbing(STANDS, execute=False) as cell,
        looking(browser, cell, 360, 740, scheme=scheme) as tab,
    ):
        tab.until("document.querySelector('#plan-words').textContent.startsWith('planned')")
        for place in (0, 1e6):
            tab.evaluate(f"scrollTo(0, {place})")
            seen = "(() => { const b = document.querySelector('#stop').getBoundingClientRect();"
            seen += " return document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2).id +"
            seen += " (b.bottom <= innerHeight); })()"
            assert tab.evaluate(seen) == "stoptrue"
        boxes = phone_sections(tab, scheme)
        bar = tab.evaluate("document.querySelector('#orders').getBoundingClientRect().top")
        assert max(bottom for _, bottom in boxes) <= bar  # scrolled down, nothing is behind it
        assert tab.complaints == []
