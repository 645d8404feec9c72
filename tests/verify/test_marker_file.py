import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.verify.recorded import MARKER, replace, require_shared
from tests.verify.test_rig_file import assert_same, every_disk, finite, positive, texts
from verify import marker_file
from verify.errors import InputError
from verify.marker import COLOURS, Marker


@st.composite
def markers(draw: st.DrawFn) -> Marker:
    names = draw(st.lists(texts.filter(len), min_size=1, max_size=5, unique=True))
    count = len(names)
    away = np.arange(count)[:, None] * np.array([3000.0, 0, 0])  # never inside one another
    scatter = st.lists(st.tuples(finite, finite, finite), min_size=count, max_size=count)
    colour = st.none() | st.sampled_from(COLOURS)
    return Marker(
        names=tuple(names),
        leds=away + np.array(draw(scatter)),
        colours=tuple(draw(st.lists(colour, min_size=count, max_size=count))),
        led_diameter=draw(positive),
        source=draw(st.none() | st.sampled_from(["jig", "measured", "motion"])),
        datum=draw(st.none() | texts),
        registration=draw(st.none() | texts),
        body_standard_uncertainty=draw(st.none() | st.tuples(*[positive] * 6).map(np.array)),
        led_standard_uncertainty=draw(st.none() | positive),
        centre_shift_standard_uncertainty=draw(st.none() | positive),
    )


@every_disk
@given(marker=markers())
def test_a_marker_written_and_read_is_the_same_marker(
    marker: Marker, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "marker.toml"
    marker_file.write(path, marker)
    again, warnings = marker_file.read(path)
    assert warnings == ()
    assert_same(marker, again)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "marker.toml").write_text(MARKER)
    return tmp_path / "marker.toml"


def test_millimetres_and_degrees_become_metres_and_radians(path: Path) -> None:
    replace(
        path,
        "led_diameter_mm = 5.0",
        "led_diameter_mm = 5.0\nled_standard_uncertainty_mm = 0.05\nsource = 'jig'\n"
        "centre_shift_standard_uncertainty_mm = 0.01\ndatum = 'dowel hole'\n"
        "body_standard_uncertainty = {x_mm=1, y_mm=2, z_mm=3, rx_deg=180, ry_deg=90, rz_deg=45}",
    )
    marker, warnings = marker_file.read(path)
    assert warnings == ()
    assert (marker.names, marker.colours) == (("A", "B"), (None, "red"))
    assert (marker.source, marker.datum) == ("jig", "dowel hole")
    assert_allclose(marker.leds, [[0.06, 0, 0.01], [-0.045, 0.04, 0.015]])
    assert marker.led_diameter == pytest.approx(0.005)
    assert marker.led_standard_uncertainty == pytest.approx(5e-5)
    assert marker.centre_shift_standard_uncertainty == pytest.approx(1e-5)
    assert marker.body_standard_uncertainty is not None
    assert_allclose(
        marker.body_standard_uncertainty, [0.001, 0.002, 0.003, np.pi, np.pi / 2, np.pi / 4]
    )


def test_a_misspelt_key_of_an_led_is_named(path: Path) -> None:
    replace(path, 'colour = "red"', 'color = "red"')
    warnings = marker_file.read(path)[1]
    assert len(warnings) == 1
    assert "led[1].color:" in warnings[0]
    assert "`colour`" in warnings[0]


NEGATIVE = "{x_mm=-1, y_mm=0, z_mm=0, rx_deg=0, ry_deg=0, rz_deg=0}"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("led_diameter_mm = 5.0", "led_diameter_mm = 0", "led_diameter_mm: is 0.0"),
        ("led_diameter_mm = 5.0", "", "led_diameter_mm: is missing"),
        ('"red"', '"pink"', 'led[1].colour: is "pink"'),
        ('"B"', '"A"', 'led[1].name: repeats "A"'),
        ('"B"', '""', "led[1].name: is empty"),
        ('"B"', "2", "led[1].name: is 2"),
        ("[-45.0, 40.0, 15.0]", "[60.0, 0.0, 11.0]", "led[1].position_mm: is 1 mm from led[0]"),
        ("[-45.0, 40.0, 15.0]", "[60.0, 0.0]", "led[1].position_mm: is a list of 2"),
        ("format = 1", "format = 1\nsource = 'jigg'", 'source: is "jigg"'),
        ("format = 1", "format = true", "format: is true"),
        (
            "format = 1",
            "format = 1\nled_standard_uncertainty_mm = -1",
            "led_standard_uncertainty_mm",
        ),
        ("format = 1", "format = 1\nbody_standard_uncertainty = {x_mm=1}", "y_mm: is missing"),
        (
            "format = 1",
            f"format = 1\nbody_standard_uncertainty = {NEGATIVE}",
            "body_standard_uncertainty.x_mm: is -1.0",
        ),
    ],
)
def test_a_wrong_marker_is_refused_by_its_key(path: Path, old: str, new: str, said: str) -> None:
    replace(path, old, new)
    with pytest.raises(InputError) as caught:
        marker_file.read(path)
    assert said in str(caught.value)


def test_a_marker_without_leds_is_refused(path: Path) -> None:
    path.write_text("format = 1\nled_diameter_mm = 5.0\nled = []\n")
    with pytest.raises(InputError, match="led: is empty"):
        marker_file.read(path)


@pytest.mark.shared
def test_the_markers_of_the_recorded_sessions_hold_what_their_files_say() -> None:
    for path in sorted(require_shared().glob("*/marker.toml")):
        marker, warnings = marker_file.read(path)
        leds = tomllib.loads(path.read_text())["led"]
        assert warnings == ()
        assert marker.names == tuple(led["name"] for led in leds)
        assert_allclose(marker.leds * 1000, [led["position_mm"] for led in leds])
