"""Pictures of the tutorial: what the simulated cameras see of the board and of the LEDs."""

from contextlib import closing
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from tests.support.pictures import stamp
from tests.support.pictures.gallery import typed
from verify import Session, Setup, measure, open_session
from verify.core.records import Image, Sighting
from verify.io.board.folder import open_board_folder

WIDTH_PX = 760  # of both cameras side by side
GAP_PX = 12
CUT_PX, SCALE = (300, 260), 1.25  # cut out about the LEDs, and how much larger it is drawn
MARK = (60, 190, 60)  # BGR
SHOWN_VIEW = 6  # of boards_turning: tilted, whole in both pictures
SHOWN_PAIR = 30


def make(folder: Path) -> None:
    """Simulate, measure, draw."""
    typed("verify simulate boards_turning -o boards", folder)
    with closing(open_board_folder(folder / "boards").pairs()) as pairs:
        board = next(islice(pairs, SHOWN_VIEW, None))
    stamp.write("board", beside(colour(board.left), colour(board.right)), width=WIDTH_PX)
    stamp.write("leds", leds(open_session(stamp.ROOT / "sample_sessions" / "multi_joint_fault_6r")))


def leds(session: Session) -> bytes:
    """One pair, cut out about the LEDs, each spot marked with the name of its LED; PNG."""
    pairs = list(session.pairs())
    found = list(measure(iter(pairs), Setup(session.rig, session.marker)))[SHOWN_PAIR]
    sides = []
    for image, sighting in (
        (pairs[SHOWN_PAIR].left, found.left), (pairs[SHOWN_PAIR].right, found.right),
    ):  # fmt: skip
        assert sighting is not None
        sides.append(marked(image, sighting, session.marker.names))
    return beside(*sides)


def marked(image: Image, sighting: Sighting, names: tuple[str, ...]) -> Image:
    """Cut the LEDs out of a picture, circle and name them; as wide for either camera."""
    middle = sighting.centre.mean(axis=0)
    x, y = np.round(middle - np.array(CUT_PX) / 2).astype(int)
    cut = colour(image)[y : y + CUT_PX[1], x : x + CUT_PX[0]]
    drawn = cv2.resize(cut, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
    for led, centre in zip(sighting.led, sighting.centre, strict=True):
        at = np.round((centre - [x, y] + 0.5) * SCALE).astype(int)
        cv2.circle(drawn, at.tolist(), 17, MARK, 1, cv2.LINE_AA)
        place = (at + np.array([21, 6])).tolist()
        cv2.putText(drawn, names[led], place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, MARK, 1, cv2.LINE_AA)
    return np.asarray(drawn, dtype=np.uint8)


def colour(image: Image) -> Image:
    """Three channels of a grey picture."""
    three = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    return np.asarray(three, dtype=np.uint8)


def beside(left: Image, right: Image) -> bytes:
    """Both cameras' pictures side by side, PNG."""
    gap = np.full((len(left), GAP_PX, 3), 255, np.uint8)
    _, png = cv2.imencode(".png", np.hstack([left, gap, right]))
    return png.tobytes()
