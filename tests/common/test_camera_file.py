"""Camera files: pixels become bearings and come back; what does not fit is refused in one line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.camera import Camera, Mount, parse
from heliograph.errors import ConfigError

EXAMPLE = Path(__file__).parents[2] / "deploy" / "sites" / "cameras" / "example.toml"
PLAIN = """
[camera]
name = "cam0"
width = 640
height = 480
[intrinsics]
fx_px = 400
fy_px = 410.0
cx_px = 320.0
cy_px = 240.0
"""


def distorted(k1: float, k2: float, p1: float, p2: float, k3: float) -> Camera:
    return parse(PLAIN + f"distortion = [{k1!r}, {k2!r}, {p1!r}, {p2!r}, {k3!r}]\n")


def test_bearings_of_a_plain_camera_are_those_of_a_pinhole() -> None:
    camera = parse(PLAIN)
    assert camera.bearing(320.0, 240.0) == (0.0, 0.0, 1.0)
    x, y, z = camera.bearing(320.0 + 400.0, 240.0)
    assert (x, y, z) == pytest.approx((math.sqrt(0.5), 0.0, math.sqrt(0.5)))
    # Down in the image is +y.
    assert camera.bearing(320.0, 240.0 + 410.0)[1] == pytest.approx(math.sqrt(0.5))


@given(
    st.floats(-0.08, 0.15),
    st.floats(-0.01, 0.05),
    st.floats(-0.002, 0.002),
    st.floats(-0.002, 0.002),
    st.floats(-0.003, 0.005),
    st.floats(0, 639),
    st.floats(0, 479),
)
def test_a_bearing_projects_back_to_its_pixel(
    k1: float, k2: float, p1: float, p2: float, k3: float, x_px: float, y_px: float
) -> None:
    camera = distorted(k1, k2, p1, p2, k3)
    bearing = camera.bearing(x_px, y_px)
    assert math.hypot(*bearing) == pytest.approx(1.0, abs=1e-12)
    assert camera.project(bearing) == pytest.approx((x_px, y_px), abs=1e-6)


def test_distortion_is_brown_and_conrady_in_the_order_of_opencv() -> None:
    # Worked by hand: x = .1, y = .2, r2 = .05; radial = 1 + .1 * .05 + .01 * .0025 + .4 * .000125 = 1.005075;
    # xd = .1005075 + 2 * .002 * .02 + .003 * (.05 + .02) = .1007975; yd = .201015 + .002 * (.05 + .08) + 2 * .003 * .02
    camera = distorted(0.1, 0.01, 0.002, 0.003, 0.4)
    x_px, y_px = camera.project((0.1, 0.2, 1.0))
    assert (x_px, y_px) == pytest.approx((320 + 400 * 0.1007975, 240 + 410 * 0.201395), abs=1e-9)


def test_the_example_looks_forward_from_a_drone() -> None:
    camera = parse(EXAMPLE.read_text())
    assert camera.in_body((0.0, 0.0, 1.0)) == pytest.approx((1.0, 0.0, 0.0))  # along the axis: ahead
    assert camera.in_body((1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))  # right in the image: right
    assert camera.in_body((0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0))  # down in the image: down


@given(st.floats(-180, 180), st.floats(-89, 89), st.floats(-180, 180))
def test_angles_turn_like_rz_ry_rx(roll: float, pitch: float, yaw: float) -> None:
    r, p, y = (math.radians(a) for a in (roll, pitch, yaw))
    # The x axis turned by Rx (unmoved), Ry, Rz.
    wanted = (math.cos(p) * math.cos(y), math.cos(p) * math.sin(y), -math.sin(p))
    rows = Mount(roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw).rotation()
    assert [row[0] for row in rows] == pytest.approx(wanted, abs=1e-12)
    # The z axis, for the roll: third row of the product, worked on paper.
    assert [rows[2][1], rows[2][2]] == pytest.approx([math.cos(p) * math.sin(r), math.cos(p) * math.cos(r)], abs=1e-12)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("", "camera"),
        ("nonsense", "cameras/x.toml"),
        (PLAIN.replace("fx_px = 400", "fx_px = 0"), "fx_px"),
        (PLAIN.replace("fx_px = 400", 'fx_px = "400"'), "fx_px"),
        (PLAIN + "distortion = [0.1]", "distortion"),
        (PLAIN + "distortion = [-3.0, 0.0, 0.0, 0.0]", "cannot be undone"),
        (PLAIN.replace("cx_px = 320.0", "cx_px = nan"), "cx_px"),
        (PLAIN + "[mount]\nquaternion = [1.0, 1.0, 0.0, 0.0]", "length 1"),
        (PLAIN + "[mount]\nquaternion = [1.0, 0.0, 0.0, 0.0]\nyaw_deg = 3", "not both"),
        (PLAIN + "[mount]\nyaw = 3", "yaw"),
        (PLAIN.replace("width = 640", "width = 100000"), "width"),
    ],
)
def test_a_wrong_camera_file_is_one_line_that_names_the_field(text: str, names: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text, "cameras/x.toml")
    assert names in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.floats(-1e9, 1e9), st.floats(-1e9, 1e9))
def test_bearings_are_unit_vectors_wherever_they_are_asked_for(x_px: float, y_px: float) -> None:
    assert math.hypot(*distorted(-0.1, 0.02, 0.001, 0.001, 0.0).bearing(x_px, y_px)) == pytest.approx(1.0)
