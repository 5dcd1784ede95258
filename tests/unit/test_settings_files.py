"""Settings files of other editors and of nobody's good will: read, or refused at once, in plain words."""

import io
import os
import subprocess
import sys

import numpy as np
import pytest

from cloudtomo_cl.commands import cli
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import SettingsError, printable
from cloudtomo_cl.files.extinction import write_extinction
from cloudtomo_cl.scene.formations import RingOfViews
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.sensors import FARTHEST, OrthographicView, PerspectiveView, PushBroomView
from cloudtomo_cl.settings.tables import read_render_settings

SCENE = """# Größe
[cloud]
file = "cloud.nc"
[sun]
zenith = 20.0
[[view]]
type = "orthographic"
zenith = 40.0
width = 1.2
pixels = [4, 3]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    extinction = np.zeros((4, 4, 4), np.float32)
    extinction[1:3, 1:3, 1:3] = 10.0
    write_extinction(tmp_path / "cloud.nc", Grid((4, 4, 4), (0.1, 0.1, 0.1)), extinction)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def settings(folder, content, overrides=()):
    (folder / "scene.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_render_settings(folder / "scene.toml", overrides)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32"])
def test_the_encodings_that_mark_themselves_are_read(folder, encoding):
    assert settings(folder, SCENE.encode(encoding)).sun.zenith == 20.0


WRONG = {
    "Latin-1": (SCENE.encode("latin-1"), "is not UTF-8: byte 0xf6 on line 1: save it as UTF-8"),
    "UTF-16 without its mark": (SCENE.encode("utf-16-le"), "holds zero bytes"),
    "deep lists": ("a = " + "[" * 100_000, "nested too deeply"),
    "deep tables": ("a." * 3000 + "b = 1", "nested too deeply"),
    "many digits": ("a = " + "9" * 5000, "is not TOML: Exceeds the limit"),
    "a large file": (b"#" * (1 << 25), "is no such file: they have 16.8 MB at most"),
    "a long name": (SCENE.replace("cloud.nc", "n" * 5000), "cloud.file is wrong: there is no file"),
    "a name with a zero": (SCENE.replace("cloud.nc", "a\\u0000"), "cloud.file is wrong: there is no file"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_settings_file_is_named(folder, case):
    content, message = WRONG[case]
    with pytest.raises(SettingsError, match=message):
        settings(folder, content)


@pytest.mark.parametrize("value", ["[" * 100_000, "9" * 5000])
def test_values_of_the_command_line_are_named(folder, value):
    with pytest.raises(SettingsError, match="sun.zenith must be"):
        settings(folder, SCENE, [f"sun.zenith={value}"])


def test_an_index_of_many_digits_is_named(folder):
    with pytest.raises(SettingsError, match="is not key=value"):
        settings(folder, SCENE, [f"view[{'9' * 5000}].zenith=1"])


@pytest.mark.parametrize("command", ["render", "flux", "cloud"])
def test_a_pipe_is_not_waited_for(folder, capsys, command):
    os.mkfifo("pipe.toml")
    output = [] if command == "cloud" else ["--output", "new.nc"]
    assert main([command, "pipe.toml", *output]) == 2
    assert "a pipe or a device" in capsys.readouterr().err


def test_a_ring_of_many_cameras_is_refused():
    ring = {"target": (0, 0, 0), "height": 2.0, "radius": 1.0, "field_of_view": 30.0, "pixels": (2, 2)}
    assert len(RingOfViews(**ring, count=10_000).views()) == 10_001
    with pytest.raises(ValueError, match="less than or equal to 10000"):
        RingOfViews(**ring, count=100_000_000)


def test_cameras_beyond_single_precision_are_refused():
    look = {"target": (0.0, 0.0, 0.0), "field_of_view": 1e-3, "pixels": (2, 2)}
    PerspectiveView(position=(0.0, 0.0, FARTHEST), **look)
    for position in ((0.0, 0.0, 1.01 * FARTHEST), (-1.01 * FARTHEST, 0.0, 1.0)):
        with pytest.raises(ValueError, match="position lies farther than 100000 km away.*orthographic"):
            PerspectiveView(position=position, **look)
    for height in (0.4, 1000.0):  # level, and so shallow that its rays pass the domain's sides
        with pytest.raises(ValueError, match="position lies farther than 100000 km away"):
            OrthographicView(position=(2e6, 0.4, height), target=(0.4, 0.4, 0.4), width=0.5, pixels=(8, 8))
    with pytest.raises(ValueError, match="end lies farther than 100000 km away"):
        PushBroomView((0.0, 0.0, 1.0), (2 * FARTHEST, 0.0, 1.0), 30.0, (2, 2))


# ---- terminals


def test_control_characters_are_spelt_out():
    assert printable("a\x1b[31mred\x07\x9b\r\n\tb") == "a\\x1b[31mred\\x07\\x9b\\x0d\n\tb"


def test_an_error_does_not_obey_what_a_file_says(folder, capsys):
    assert main(["render", "\x1b]0;title\x07.toml", "--output", "new.nc"]) == 2
    message = capsys.readouterr().err
    assert "\x1b" not in message and "\\x1b]0;title\\x07.toml: no such file" in message


def test_brackets_in_names_are_no_markup(folder, capsys):
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    (folder / "a[").mkdir()
    for name in ("x[red].nc", "a[/run].nc"):
        assert main(["render", "scene.toml", "--samples", "4", "--output", name]) == 0
        assert name in capsys.readouterr().out


def test_a_terminal_without_a_sign_does_not_end_the_command(folder):
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    code = "import sys; from cloudtomo_cl.commands.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "render", "scene.toml", "--samples", "4", "--output", "new.nc"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    result = subprocess.run(command, capture_output=True, timeout=120, env=environment)
    assert result.returncode == 0 and b"\\xb1" in result.stdout, result.stderr


def test_a_stream_that_cannot_be_changed_is_written_to(monkeypatch):
    """As notebooks have."""
    monkeypatch.setattr(cli.sys, "stdout", io.StringIO())
    assert main(["cloud", "nowhere.nc"]) == 2
