"""Links to a view of the live page: settings and a camera in the query of its address."""

import pytest

from quaffure import InputError
from quaffure.apps.viewer.link import View, link_of, settings_of, split_query
from quaffure.apps.viewer.settings import GUIDES, Settings

EVERYTHING = Settings(
    groom="my hair (file)",
    motion="walk & run",
    frame=12,
    draper="strand_newton",
    strands="20,000 strands",
    mark_inside=True,
    joint_rotations={"Head": (10.0, 0.0, -5.5), "LeftArm": (0.0, 90.0, 0.0)},
    body_shape=(1.5, *[0.0] * 8, -0.1),
    stiffness=0.35,
    gravity=(0.0, 1.25, -9.81),
    wind=(6.0, 0.0, 0.0),
)


def read(link: str) -> Settings:
    fields, _ = split_query(link.partition("?")[2])
    return settings_of(fields, "bob", "rest")


@pytest.mark.parametrize(
    "settings",
    [EVERYTHING, Settings("bob", "nod"), Settings("bob", "nod", strands=GUIDES)],
    ids=["all", "few", "guides"],
)
def test_a_link_says_what_the_page_shows(settings: Settings) -> None:
    assert read(link_of(settings)) == settings


def test_what_is_as_at_the_start_is_not_in_a_link() -> None:
    assert link_of(Settings("bob", "nod", joint_rotations={"Head": (0.0, 0.0, 0.0)})) == "/?groom=bob&motion=nod"


def test_the_camera_is_left_to_viser() -> None:
    link = link_of(Settings("bob", "nod"), View((0.5, -1.0, 1.61803), (0.0, 0.0, 1.5)))
    camera = "initialCameraPosition=0.5,-1,1.618&initialCameraLookAt=0,0,1.5"
    assert split_query(link.partition("?")[2])[1] == camera


def test_fields_of_others_are_none_of_the_page() -> None:
    assert split_query("darkMode&initialCameraFov=0.5") == ({}, "darkMode=&initialCameraFov=0.5")


def test_a_link_without_groom_and_clip_keeps_them() -> None:
    assert settings_of({"frame": "3"}, "bob", "rest") == Settings("bob", "rest", frame=3)


@pytest.mark.parametrize(
    ("query", "complaint"),
    [
        ("Head=90,0,0", "Head: expected -60 to 60, found 90"),
        ("Head=1,2", "link: Head: expected 3 numbers"),
        ("wind=nan,0,0", "link: wind: expected 3 numbers"),
        ("wind=1e99,0,0", "wind: expected -10 to 10"),
        ("gravity=a,b,c", "link: gravity: expected 3 numbers"),
        ("stiffness=9", "stiffness: expected 0.3 to 3, found 9"),
        ("shape=1", "link: shape: expected 10 numbers"),
        ("frame=1.5", "link: frame: expected a number of a frame"),
        ("frame=" + "9" * 400, "link: frame: expected a number of a frame"),
        ("strands=1000000", "link: strands: expected one of guides, 5000, 10000, 20000"),
        ("&".join(["frame=1"] * 65), "link: expected at most 64 fields"),
    ],
)
def test_a_link_with_nonsense_is_refused(query: str, complaint: str) -> None:
    with pytest.raises(InputError) as error:
        read(f"/?{query}")
    assert complaint in str(error.value)
