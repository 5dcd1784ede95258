"""`--set` changes what it names, and says what it cannot."""

import pytest

from cloudtomo_cl.errors import SettingsError
from cloudtomo_cl.settings.overrides import with_overrides

TABLES = {"sun": {"zenith": 30.0}, "view": [{"pixels": [4, 4]}, {"pixels": [6, 6]}]}


@pytest.mark.parametrize(
    ("override", "key", "value"),
    [
        ("sun.zenith=45", ("sun", "zenith"), 45),
        ("sun.azimuth = 1.5e1", ("sun", "azimuth"), 15.0),
        ("surface.albedo=0.1", ("surface", "albedo"), 0.1),
        ("view[1].pixels=[8, 9]", ("view", 1, "pixels"), [8, 9]),
        ("view[0].pixels[1]=7", ("view", 0, "pixels", 1), 7),
        ('boundary.horizontal="periodic"', ("boundary", "horizontal"), "periodic"),
        ("boundary.horizontal=periodic", ("boundary", "horizontal"), "periodic"),
        ("cloud.phase_function={type='henyey-greenstein', g=0.5}", ("cloud", "phase_function", "g"), 0.5),
        ("truth.file=a=b.nc", ("truth", "file"), "a=b.nc"),
    ],
)
def test_a_key_gets_its_value(override, key, value):
    node = with_overrides(TABLES, [override])
    for part in key:
        node = node[part]
    assert node == value and type(node) is type(value)


def test_what_was_read_stays_as_it_was():
    with_overrides(TABLES, ["sun.zenith=45", "view[0].pixels=[1, 1]"])
    assert TABLES["sun"] == {"zenith": 30.0} and TABLES["view"][0]["pixels"] == [4, 4]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("sun.zenith", "is not key=value"),
        ("sun..zenith=3", "is not key=value"),
        ("sun.zenith.more=3", "sun.zenith is no table"),
        ("view.pixels=[1, 1]", r"view\[0\].pixels"),
        ("view[2].pixels=[1, 1]", "the list has 2"),
        ("sun[0].zenith=3", "no entry|no list|is no table"),
        ("grid.spacing=[.08, .08, .08]", "is none .*: write for instance"),
        ("cloud={file=cloud.nc}", "is none .*: write for instance"),
        ("sun.zenith=3\nsun.azimuth=4", "more lines than one"),
    ],
)
def test_what_cannot_be_set_is_said(override, message):
    with pytest.raises(SettingsError, match=message) as error:
        with_overrides(TABLES, [override])
    assert override in str(error.value)
